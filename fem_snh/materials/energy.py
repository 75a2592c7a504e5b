"""An energy density as one symbolic expression, with the values of its constants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import sympy

from fem_snh.materials import normalise
from fem_snh.materials.invariants import INVARIANTS, MEASURES, SIGMA, domain

#: The symbols of the small-strain constants in `Energy.by_lame`.
LAME = sympy.symbols("mu_lame lambda_lame", real=True)


def principal_stresses(psi: sympy.Expr) -> tuple[sympy.Expr, ...]:
    """Return the three dpsi/ds_i in terms of the stretches; psi may be written in invariants."""
    psi = psi.subs(INVARIANTS)
    return tuple(sympy.diff(psi, s) for s in SIGMA)


@dataclass(frozen=True, eq=False)
class Energy:
    """An energy density psi(F) [Pa], zero at F = I, with constants that match (E, nu).

    Attributes
    ----------
    name : str
        Name or reference of the material, or the name of its function.
    E : float
        Young's modulus [Pa].
    nu : float
        Poisson's ratio.
    shape : dict
        Values of the shape parameters and of the given tuning keywords, by name.
    measures : tuple of sympy.Symbol
        Invariants or stretches in which ``psi`` is written.
    constants : tuple of sympy.Symbol
        The material's own constants, e.g. (mu, lam).
    values : tuple of float
        Values of ``constants`` [Pa]; inf where nu = 0.5 requires it.
    psi : sympy.Expr or None
        The expression in ``measures`` and ``constants``; None if the material has a stress only.
    stress : tuple of sympy.Expr or None
        Principal PK1 stresses of a material without an energy.
    barriers : frozenset of sympy.Expr
        Arguments of `fem_snh.materials.invariants.positive`.
    fit : normalise.Normalisation
        The equations between ``constants`` and the small-strain constants.
    pressure : sympy.Symbol or None
        A pressure in ``psi``, which the element supplies at each quadrature point (see
        `fem_snh.materials.volume_split`).
    equation : str
        The variant and its source; "" for a material without variants.
    """

    name: str
    E: float
    nu: float
    shape: dict[str, Any]
    measures: tuple[sympy.Symbol, ...]
    constants: tuple[sympy.Symbol, ...]
    values: tuple[float, ...]
    psi: sympy.Expr | None
    stress: tuple[sympy.Expr, ...] | None
    barriers: frozenset[sympy.Expr]
    fit: normalise.Normalisation
    pressure: sympy.Symbol | None = None
    equation: str = ""

    @property
    def has_energy(self) -> bool:
        """Return True if the stress is the gradient of an energy."""
        return self.psi is not None

    @property
    def incompressible(self) -> bool:
        """Return True at nu = 0.5, which requires mixed elements."""
        return self.nu == 0.5

    @property
    def of_stretches(self) -> bool:
        """Return True if the energy is written in the principal stretches."""
        return bool(set(self.measures) & set(SIGMA))

    @property
    def needs_stretches(self) -> bool:
        """Return True if the energy needs the singular values of F, not only I_C, II_C and J."""
        return any(str(m) in {"I1", "s0", "s1", "s2"} for m in self.measures)

    @property
    def inversion_safe(self) -> bool:
        """Return True if the energy is finite for every F."""
        return not self.domain

    @cached_property
    def domain(self) -> tuple[sympy.Expr, ...]:
        """Return expressions in ``measures`` that must be positive; elsewhere the energy is +inf.

        The expressions are the arguments of log and `positive`, and the bases of powers with a
        fractional exponent, except expressions that are positive for every F or within a `where`.
        """
        return domain(self.expressions, self.measures, self.barriers)

    @property
    def expressions(self) -> tuple[sympy.Expr, ...]:
        """Return (psi,), or the three principal stresses of a material without an energy."""
        return self.slopes if self.psi is None else (self.psi,)

    @cached_property
    def psi_sigma(self) -> sympy.Expr:
        """Return psi in the principal stretches ``s0, s1, s2``; None without an energy."""
        return None if self.psi is None else self.psi.subs(INVARIANTS)

    @cached_property
    def slopes(self) -> tuple[sympy.Expr, ...]:
        """Return the principal PK1 stresses dpsi/ds_i [Pa] in the stretches and constants."""
        if self.stress is not None:
            return self.stress
        return principal_stresses(self.psi)

    @cached_property
    def lame(self) -> tuple[float, float]:
        """Return (mu_lame, lambda_lame) [Pa] from the second derivatives of the energy at rest.

        At nu = 0.5 they are (E/3, inf).

        Notes
        -----
        PK1-linearisation (Chen & Barbic, eq. 3, 4): in the stretches, linear elasticity is
        mu sum (s_i - 1)^2 + lambda/2 (sum s_i - 3)^2.
        """
        if self.incompressible:
            return normalise.lame(self.E, self.nu)
        mu, lam = (float(e.subs(self._numbers)) for e in normalise.linearised(self.slopes))
        return mu, lam

    @cached_property
    def rest_stress(self) -> float:
        """Return the principal PK1 stress at F = I [Pa]; 0 if the rest state is free of stress."""
        stress = sympy.simplify(normalise.at_rest(self.slopes[0]))
        return float(stress.subs(self._numbers))

    @property
    def _numbers(self) -> dict[sympy.Symbol, float]:
        return dict(zip(self.constants, map(sympy.Float, self.values), strict=True))

    def evaluate(self, module: str | dict[str, Any], *measures: object) -> Any:
        """Return psi [Pa] at ``measures``, in the arithmetic of ``module``.

        Parameters
        ----------
        module : str or dict
            Where `sympy.lambdify` finds log, exp, ...: "mpmath", or names mapped to functions.
        *measures : Any
            One value for each of ``self.measures``, in the same order.
        """
        call = sympy.lambdify((*self.measures, *self.constants), self.psi, modules=module)
        return call(*measures, *self.values)

    def as_text(self) -> str:
        """Return a text for cache keys: energies with equal texts have the same kernels."""
        barriers = sorted(self.barriers, key=str)
        parts = (
            self.measures,
            self.constants,
            self.psi,
            self.stress,
            tuple(barriers),
            self.pressure,
        )
        return str(sympy.srepr(parts))

    def by_lame(self) -> sympy.Expr:
        """Return psi with its constants expressed by the symbols mu_lame and lambda_lame."""
        if self.constants == LAME:
            return self.psi
        assert self.psi is not None
        solution = self.fit.solve(LAME, self.E)
        return self.psi.subs(dict(zip(self.constants, solution, strict=True)), simultaneous=True)

    def at_pressure(
        self, psi: sympy.Expr, pressure: sympy.Symbol, constants: Mapping[sympy.Symbol, float]
    ) -> Energy:
        """Return the energy ``psi + pressure J``.

        Parameters
        ----------
        psi : sympy.Expr
            Expression in the symbols of `by_lame` and of ``constants``.
        pressure : sympy.Symbol
            Pressure [Pa], positive in tension.
        constants : mapping
            Constants besides mu_lame and lambda_lame, with their values [Pa].
        """
        assert self.psi is not None
        J = MEASURES["J"]
        stretches = self.of_stretches
        return replace(
            self,
            constants=(*LAME, *constants),
            values=(*normalise.lame(self.E, self.nu), *constants.values()),
            pressure=pressure,
            measures=self.measures if stretches else tuple(dict.fromkeys((*self.measures, J))),
            psi=psi + pressure * (J.subs(INVARIANTS) if stretches else J),
        )
