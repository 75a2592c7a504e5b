"""Blocks without friction whose surfaces end at the same edge: they may slide off each other."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from gmsh_files import section
from plane_scenes import solve
from rectangles import rectangle
from scipy.optimize import fsolve
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import eigsh

import fem_snh
from fem_snh.kernels.material import material

mpi = pytest.mark.mpi

SCENE = """
mesh = "blocks.msh"
element = "P2"
kinematics = "plane_strain"
steps = 4
material = {{ name = "stable_neo_hookean", E = 1.0, nu = 0.3 }}
symmetry = [{{ group = "axis" }}, {{ group = "bottom" }}]
traction = [{{ group = "top", vector = [0, -{load}, 0] }}]
"""


def blocks(folder, cells, load, touch=True):
    """Return the scene of two unit squares of triangles, one on the other, or of one column."""
    if MPI.COMM_WORLD.rank == 0:
        with section(folder / "blocks.msh") as (geo, groups, bodies):
            for low, high in ((0, 1), (1, 2)) if touch else ((0, 2),):
                size = cells, (high - low) * cells
                lines, surface = rectangle(geo, (0, low), (1, high), size, True)
                groups |= {"bottom" if low == 0 else "over": [lines[0]]}
                groups |= {"top" if high == 2 else "under": [lines[2]]}
                groups.setdefault("axis", []).append(lines[3])
                bodies[f"block_{low}"] = [surface]
        contact = 'contact = [{ groups = ["under", "over"] }]' if touch else ""
        (folder / "blocks.toml").write_text(SCENE.format(load=load) + contact)
    MPI.COMM_WORLD.barrier()
    return folder / "blocks.toml"


def second_frequency(problem):
    """Return the second eigenvalue of the Hessian, with the L2 product of displacements."""
    V = problem.V
    u, v = ufl.TrialFunction(V), ufl.TestFunction(V)
    problem.jacobian(problem.x, "exact")
    mass = fem.petsc.assemble_matrix(fem.form(ufl.inner(u, v) * ufl.dx))
    mass.assemble()
    H, M = (csr_matrix(A.getValuesCSR()[::-1]).tocsc() for A in (problem.A, mass))
    return np.sort(eigsh(H, 3, M, sigma=-0.01, return_eigenvectors=False))[1]


def test_every_halving_of_cells_takes_the_same_from_the_stiffness_of_flush_blocks(tmp_path):
    r"""Their state is uniform, and the exact one has no least eigenvalue.

    If one surface slides by s over the other, a strip of this width loses the pressure p. It is
    next to the corner, which it moves by about p s/E log(1/s): the energy changes by
    -p^2 s^2/E log(1/s), and cells of size h see log(1/h). One column has no such mode.
    """

    def lowest(cells, touch):
        return second_frequency(solve(blocks(tmp_path, cells, 0.08, touch)).problem)

    flush = np.diff([lowest(cells, True) for cells in (8, 16, 32)])
    column = np.diff([lowest(cells, False) for cells in (8, 16)])
    assert (flush < -0.004).all() and flush[1] == pytest.approx(flush[0], rel=0.2)
    assert abs(column[0]) < 0.1 * abs(flush[0])


@mpi
def test_blocks_that_may_slide_off_stay_on_their_path_and_are_called_unstable(comm, tmp_path):
    """Beyond a load P2 has no stable state; the uniform one is that of the stress alone."""
    result = fem_snh.run(blocks(comm.bcast(tmp_path), 4, 0.4), comm=comm, progress=False)
    assert result.converged
    if comm.size == 1:  # on ranks rounding decides how the step leaves its unstable path
        # 23, if full steps do not begin at the unstable state that is known.
        assert result.steps[2]["newton"] < 15
    row = result.steps[-1]
    assert row["negative_eigenvalues"] == 1 and row["notes"] == ["unstable", "stabilised"]
    assert "let one reach beyond the other" in result.record["notes"][-2]["text"]

    def lack(stretches):
        pk1 = material("stable_neo_hookean", E=1.0, nu=0.3).pk1(np.diag([*stretches, 1.0]))
        return pk1[0, 0], pk1[1, 1] + 0.4

    (pair,) = row["contacts"].values()
    _, stretch = fsolve(lack, (1.0, 0.7), xtol=1e-12)
    down = comm.allreduce(result.problem.nodal(result.problem.x)[:, 1].min(), op=MPI.MIN)
    assert -down == pytest.approx(2 * (1 - stretch) + 0.4 / pair["stiffness"], rel=1e-6)
