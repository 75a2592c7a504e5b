"""Evaluate the four stability properties of Smith et al. 2018, section 3.

inversion
    finite energy, stress and Hessian at every F, and a force that restores J > 0
reflection
    energy, stress and Hessian do not depend on which stretch carries the sign
rest
    no energy and no stress at rest, and Hooke's law as tangent
degeneracy
    collapsed to a plane: a force along its normal; to a line: no force and a direction
    of negative curvature; to a point: no force and no stable minimum
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import combinations_with_replacement, permutations

import numpy as np
import sympy

from fem_snh.arrays import Array
from fem_snh.kernels.material import Material
from fem_snh.kernels.reports.curves import diagonal, eigenvalues, inside, stress
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import INVARIANTS, SIGMA
from fem_snh.materials.normalise import lame

#: The verdicts on a property.
PASSED, FAILED, NOT_APPLICABLE = "passed", "failed", "not applicable"

#: Pairs of stretches of an element whose third stretch passes through 0.
PLANES = tuple(combinations_with_replacement((0.5, 1.0, 2.0), 2))
#: Stretches of which one, two and three are negative; and of which one, two and three are zero.
INVERTED = ((1.2, 0.9, -0.5), (1.2, -0.9, -0.5), (-1.2, -0.9, -0.5))
DEGENERATE = ((1.2, 0.9, 0.0), (1.2, 0.0, 0.0), (0.0, 0.0, 0.0))
#: Stretches with s1 + s2 = 0, where the polar rotation is discontinuous.
OPPOSITE = (1.2, 0.5, -0.5)
#: The four choices of signs in F = U diag(s) V^T with det U = det V = 1 for an inverted F.
FLIPS = np.array([[1, 1, -1], [1, -1, 1], [-1, 1, 1], [-1, -1, -1]], dtype=float)

#: Forces, curvatures and differences below this [E] count as zero.
_SMALL = 1e-9
#: Two distances d from a singular state at which eigenvalues are compared, and the largest accepted
#: growth from the first to the second: a pole 1/d grows by 1e4.
_DISTANCES, _MOST_GROWTH = (1e-2, 1e-6), 1e3
#: Samples of s2 from -0.99 s1 to 0 in the search for the largest stress.
_SAMPLES = 60


class Signed:
    """Energy and principal stresses at stretches (..., 3) of any signs.

    All values are NaN outside the domain. The symbolic expression is evaluated, because the kernels
    compute an SVD with one convention for the sign.
    """

    def __init__(self, energy: Energy) -> None:
        self._values = energy.values
        psi = sympy.Integer(0) if energy.psi_sigma is None else energy.psi_sigma
        limits = [d.subs(INVARIANTS) for d in energy.domain]
        modules = [{"where": lambda x, a, b: np.where(x > 0, a, b)}, "numpy"]
        arguments = (*SIGMA, *energy.constants)
        self._function = sympy.lambdify(
            arguments, ([psi, *energy.slopes], limits), modules=modules, cse=True
        )

    def _call(self, s: Array) -> Array:
        """Return psi and the three principal stresses [Pa], (..., 4)."""
        with np.errstate(all="ignore"):
            found, limits = self._function(*np.moveaxis(s, -1, 0), *self._values)
        outside = np.zeros(s.shape[:-1], dtype=bool)
        for limit in limits:
            outside |= ~(np.asarray(limit) > 0)
        out = np.stack([np.broadcast_to(f, s.shape[:-1]) for f in found], axis=-1).astype(float)
        return np.where(outside[..., None], np.nan, out)

    def energy(self, s: Array) -> Array:
        """Return psi [Pa], shape (...); 0 for a material without an energy."""
        return self._call(s)[..., 0]

    def stress(self, s: Array) -> Array:
        """Return dpsi/ds_i [Pa], shape (..., 3)."""
        return self._call(s)[..., 1:]


@dataclass(frozen=True)
class Stability:
    """The verdict on one stability property.

    Attributes
    ----------
    name : str
        The property.
    verdict : str
        "passed", "failed" or "not applicable".
    reason : str
        Why the verdict is not "passed"; "" if it is.
    numbers : dict
        The numbers behind the verdict by name; stresses in units of E.
    """

    name: str
    verdict: str
    reason: str = ""
    numbers: dict[str, float] = field(default_factory=dict)

    def __str__(self) -> str:
        return self.verdict + (f": {self.reason}" if self.reason else "")


def _verdict(name: str, faults: list[str], numbers: dict[str, float]) -> Stability:
    return Stability(name, FAILED if faults else PASSED, "; ".join(faults), numbers)


def properties(m: Material) -> tuple[Stability, Stability, Stability, Stability]:
    """Return the four stability properties, in the order of Smith et al. 2018."""
    return inversion(m), reflection(m), rest(m), degeneracy(m)


def inversion(m: Material) -> Stability:
    """Evaluate inversion stability: psi is finite for every F and drives inverted elements back.

    The Hessian has to be bounded. Numbers: ``finite``, the fraction of the states `INVERTED` and
    ``DEGENERATE`` with finite values; ``growth``, from `growth`; ``force``, from `largest_stress`
    in units of E, which must be negative.
    """
    F = diagonal(np.array(INVERTED + DEGENERATE))
    finite = inside(m, F)
    for values in (m.pk1(F), m.hessian(F)):
        finite &= np.isfinite(values).all(axis=(-1, -2))
    numbers = {"finite": float(finite.mean())}
    if not finite.all():
        turned = [0, 2, 3, 4, 5]  # two negative stretches are a rotation
        where = "some inverted states" if finite[turned].any() else "J <= 0"
        return Stability("inversion", FAILED, f"infinite for {where}", numbers)
    force = largest_stress(m)
    numbers |= {"growth": growth(m), "force": force / m.expression.E}
    faults = []
    if numbers["growth"] > _MOST_GROWTH:
        faults.append("Hessian unbounded")
    if force >= 0:
        faults.append("not driven back")
    return _verdict("inversion", faults, numbers)


def largest_stress(m: Material) -> float:
    """Return the largest dpsi/ds2 [Pa] from s2 = -0.99 s1 to s2 = 0, over the pairs of `PLANES`.

    If it is negative, the energy decreases from every inverted state to the plane s2 = 0.
    """
    worst = -np.inf
    for s1, s0 in PLANES:
        s2 = s1 * np.linspace(-0.99, 0, _SAMPLES)
        s = np.stack([np.full_like(s2, s0), np.full_like(s2, s1), s2], axis=-1)
        worst = max(worst, float(np.nanmax(stress(m, s)[:, 2])))
    return worst


def growth(m: Material) -> float:
    """Return the largest growth of the Hessian's norm from 1e-2 to 1e-6 off a singular state."""
    sizes = []
    for d in _DISTANCES:
        near = [np.add(s, d * np.array([0.3, 1.0, -0.7])) for s in (*DEGENERATE, OPPOSITE)]
        sizes.append(np.abs(eigenvalues(m, np.array(near))).max(axis=-1))
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = sizes[1] / np.maximum(sizes[0], _SMALL * m.expression.E)
    return float(ratio.max()) if np.isfinite(ratio).all() else float("inf")


