"""The table ``[time]`` of a scene: duration, time steps, integrator, mass and damping."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from fem_snh.choices import (
    DEFAULT_INTEGRATOR,
    DEFAULT_RHO_INFINITY,
    INTEGRATORS,
    MASSES,
)
from fem_snh.tables.types import Count, NonNegative, Positive, Steps
from fem_snh.tables.validation import Expect, Finite, OneOf, Table

_Radius = Annotated[Finite, Field(ge=0, le=1), Expect("a number from 0 to 1")]
Integrator = Annotated[str, OneOf(INTEGRATORS)]
Mass = Annotated[str, OneOf(MASSES)]


class Damping(Table):
    """Rayleigh damping: forces proportional to the velocity."""

    mass: NonNegative = Field(default=0.0, description="Coefficient of the mass matrix [1/s].")
    stiffness: NonNegative = Field(
        default=0.0,
        description="Coefficient of the clamped stiffness matrix at the step's start [s].",
    )


class Time(Table):
    """Time integration from 0 to ``duration``; without this table a scene is quasi-static.

    Materials need a density. Points of a ``[[table]]`` are then [time in s, value]; a force without
    a table is constant, and a motion without one goes from 0 to its value over the duration.
    """

    needs_value = {"rho_infinity": ("integrator", "generalized_alpha")}
    duration: Positive = Field(description="End of the run [s].")
    steps: Steps = Field(
        description="Number of equal time steps; one that fails is halved. "
        "The scene's own 'steps' is then not given."
    )
    integrator: Integrator = Field(
        default=DEFAULT_INTEGRATOR,
        description=f"Time integration, one of {', '.join(INTEGRATORS)}; semi_implicit is "
        "backward Euler with one linear solve for each step.",
    )
    rho_infinity: _Radius | None = Field(
        default=None,
        description="Spectral radius of generalized_alpha at large frequencies: 1 keeps them, "
        f"0 removes them in a step; default: {DEFAULT_RHO_INFINITY}.",
    )
    mass: Mass = Field(default=MASSES[0], description=f"Mass matrix, {' or '.join(MASSES)}.")
    damping: Damping = Field(default=Damping(), description="Rayleigh damping.")
    tolerance: Positive | None = Field(
        default=None,
        description="Adaptive steps, at most as long as those of 'steps': largest estimate of a "
        "step's error in the displacement, relative to V^(1/3), V the reference volume. "
        "Default: equal steps.",
    )
    output_every: Count = Field(
        default=1,
        description="Time steps of 'steps' from one output to the next: fields.pvd, "
        "checkpoint.npz and run.json.",
    )
