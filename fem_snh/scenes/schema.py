"""The schema of a scene: the same tables and rules for Python scenes and for TOML files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field, ValidationInfo, field_validator, model_validator

from fem_snh.assembly.elements import ELEMENTS, MAX_QUADRATURE_DEGREE
from fem_snh.assembly.kinematics import PLANAR
from fem_snh.choices import (
    DEFAULT_CELLS,
    DEFAULT_HESSIAN,
    DEFAULT_INTEGRATOR,
    DEFAULT_PREDICTOR,
    DEFAULT_RHO_INFINITY,
    GLOBALIZATIONS,
    HESSIANS,
    INTEGRATORS,
    MASSES,
    PREDICTORS,
)
from fem_snh.contact.contact_tables import Contact, SelfContact
from fem_snh.contact.obstacle import Obstacle
from fem_snh.files import is_shape, xdmf_data
from fem_snh.scenes._bones import BoneChoice, Rig
from fem_snh.scenes._consistency import check_consistency
from fem_snh.scenes._material import MaterialChoice, Materials
from fem_snh.scenes._outputs import (
    Accuracy,
    Location,
    Mesh,
    Modes,
    OutputFields,
    Probe,
    Reactions,
    UnitNames,
)
from fem_snh.tables.amplitudes import Amplitude, Amplitudes
from fem_snh.tables.types import (
    Cells,
    Count,
    FilePath,
    FlagOrCoarser,
    Groups,
    Matrix,
    NonNegative,
    Options,
    PoissonRatios,
    Positive,
    Range,
    Seed,
    Steps,
    Text,
    Vector,
)
from fem_snh.tables.validation import Expect, Finite, OneOf, Table, Whole
from fem_snh.terms.cavity import Cavity
from fem_snh.terms.dirichlet import Hold, Move, Symmetry
from fem_snh.terms.feature import Feature
from fem_snh.terms.loads import Gravity, Pressure, Spring, Traction
from fem_snh.terms.rigid import Rigid

if TYPE_CHECKING:
    from fem_snh.scenes.build import Built

Degree = Annotated[int, Whole(1, MAX_QUADRATURE_DEGREE)]


class Start(Table):
    """The initial displacement and velocity of a run; without this table they are zero.

    Prescribed nodes take their prescribed displacement and velocity. If ``run`` gives the start,
    they move to their prescribed displacement in proportion to the load.
    """

    excludes = {"run": ("map", "scatter", "noise"), "map": ("scatter",)}
    needs = {
        "step": ("run",),
        "through": ("map", "angular_velocity"),
        "seed": ("scatter", "noise"),
    }
    run: Annotated[FilePath, Expect("the path of a folder")] | None = Field(
        default=None,
        description="Folder of another run, relative to this file, whose displacement is the "
        "start; its mesh may be another one of the same body.",
    )
    step: int = Field(
        default=-1,
        description="Number of its stored state: 0 is its start, -1 its last.",
    )

    map: Matrix | None = Field(
        default=None, description="Matrix A of an affine map: x = A (X - through) + through."
    )
    through: Vector | None = Field(
        default=None,
        description="Fixed point of the map, and a point of the axis of the angular velocity "
        "[length]; default: the centre of the body's bounding box.",
    )
    scatter: Positive | None = Field(
        default=None,
        description="Each node is placed at random in the bounding box, "
        "enlarged to this many times its volume.",
    )
    noise: NonNegative = Field(
        default=0.0, description="Largest random displacement added to each component [length]."
    )
    seed: Seed = Field(default=0, description="Seed of the random numbers.")
    velocity: Vector | None = Field(
        default=None, description="Initial velocity [m/s], of a scene with [time]."
    )
    angular_velocity: Vector | None = Field(
        default=None,
        description="Initial angular velocity [rad/s], of a scene with [time]; "
        "it is added to the velocity.",
    )

    @property
    def files(self) -> dict[str, Path]:
        """The run.json of the other run, by the key "run"; this run must not replace it."""
        return {"run": self.run / "run.json"} if self.run is not None else {}

    @property
    def displaces(self) -> bool:
        """Whether ``map``, ``scatter`` or ``noise`` gives the body an initial displacement."""
        return self.map is not None or self.scatter is not None or self.noise > 0


_Radius = Annotated[Finite, Field(ge=0, le=1), Expect("a number from 0 to 1")]
Integrator = Annotated[str, OneOf(INTEGRATORS)]
Mass = Annotated[str, OneOf(MASSES)]


class Damping(Table):
    """Rayleigh damping: the damping matrix is mass times M plus stiffness times K."""

    mass: NonNegative = Field(default=0.0, description="Coefficient of the mass matrix [1/s].")
    stiffness: NonNegative = Field(
        default=0.0,
        description="Coefficient of the clamped stiffness matrix at the step's start [s].",
    )


class Time(Table):
    """Time integration from 0 to ``duration``; without this table a scene is quasi-static.

    Materials need a density. Points of a ``[[table]]`` are then [time in s, value]; a force without
    a table is constant, and a motion without a table goes from 0 to its value over the duration.
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