def reflection(m: Material) -> Stability:
    """Evaluate reflection stability: any choice of the negative stretch gives the same values.

    The Hessian is the derivative of the stress, so it agrees where the stress does. Numbers, over
    mu + ``|lambda|``: ``energy`` and ``stress``, the largest differences between the four choices
    of signs of an inverted element; ``order``, the largest difference of the energy between the six
    orders of its stretches.
    """
    signed = Signed(m.expression)
    sizes = np.random.default_rng(7).uniform(0.3, 2.0, (24, 3))
    choices = sizes[:, None] * FLIPS
    psi, p = signed.energy(choices), signed.stress(choices)
    if not (np.isfinite(psi).all() and np.isfinite(p).all()):
        return Stability("reflection", NOT_APPLICABLE, "no inverted states in its domain")
    orders = choices[:, 0][:, list(permutations(range(3)))]
    mu, lam = lame(m.expression.E, m.expression.nu)
    scale = mu + abs(lam)
    numbers = {
        "energy": float(np.ptp(psi, axis=1).max()) / scale,
        # Two changed signs are a rotation of F, and the stress rotates with it.
        "stress": float(np.ptp(p * FLIPS, axis=1).max()) / scale,
        "order": float(np.ptp(signed.energy(orders), axis=1).max()) / scale,
    }
    faults = [f"{what} differs" for what, size in numbers.items() if size > _SMALL]
    return _verdict("reflection", faults[:1], numbers)


