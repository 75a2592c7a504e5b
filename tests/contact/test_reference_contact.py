"""Self-contact by the map to the reference configuration: forces, derivatives, ranks, scenes."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import contact_problems
import numpy as np
import pytest
from bodies import Condition, Hold, create_problem
from two_bodies import NU, E, TwoBlocks

import fem_snh
from fem_snh import scenes
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.contact.reference_contact import ReferenceContact
from fem_snh.kernels.material import material
from fem_snh.mesh import mesh

COMM = MPI.COMM_WORLD
mpi = pytest.mark.mpi
#: Two blocks, the upper one smaller, with meshes that do not match.
BLOCKS = {"cells": 2, "upper_cells": 3, "upper_width": 0.7, "shift": 0.13}
CLIP: dict[str, Any] = {
    "name": "clip", "mesh": {"source": "clip", "parameters": {"gap": 0.3}}, "cells": 2,
    "element": "Q1", "steps": 2, "material": {"name": "stable_neo_hookean", "E": 1e4, "nu": 0.45},
    "move": [{"group": "bottom", "translate": [0, 0, 0.25]},
             {"group": "top", "translate": [0, 0, -0.25]}],
    "self_contact": {"method": "reference"},
}  # fmt: skip


def blocks(
    comm: MPI.Comm = COMM, element: str = "Q1", press: float = 0.1, k: Any = None, **of: float
) -> Any:
    """Return the problem of two blocks that are pressed together, and its last row."""
    chosen = ELEMENTS[element]
    body = mesh.generate(comm, "two_blocks", chosen.cell, **(BLOCKS | of))
    p = create_problem(
        body,
        chosen,
        material("stable_neo_hookean", E, NU),
        hold=[Hold("bottom")],
        move=[Condition("top", lambda X, load: 0 * X - [0, 0, press * load])],
        loads=lambda body, u, cells, _: [ReferenceContact(u.function_space, body.skin, cells, k)],
    )
    return p, contact_problems.press(p, tolerance=1e-8)


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("element", ["Q1", "P1", "P2", "Q1P0", "Q2Q1"])
def test_force_is_that_of_contact_between_surfaces(element: str) -> None:
    """The oracle is contact between two named surfaces, with its own search and quadrature."""
    args = {name: value for name, value in BLOCKS.items() if "cells" not in name}
    args |= {"press": 0.1, "hold": [Hold("bottom")], "components": ("x", "y", "z")}
    two = TwoBlocks(COMM, element, (2, 3), 20.0, **args)
    expected = -two.solve()["contacts"]["blocks"]["force"][2]
    step = blocks(element=element, k=20.0)[1]
    row = step["self_contact"]
    assert row["force"] == pytest.approx(expected, rel=0.05)
    assert row["stiffness"] == pytest.approx(20.0) and step["solves"] <= 5
    assert 0 < row["penetration"] < 0.05  # a tenth of a cell; the edges press most


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("first", ["energy", "forces", "Hessian", "row"])
def test_one_function_of_new_pairs(first: str) -> None:
    """Whatever is evaluated first has the pairs that it searches, as everything after it has.

    The line goes from the equilibrium to a state with other pairs. Springs with constant normals
    have forces that are linear in the displacement where none begins to push, so differences are
    exact to rounding.
    """
    p, _ = blocks(press=0.1)
    term, start, d = p.terms[1], p.x.copy(), p.x.duplicate()
    X = p.coordinates
    motion = np.zeros(X.shape)
    motion[:, 0], motion[X[:, 2] > 1, 2] = 0.3 * X[:, 2], -0.2
    d.array[:], h, old = motion.ravel(), 1e-7, term.springs

    def at(t: float) -> Any:
        x = start.copy()
        x.axpy(t, d)
        return x

    def forces(t: float) -> Any:
        x, r = at(t), start.duplicate()
        p.gradient(x, r, [term])
        return r

    def hessian(t: float) -> Any:
        u = p.split(at(t))[0]
        p.matrix.couple([term.couplings(u)])
        with p.matrix.adding():
            term.add_hessian(u, None, "exact", p.matrix)
        product = start.duplicate()
        p.matrix.mat.mult(d, product)
        product.array[p.constrained_dofs] = 0.0
        return product

    evaluate = {
        "energy": lambda t: term.energy(p.split(at(t))[0]),
        "forces": forces,
        "Hessian": hessian,
        "row": lambda t: term.record(p.split(at(t))[0])["self_contact"]["force"],
    }
    term.begin_step(p.split(start)[0])
    before = evaluate[first](1.0 - h)
    assert not np.array_equal(term.springs.sample, old.sample)
    again = evaluate[first](1.0 - h)
    if first in ("forces", "Hessian"):
        assert (before - again).norm() == 0 < again.norm()
    else:
        assert before == again > 0
    slope = (evaluate["energy"](1.0 + h) - evaluate["energy"](1.0 - h)) / (2 * h)
    assert slope == pytest.approx(forces(1.0).dot(d), rel=1e-6)
    curved = forces(1.0 + h) - forces(1.0 - h)
    curved.array[p.constrained_dofs] = 0.0
    d.array[p.constrained_dofs] = 0.0
    expected = hessian(1.0)
    assert (curved - 2 * h * expected).norm() < 1e-5 * 2 * h * expected.norm()


@mpi
def test_the_pressure_is_that_of_the_deformed_surface() -> None:
    """Two blocks become 1.5 times as wide in x; the upper one enters the lower one by 0.05."""
    p, _ = blocks(gap=0.05, press=0.0, shift=0.0, upper_cells=2, upper_width=1.0, k=20.0)
    X, term = p.coordinates, p.terms[1]
    p.x.array[:] = np.column_stack([X[:, 0] / 2, 0 * X[:, 1], -0.1 * (X[:, 2] > 1.02)]).ravel()
    u = p.split(p.x)[0]
    term.begin_step(u)  # its search
    true = term.nodal_field("contact_pressure", u)
    nominal = term.nodal_field("nominal_contact_pressure", u)
    x = p.V.tabulate_dof_coordinates()[:, 0]
    inside = (x > 0.01) & (x < 0.99) & (nominal > 0)  # of no side, which is as wide as before
    assert COMM.allreduce(int(inside.sum())) >= 6
    np.testing.assert_allclose(true[inside], nominal[inside] / 1.5, rtol=1e-10)


@pytest.mark.one_debian
@mpi
def test_a_clip_whose_arms_are_pressed_together() -> None:
    """A run of a scene on all ranks and on one: rows, columns, the same numbers."""
    scene = scenes.validate(CLIP, "clip")
    runs = [fem_snh.run(scene, progress=False, comm=comm) for comm in (COMM, MPI.COMM_SELF)]
    last = [run.steps[-1]["self_contact"] for run in runs]
    assert runs[0].converged and runs[0].record["terms"] == ["elastic", "self_contact"]
    assert last[0]["pairs"] == last[1]["pairs"] > 100
    assert last[0]["force"] == pytest.approx(last[1]["force"], rel=1e-3)
    assert last[0]["penetration"] < 0.05 * 0.5 and runs[0].steps[-1]["solves"] <= 5
    without = scenes.validate({k: v for k, v in CLIP.items() if k != "self_contact"}, "clip")
    through = fem_snh.run(without, progress=False)
    assert through.record["terms"] == ["elastic"]
    assert through.steps[-1]["energy"] < 0.97 * runs[0].steps[-1]["energy"]


@mpi
def test_a_row_says_what_a_search_of_all_targets_would_change() -> None:
    """Beside a term without history at the last displacement."""
    result = fem_snh.run(scenes.validate(CLIP | {"cells": 3}, "clip"), progress=False)
    p, row = result.problem, result.steps[-1]
    (term,) = (t for t in p.terms if isinstance(t, ReferenceContact))
    fresh = ReferenceContact(p.V, None, p.regions)
    u, forces = p.split(p.x)[0], []
    for each in (term, fresh):
        r = u.duplicate()
        with r.localForm() as local:
            local.set(0)
        each.add_residual(u, None, r, None)
        r.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        forces.append(r.array)
    kept, free = (COMM.allreduce(np.abs(f).max(initial=0), op=MPI.MAX) for f in forces)
    change = COMM.allreduce(np.abs(forces[1] - forces[0]).max(initial=0), op=MPI.MAX)
    assert row["self_contact"]["change"] == pytest.approx(change / max(kept, free), rel=1e-6)
    assert change / kept > 0.01 and row["notes"] == ["targets"]
    (note,) = (n for n in result.notes if n["kind"] == "targets")
    assert note["change"] == max(r["self_contact"]["change"] for r in result.steps)


@pytest.mark.parametrize("scene", ["clip", "arm"])
def test_no_line_search_compares_energies_of_different_pairs(scene: str) -> None:
    """Jaws that shear as they close, and a bar bent by 160 degrees: no step fails.

    While the first energy of a step was that of the pairs of the last step, both failed a line
    search at a load where pairs change.
    """
    turn = {"axis": [0, 1, 0], "through": [3, 0.5, 1], "angle": 2.8}
    tables: dict[str, dict[str, Any]] = {
        "clip": {
            "steps": 10,
            "move": [{"group": "bottom", "translate": [0, 0, 0.35]},
                     {"group": "top", "translate": [0.2, 0, -0.35]}],
        },
        "arm": {
            "mesh": {"source": "bar", "parameters": {"length": 6, "interface": 3}}, "steps": 14,
            "hold": [{"group": "left"}], "move": [{"group": "right", "rotate": turn}],
        },
    }  # fmt: skip
    result = fem_snh.run(scenes.validate(CLIP | tables[scene], scene), progress=False)
    assert [row["reason"] for row in result.steps] == ["CONVERGED_FNORM_ABS"] * len(result.steps)
    assert len(result.steps) == tables[scene]["steps"]
    assert result.steps[-1]["self_contact"]["pairs"] > 0


def fingers() -> Any:
    """Two fingers on a palm in a lattice, whose bones turn towards each other.

    The gap is half of a cell wide, so that both pass through some of the cells.
    """
    capsules = [((-0.07, 0, 0), (-0.07, 0, 0.2), 0.06), ((0.07, 0, 0), (0.07, 0, 0.2), 0.06)]
    palm = ((-0.07, 0, -0.02), (0.07, 0, -0.02), 0.07)
    shapes = [
        {"capsule": dict(zip(("from", "to", "radius"), c, strict=True))} for c in (*capsules, palm)
    ]
    bones = [
        {
            "name": name,
            "shape": {"capsule": {"from": [x, 0, 0.1], "to": [x, 0, 0.2], "radius": 0.025}},
            "rotate": {"axis": [0, 1, 0], "through": [x, 0, 0], "angle": turn},
        }
        for name, x, turn in (("left", -0.07, 0.1), ("right", 0.07, -0.1))
    ]
    palm_bone = {"name": "palm", "shape": {"sphere": {"center": [0, 0, -0.02], "radius": 0.05}}}
    table = {
        "name": "fingers", "mesh": {"lattice": {"union": shapes}, "cell": 0.04}, "element": "Q1",
        "steps": 2, "material": {"name": "stable_neo_hookean", "E": 2e4, "nu": 0.45},
        "bone": [palm_bone, *bones], "self_contact": {"method": "reference"},
    }  # fmt: skip
    return scenes.validate(table, "fingers")


@mpi
def test_fingers_of_a_lattice() -> None:
    """The skin touches, not the cells, which overlap in the mesh: no pair pushes at rest."""
    result = fem_snh.run(fingers(), progress=False)
    rows = [row["self_contact"] for row in result.steps]
    assert result.converged and rows[0]["pairs"] == 0 and rows[0]["force"] == 0
    assert rows[1]["pairs"] > 0 and 0 < rows[1]["penetration"] < 0.05 * 0.04
    without = fingers().model_copy(update={"self_contact": None})
    assert fem_snh.run(without, progress=False).steps[1]["energy"] < result.steps[1]["energy"]