class Scene(Table):
    """An experiment, quasi-static or in time: all that `fem_snh.run` needs.

    The load goes from 0 to 1 in ``steps`` equal increments; with ``time``, it is the fraction of
    the duration.
    """

    # Modes are those of a state at rest; continuation in Poisson's ratio solves problems without
    # inertia; stability is that of an equilibrium.
    excludes = {
        "time": ("modes", "nu_continuation", "stability"),
        "rigid": ("bone", "nu_continuation"),
    }
    needs = {"rig": ("bone",)}
    name: Text = Field(description="Name of the scene; default: the file's name.")
    mesh: Mesh = Field(
        description="Path of a gmsh file, of an .xdmf file, of which every rank reads its part, or "
        "of an .xao file, whose exact shape is meshed, relative to the scene file; a built-in "
        "geometry; a lattice; or tetrahedra."
    )
    cells: Cells | None = Field(
        default=None,
        validate_default=True,
        description="Resolution of a built-in geometry, in cells along an edge; of an .xao file, "
        f"along its longest extent, by default {DEFAULT_CELLS}; a mesh file has none.",
    )
    element: Annotated[str, OneOf(ELEMENTS)] = Field(
        description=f"Finite element, one of {', '.join(ELEMENTS)}: P on tetrahedra or triangles, "
        "Q on hexahedra or quadrilaterals; then the degree of the displacement; P0 with mean "
        "dilatation; P1 or Q1 with a continuous pressure (Taylor-Hood)."
    )
    kinematics: Annotated[str, OneOf(PLANAR)] | None = Field(
        default=None,
        description=f"Of a mesh of two dimensions, one of {', '.join(PLANAR)}; a mesh of three has "
        "none.",
    )
    quadrature: Degree | None = Field(
        default=None,
        description="Polynomial degree that the quadrature rule integrates exactly, at least the "
        "lowest without spurious modes: 1 for P1, 4 for Q2 and Q2Q1, 2 for the others; default: "
        "the element's.",
    )
    hessian: Annotated[str, OneOf(HESSIANS)] | None = Field(
        default=None,
        description=f"Hessian of Newton's method, one of {', '.join(HESSIANS)}; "
        f"default: {DEFAULT_HESSIAN}.",
    )
    globalization: Annotated[str, OneOf(GLOBALIZATIONS)] | None = Field(
        default=None,
        description=f"Globalisation of Newton's method, one of {', '.join(GLOBALIZATIONS)}; "
        "default: linesearch if a Hessian is named, and for any problem but a minimisation "
        "problem; else trust_region.",
    )
    static_condensation: bool | None = Field(
        default=None,
        description="With Q1P0 and P2P0: true to eliminate the pressure of each cell, false to "
        "solve each step with the pressures as unknowns first; default: by nu.",
    )
    steps: Steps = Field(
        default=1,
        description="Number of load steps; a step that fails is halved. The option --steps means "
        "the time steps of a scene with [time].",
    )
    time: Time | None = Field(default=None, description="Time integration; default: quasi-static.")
    material: Materials = Field(
        description="The material; or several, [[material]], which fill groups of volumes."
    )
    hold: list[Hold] = Field(default=[], description="Groups that do not move.")
    move: list[Move] = Field(default=[], description="Groups that move with the load.")
    symmetry: list[Symmetry] = Field(
        default=[], description="Plane groups whose nodes slide in the plane."
    )
    bone: list[BoneChoice] = Field(
        default=[], description="Solids in the flesh that follow a motion."
    )
    rig: Rig | None = Field(default=None, description="What concerns all bones.")
    traction: list[Traction] = Field(default=[], description="Dead loads on surfaces.")
    gravity: Gravity | None = Field(default=None, description="The weight of the body.")
    pressure: list[Pressure] = Field(default=[], description="Follower loads on surfaces.")
    spring: list[Spring] = Field(default=[], description="Elastic foundations of surfaces.")
    rigid: list[Rigid] = Field(default=[], description="Parts that move as rigid bodies.")
    contact: list[Contact] = Field(default=[], description="Surfaces that touch each other.")
    self_contact: SelfContact | None = Field(
        default=None, description="Contact of the body with itself."
    )
    cavity: list[Cavity] = Field(default=[], description="Fluids of prescribed volume.")
    obstacle: list[Obstacle] = Field(
        default=[], description="Rigid obstacles that the body touches."
    )
    table: list[Amplitude] = Field(default=[], description="Amplitudes of loads and motions.")
    start: Start | None = Field(
        default=None,
        description="Initial displacement, which needs predictor = 'none' without [time] unless "
        "it is that of another run; initial velocity.",
    )
    nu_continuation: PoissonRatios = Field(
        default=[],
        description="Continuation in Poisson's ratio: the ratios with which each step is solved "
        "before it is solved with the material's own.",
    )
    reactions: Reactions = Field(
        default=[],
        description="Physical groups whose total reaction force is reported after each step; as "
        "{ group = ..., about = [x, y, z] } also its moment about that point.",
    )
    volumes: Groups = Field(
        default=[],
        description="Physical groups of volumes whose volume ratio is reported after each step.",
    )
    probe: list[Probe] = Field(
        default=[], description="Points whose displacement is reported after each step."
    )
    fields: OutputFields = Field(
        default=[], description="Stresses, strains and forces to write; see the table of fields."
    )
    fields_at: Location = Field(
        default="cells",
        description="Means over cells, or nodes: values of the L2 projection to degree 1.",
    )
    stability: bool = Field(
        default=False,
        description="true to tell after each step whether its equilibrium is stable, by sparse "
        "factors of the exact Hessian: one factorisation a step.",
    )
    modes: Modes | None = Field(default=None, description="Eigenfrequencies at the end of the run.")
    error: FlagOrCoarser = Field(
        default=False,
        description="Whether the errors of the probes, reactions, volumes and the energy are "
        "estimated after the last step: by a solution in the element of the next degree; "
        "'coarser': by those of runs with a half and a quarter of the cells, in less time.",
    )
    accuracy: Accuracy | None = Field(
        default=None, description="Goals whose errors are estimated, in place of those of `error`."
    )
    predictor: Annotated[str, OneOf(PREDICTORS)] = Field(
        default=DEFAULT_PREDICTOR,
        description=f"Initial guess of a load step, one of {', '.join(PREDICTORS)}: the last "
        "equilibrium, its linear extrapolation in the load, a linear solve with the tangent, or "
        "the last equilibrium moved with the bones.",
    )
    petsc: Options = Field(
        default={},
        description="PETSc options under the solver's prefix, with or without the leading dash; "
        "the value of a flag is true.",
    )
    units: UnitNames | None = Field(
        default=None,
        description="Units of length, force and stress, and perhaps of time, that the labels of "
        'pictures, plots and pages name: "mm, N, MPa". Nothing is converted.',
    )
    load_name: Text = Field(default="load", description="What plots call the load.")
    load_range: Range = Field(
        default=(0.0, 1.0), description="What plots show for the loads 0 and 1."
    )

    @field_validator("cells")
    @classmethod
    def _default_cells(cls, cells: int | None, info: ValidationInfo) -> int | None:
        return DEFAULT_CELLS if cells is None and is_shape(info.data.get("mesh")) else cells

    @property
    def files(self) -> dict[str, Path]:
        """The files that the scene and its tables name, by dotted keys.

        An XDMF mesh adds its HDF5 files as ``mesh.NAME``.
        """
        data = xdmf_data(self.mesh) if isinstance(self.mesh, Path) else []
        return super().files | {f"mesh.{file.name}": file for file in data}

    def build(self, comm: Any) -> Built:
        """Return mesh and arguments of the program for this scene. Collective.

        Parameters
        ----------
        comm : MPI.Intracomm
            The communicator.

        Raises
        ------
        BadInput
            On every rank, for a scene that does not fit its mesh.

        Examples
        --------
        >>> scene = scenes.load("twist", cells=4)
        >>> problem = fem_snh.NonlinearProblem(**scene.build(MPI.COMM_WORLD).arguments)
        >>> for step in problem.steps(scene.steps):
        ...     print(step["load"], step["newton"])
        """
        from fem_snh.scenes.build import build  # imports PETSc

        return build(self, comm)

    @property
    def features(self) -> list[Feature]:
        """The tables that add terms to the problem, in the order of their keys."""
        values = [value if isinstance(value, list) else [value] for _, value in self]
        return [table for value in values for table in value if isinstance(table, Feature)]

    @property
    def amplitudes(self) -> Amplitudes:
        """The amplitudes that loads and motions may name."""
        return Amplitudes(self.table, self.duration)

    @property
    def duration(self) -> float | None:
        """The time of load 1 [s]; None in a quasi-static scene."""
        return None if self.time is None else self.time.duration

    @property
    def estimates_error(self) -> bool:
        """Whether errors are estimated after the last step."""
        return bool(self.error) or self.accuracy is not None

    @property
    def within(self) -> float | None:
        """The relative error that the goals may have, or None."""
        return self.accuracy.within if self.accuracy else None

    @property
    def materials(self) -> list[MaterialChoice]:
        """The materials: one, or several with their groups."""
        return self.material if isinstance(self.material, list) else [self.material]

    @model_validator(mode="after")
    def _check_consistency(self) -> Scene:
        check_consistency(self)
        return self
