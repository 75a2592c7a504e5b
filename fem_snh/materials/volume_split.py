"""psi = psi' + U(J): what mixed elements do to a material's volume term.

psi' is the same material with a smaller lambda, lambda_local = lambda b mu/(lambda + b mu), and U
is what lambda adds to it, which has to be of J alone: (lambda - lambda_local)/2 (J - 1)^2 of the
stable Neo-Hookean energy, for one. In U's place comes a pressure p, positive in tension, so that at
a point the energy is psi' + p J and its Hessian is filtered like any other.

What psi' keeps is what resists a J that varies within a cell, which no mean and no continuous
pressure sees: with b = 0 twisted Taylor-Hood cells collapse in parts
(docs/results/elements.md). b = 4 is a
psi' of nu -> 0.4, b = 2 one of nu -> 1/3, where nothing locks yet.

mean dilatation   p = U'(J_e), J_e the mean of J over an element
Taylor-Hood       p is unknown; psi' + p J - U*(p), with U* = max_J (p J - U(J)) the conjugate
                  of U, is stationary in it where J = dU*/dp, the volume that p belongs to
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import sympy

from fem_snh.errors import BadInput
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import MEASURES, SIGMA

PRESSURE, LOCAL = sympy.symbols("pressure lambda_local", real=True)
#: b above, of lambda_local in units of mu_lame, by the volume's treatment. Linear solvers of a
#: saddle want it small, what is pressed together wants it large (docs/results/elements.md).
BOUNDS = {"mean": 4.0, "pressure": 2.0}
J = MEASURES["J"]

_Curve = tuple[sympy.Expr, sympy.Expr, sympy.Expr]


@dataclass(frozen=True)
class Split:
    """A material's energy in two parts.

    energy : psi' + pressure J, an energy with ``pressure`` (the symbol PRESSURE) beside its
        constants mu_lame, lambda_lame and lambda_local.
    volume : U(J) [Pa] in J and the constants; at nu = 0.5 J = 1 takes its place.
    """

    energy: Energy
    volume: sympy.Expr

    @property
    def stiffness(self) -> float:
        """U''(1) [Pa], lambda_lame - lambda_local; infinite at nu = 0.5."""
        return self.energy.values[1] - self.local

    @property
    def local(self) -> float:
        """lambda_local [Pa]."""
        return self.energy.values[2]

    @property
    def volume_curve(self) -> _Curve:
        """(U, U', U'') in J. Raises BadInput at nu = 0.5."""
        if math.isinf(self.stiffness):
            raise BadInput(
                f"nu = 0.5: material '{self.energy.name}' is incompressible, which takes a "
                "Taylor-Hood element (P2P1, Q2Q1)"
            )
        first = sympy.factor(sympy.diff(self.volume, J))
        return self.volume, first, sympy.diff(first, J)

    @property
    def dual_curve(self) -> _Curve:
        """(U*, J(p) = dU*/dp, dJ/dp) in PRESSURE.

        Raises BadInput where U'(J) = p has no solution in closed form, and unless nu > 0.
        """
        if math.isinf(self.stiffness):
            return PRESSURE, sympy.Integer(1), sympy.Integer(0)
        if not self.stiffness > 0:
            raise BadInput(
                f"nu = {self.energy.nu:g}: Taylor-Hood elements need a volume that resists, nu > 0"
            )
        slope = sympy.diff(self.volume, J)
        try:
            found = sympy.solve(sympy.Eq(slope, PRESSURE), J)
        except NotImplementedError:
            found = []
        # Of several branches, the one through the state at rest.
        numbers = dict(zip(self.energy.constants, self.energy.values, strict=True)) | {
            PRESSURE: 0.0
        }
        at_rest = [g for g in found if (v := g.subs(numbers)).is_finite and abs(v - 1) < 1e-9]
        if len(at_rest) != 1 or at_rest[0].has(sympy.LambertW):
            raise BadInput(
                f"material '{self.energy.name}': the pressure of its volume term {self.volume} "
                "cannot be inverted in closed form, which Taylor-Hood elements need: take Q1P0 or "
                "P2P0, or a material with another volume term"
            )
        volume = sympy.simplify(at_rest[0])
        conjugate = PRESSURE * volume - self.volume.subs(J, volume)
        return sympy.simplify(conjugate), volume, sympy.simplify(sympy.diff(volume, PRESSURE))


def split(law: Energy, bound: float) -> Split:
    """The energy ``law`` in two parts. Raises BadInput if lambda adds more to it than a U(J).

    bound : of lambda_local [mu_lame]; 0 for the classical mean dilatation of some energies.
    """
    if law.psi is None:
        raise BadInput(f"material '{law.name}' has no energy: take Q1, Q2, P1 or P2")
    psi = law.by_lame()
    mu, lam = law.lame
    local = bound * mu if math.isinf(lam) else lam * bound * mu / (lam + bound * mu)
    rest = psi.subs(law.lambda_symbol, LOCAL)
    terms = sympy.Add.make_args(sympy.expand(psi - rest))
    volumes = [_of_volume(law, term) for term in terms]
    if None in volumes or sympy.Add(*volumes) == 0:
        raise BadInput(
            f"material '{law.name}' has no volume term, one in J alone that brings lambda, which "
            "mixed elements need: take Q1, Q2, P1 or P2"
        )
    made = law.at_pressure(rest, PRESSURE, {LOCAL: local})
    # Factors, (J - 1)^2, not J^2 - 2 J + 1: lambda times its rounding is larger than p.
    return Split(made, sympy.factor(sympy.simplify(sympy.Add(*volumes))))


def _of_volume(law: Energy, term: sympy.Expr) -> sympy.Expr | None:
    """An additive term as one in J, or None if it depends on another measure."""
    if law.of_stretches:
        a, b, c = sympy.symbols("a b J", positive=True)
        signless = dict(zip(SIGMA, (a, b, c / (a * b)), strict=True))
        term = sympy.simplify(sympy.expand_log(term.subs(signless, simultaneous=True)))
        return term.subs(c, J) if not term.free_symbols & {a, b} else None
    return term if term.free_symbols & set(law.measures) <= {J} else None
