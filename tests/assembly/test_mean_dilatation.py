"""Q1P0 and the textbook's element of mean dilatation, at small strain, by an independent assembly.

Of both, 2 mu dev(eps) acts at the quadrature points. The volume's stiffness acts on the cell's mean
of div u: in the textbook's element all of it (Simo, Taylor & Pister 1985), in Q1P0 all but that of
lambda_local (`fem_snh.materials.volume_split`), which with mu's part stays at the points.
"""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

import fem_snh
from fem_snh.materials.parameters import BOUNDS
from fem_snh.scenes.builtin.block import LAM, MU

#: Edge of the modelled quarter of the block [mm], and a load so small that the answer is linear.
SIDE, PRESSURE = 50.0, 3e-4
CORNERS = np.array(list(product((0, 1), repeat=3)))
GAUSS = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3)


def gradients(h):
    """The gradients of a cube's trilinear shape functions at its 8 Gauss points, (8, 8, 3)."""
    found = np.empty((8, 8, 3))
    for q, x in enumerate(product(GAUSS, repeat=3)):
        factor = np.where(CORNERS, x, 1 - np.array(x))
        slope = np.where(CORNERS, 1, -1) / h
        for i in range(3):
            found[q, :, i] = slope[:, i] * np.delete(factor, i, axis=1).prod(axis=1)
    return found


def cell_stiffness(h, local, mean):
    """2 mu dev(eps) and ``local`` div u at the points, ``mean`` times the mean of div u."""
    B = gradients(h)
    strain = np.zeros((8, 24, 3, 3))
    for a, i in product(range(8), range(3)):
        strain[:, 3 * a + i, i, :] += B[:, a] / 2
        strain[:, 3 * a + i, :, i] += B[:, a] / 2
    trace = np.trace(strain, axis1=2, axis2=3)
    deviator = strain - trace[..., None, None] * np.eye(3) / 3
    K = 2 * MU * np.einsum("qaij,qbij->ab", deviator, deviator)
    K += local * np.einsum("qa,qb->ab", trace, trace)
    return h**3 / 8 * (K + 8 * mean * np.outer(trace.mean(axis=0), trace.mean(axis=0)))


def solve(n, local, mean):
    """-u_z of the quarter block at its middle and at the rim of the loaded patch [mm]."""
    h = SIDE / n
    grid = np.arange((n + 1) ** 3).reshape(n + 1, n + 1, n + 1)
    K, f = np.zeros((3 * grid.size, 3 * grid.size)), np.zeros(3 * grid.size)
    element = cell_stiffness(h, local, mean)
    for cell in product(range(n), repeat=3):
        nodes = grid[tuple((np.array(cell) + CORNERS).T)]
        dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
        K[np.ix_(dofs, dofs)] += element
        if cell[2] == n - 1 and max(cell[:2]) < n // 2:
            f[3 * nodes[CORNERS[:, 2] == 1] + 2] -= PRESSURE * h**2 / 4
    top = grid[:, :, -1].ravel()
    rollers = [3 * grid[0].ravel(), 3 * grid[:, 0].ravel() + 1, 3 * grid[:, :, 0].ravel() + 2]
    free = np.setdiff1d(np.arange(len(f)), np.concatenate([*rollers, 3 * top, 3 * top + 1]))
    u = np.zeros(len(f))
    u[free] = np.linalg.solve(K[np.ix_(free, free)], f[free])
    return -u[3 * grid[[0, n // 2], [0, n // 2], -1] + 2]


def own(n):
    local = BOUNDS["mean"] * MU * LAM / (LAM + BOUNDS["mean"] * MU)
    return solve(n, local + 2 / 3 * MU, LAM - local)


@pytest.mark.one_debian
def test_the_element_at_small_strain():
    result = fem_snh.run("block", element="Q1P0", cells=4, pressure=PRESSURE, steps=1,
                         progress=False, petsc={"snes_scaled_tol": 1e-12})  # fmt: skip
    probes = result.steps[-1]["probes"]
    found = [-probes[name][2] for name in ("middle", "rim")]
    assert found == pytest.approx(own(4), rel=1e-4)  # strains are 4e-5