def rest(m: Material) -> Stability:
    """Evaluate rest stability: psi(I) = 0, P(I) = 0 and the Hessian at I is Hooke's law.

    Numbers: ``energy`` and ``stress`` at rest [E], ``Hooke`` (the largest difference between the
    Hessian and Hooke's law, relative to Hooke's law).
    """
    E, eye = m.expression.E, np.eye(3)
    mu, lam = lame(E, m.expression.nu)
    C = lam * np.einsum("ij,kl->ijkl", eye, eye)
    C += mu * (np.einsum("ik,jl->ijkl", eye, eye) + np.einsum("il,jk->ijkl", eye, eye))
    hooke = C.reshape(9, 9)
    numbers = {
        "energy": abs(float(m.energy(eye))) / E if m.expression.has_energy else 0.0,
        "stress": float(np.abs(m.pk1(eye)).max()) / E,
        "Hooke": float(np.abs(m.hessian(eye) - hooke).max() / np.abs(hooke).max()),
    }
    faults = []
    if numbers["energy"] > _SMALL:
        faults.append("energy at rest")
    if numbers["stress"] > _SMALL * (mu + abs(lam)) / E:
        faults.append(f"stress at rest {float(m.pk1(eye)[0, 0]) / E:.3g} E")
    elif numbers["Hooke"] > _SMALL:
        faults.append("not Hooke's law")
    return _verdict("rest", faults, numbers)


def degeneracy(m: Material) -> Stability:
    """Evaluate whether elements collapsed to a plane, a line or a point recover (section 3.3).

    Numbers [E]: ``plane force``, the largest stress along the normal, must be negative; ``line
    force``, across a line of length 1, must be 0; ``line curvature``, the smallest eigenvalue
    across it, must be negative; ``point force``, at F = 0, must be 0; ``point curvature``, the
    smallest eigenvalue at F = 0, must not be positive (a stable minimum).
    """
    E = m.expression.E
    crushed = diagonal(np.array([(1.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)]))
    if not inside(m, crushed).all():
        return Stability("degeneracy", NOT_APPLICABLE, "outside its domain")
    plane = np.array([(b, a, 0.0) for a, b in PLANES])
    line, point = m.pk1(crushed[1]), m.pk1(crushed[2])
    across = [4, 5, 7, 8]  # of vec(F): the directions that leave the line
    numbers = {
        "plane force": float(stress(m, plane)[:, 2].max()) / E,
        "line force": float(np.abs(line.reshape(9)[across]).max()) / E,
        "line curvature": float(_lowest(m.hessian(crushed[1])[np.ix_(across, across)])) / E,
        "point force": float(np.abs(point).max()) / E,
        "point curvature": float(_lowest(m.hessian(crushed[2]))) / E,
    }
    faults = []
    if numbers["plane force"] > -_SMALL:
        faults.append("plane")
    if numbers["line force"] > _SMALL or numbers["line curvature"] > -_SMALL:
        faults.append("line")
    if numbers["point force"] > _SMALL or numbers["point curvature"] > _SMALL:
        faults.append("point")
    return _verdict("degeneracy", [", ".join(faults)] if faults else [], numbers)


def _lowest(H: Array) -> float:
    return float(np.linalg.eigvalsh(H)[0])
