"""One trilinear cell in motion, by numpy and the textbooks' formulas: an oracle for Dynamics.

Nodes are the corners of the unit cube; the functions of a material are the only ones of ours.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

#: Corners, (8, 3), and the points of Gauss's rule with two points in each direction.
CORNERS = np.array(list(product((0.0, 1.0), repeat=3)))
POINTS = (1 + (2 * CORNERS - 1) / np.sqrt(3)) / 2


def basis(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the values (8,) and gradients (8, 3) of the corners' functions at a point."""
    factors = np.where(CORNERS > 0, x, 1 - x)
    signs = 2 * CORNERS - 1
    others = np.stack([np.prod(np.delete(factors, i, axis=1), axis=1) for i in range(3)], axis=1)
    return factors.prod(axis=1), signs * others


VALUES, GRADIENTS = (np.array(part) for part in zip(*map(basis, POINTS), strict=True))


class OneCell:
    """Forces, stiffness and mass of a cell of a material and a density; u and v are (8, 3)."""

    def __init__(self, material, density: float) -> None:
        self.material = material
        self.M = np.kron(density / 8 * VALUES.T @ VALUES, np.eye(3))

    def F(self, u: np.ndarray) -> np.ndarray:
        return np.eye(3) + np.einsum("ai,qaj->qij", u, GRADIENTS)

    def force(self, u: np.ndarray) -> np.ndarray:
        P = self.material.pk1(self.F(u))
        return np.einsum("qij,qaj->ai", P, GRADIENTS).ravel() / 8

    def stiffness(self, u: np.ndarray) -> np.ndarray:
        H = self.material.hessian(self.F(u)).reshape(-1, 3, 3, 3, 3)  # [q, column, row, ...]
        K = np.einsum("qjilk,qaj,qbl->aibk", H, GRADIENTS, GRADIENTS)
        return K.reshape(24, 24) / 8

    def steps(
        self, integrator: str, h: float, count: int, u: np.ndarray, v: np.ndarray
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield u and v after each step, (8, 3)."""
        M, f = self.M, self.force
        u, v = u.ravel(), v.ravel()
        a = np.linalg.solve(M, -f(u.reshape(8, 3)))
        before, rho = None, 0.8
        alpha_m, alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
        if integrator == "newmark":
            alpha_m = alpha_f = 0.0
        gamma, beta = 0.5 - alpha_m + alpha_f, 0.25 * (1 - alpha_m + alpha_f) ** 2
        for _ in range(count):
            x = u.reshape(8, 3)
            if integrator == "semi_implicit":
                d = np.linalg.solve(M / h**2 + self.stiffness(x), M @ v / h - f(x))
                u, v = u + d, d / h
            elif integrator in ("newmark", "generalized_alpha"):
                end = u + h * v + h**2 * (0.5 - beta) * a
                old = alpha_m * M @ a + alpha_f * f(x)
                u1 = self._solved(u, end, (1 - alpha_m) / (beta * h**2), 1 - alpha_f, old)
                a1 = (u1 - end) / (beta * h**2)
                u, v, a = u1, v + h * ((1 - gamma) * a + gamma * a1), a1
            else:
                k, u_, v_ = 1.0, u, v
                if integrator == "bdf2" and before is not None:
                    k, u_, v_ = 1.5, 2 * u - before[0] / 2, 2 * v - before[1] / 2
                u1 = self._solved(u, (u_ + h / k * v_) / k, (k / h) ** 2, 1.0, 0.0)
                before = u, v
                u, v = u1, (k * u1 - u_) / h
            yield u.reshape(8, 3), v.reshape(8, 3)

    def _solved(self, u, origin, rate, weight, constant):
        """Return the zero of rate M (u - origin) + weight f(u) + constant, by Newton's method."""
        for _ in range(30):
            x = u.reshape(8, 3)
            r = rate * self.M @ (u - origin) + weight * self.force(x) + constant
            d = np.linalg.solve(rate * self.M + weight * self.stiffness(x), r)
            u = u - d
            if np.abs(d).max() < 1e-14:
                break
        return u

    def energy_and_spin(self, u: np.ndarray, v: np.ndarray) -> tuple[float, float]:
        """Return the kinetic energy and the angular momentum about z through the origin."""
        p = (self.M @ v.ravel()).reshape(8, 3)
        return float((v * p).sum()) / 2, float(np.cross(CORNERS + u, p).sum(axis=0)[2])
