"""Penalty and augmented Lagrangian on the same scenes: force, penetration, iterations.

The force of a quasi-static scene is compared with that of an augmented Lagrangian whose tolerance
is 1e-6 of V^(1/3) and whose residual is a thousandth of the default. In time ``energy`` is what the
energy has grown by at the end, what friction dissipated included, and ``largest_energy`` the most
that it has, both in the largest kinetic energy: without damping neither may be above 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks import Row, contact_patch, plates, split_list
from fem_snh.choices import CONTACT_METHODS
from fem_snh.contact import law
from fem_snh.contact.obstacle import Obstacle
from fem_snh.errors import choose
from fem_snh.mesh.gmsh_model import session
from fem_snh.runs import run
from fem_snh.scenes import Contact, Hold, MaterialChoice, Scene, load

#: Tolerances of the reference solution: of the gap in V^(1/3), of the residual in E V^(2/3).
_GAP, _RESIDUAL = 1e-6, 1e-10
#: A quarter of a cord of radius 1, with `cells` cells along the radius and one along its axis x.
_CORD = """
Point(1) = {0, 0, 0}; Point(2) = {0, 1, 0}; Point(3) = {0, 0, 1};
Line(1) = {1, 2}; Circle(2) = {2, 1, 3}; Line(3) = {3, 1};
Curve Loop(1) = {1, 2, 3}; Plane Surface(1) = {1};
Mesh.MeshSizeMin = 1 / cells; Mesh.MeshSizeMax = 1 / cells; Mesh.ElementOrder = order;
e[] = Extrude {1 / cells, 0, 0} { Surface{1}; Layers{1}; };
Physical Volume("body") = {e[1]};
Physical Surface("x = 0") = {1}; Physical Surface("x = 1") = {e[0]};
Physical Surface("z = 0") = {e[2]}; Physical Surface("surface") = {e[3]};
Physical Surface("y = 0") = {e[4]};
"""


def o_ring(
    folder: Path, squeeze: float = 0.25, nu: float = 0.499, cells: int = 6, friction: float = 0.0
) -> Scene:
    """Return a straight O-ring in plane strain between plates that squeeze it, in 5 steps."""
    path = folder / "cord.geo"
    path.write_text(f"cells = {cells}; order = 2;\n{_CORD}", encoding="utf-8")
    with session() as gmsh:
        gmsh.open(str(path))
        gmsh.model.mesh.generate(3)
        gmsh.write(str(path.with_suffix(".msh")))
    plate = {"plane": {"point": [0, 0, 1], "normal": [0, 0, -1]}}
    sides = (("x = 0", "x"), ("x = 1", "x"), ("y = 0", "y"), ("z = 0", "z"))
    return Scene(
        name="o_ring",
        mesh=path.with_suffix(".msh"),
        element="P2P1",
        steps=5,
        material=MaterialChoice(name="stable_neo_hookean", E=1.0, nu=nu),
        hold=[Hold.model_validate({"group": g, "components": [axis]}) for g, axis in sides],
        obstacle=[
            Obstacle.model_validate(
                {
                    "name": "plate",
                    "shape": plate,
                    "translate": [0, 0, -squeeze],
                    "group": "surface",
                    "friction": friction,
                }
            )
        ],
    )


#: The scenes by name: a function of a folder for files.
SCENES: dict[str, Callable[[Path], Scene]] = {
    "hertz": lambda folder: load("hertz", depth=0.2),
    "hertz_half_space": lambda folder: load("hertz", depth=0.2, half_space=True),
    "ssnv104": lambda folder: load("hertz", depth=2.0),
    "press": lambda folder: load("press"),
    "press_friction": lambda folder: load("press", friction=0.3),
    "patch": lambda folder: contact_patch.blocks(
        "Q1", 2, 3, Contact(groups=("lower_top", "upper_bottom"))
    ),
    "o_ring": o_ring,
    "o_ring_0.4": lambda folder: o_ring(folder, nu=0.4),
    "o_ring_friction": lambda folder: o_ring(folder, friction=0.3),
    "bounce": lambda folder: load("bounce"),
    "bounce_bdf2": lambda folder: load("bounce", integrator="bdf2"),
    "bounce_friction": lambda folder: load("bounce", friction=0.3),
    "plates_bdf2": lambda folder: plates.plates("Q1", "bdf2", "penalty"),
    "squash": lambda folder: load("squash"),
}


def rows(
    scenes: str = ",".join(SCENES), methods: str = ",".join(CONTACT_METHODS), factors: str = "1"
) -> Iterator[Row]:
    """Run each scene with each method: one row per scene, method and stiffness.

    Parameters
    ----------
    scenes : str
        Names of `SCENES`.
    methods : str
        Of `fem_snh.choices.CONTACT_METHODS`.
    factors : str
        Stiffnesses of contact, as multiples of the default.
    """
    with TemporaryDirectory() as folder:
        for name in split_list(scenes):
            scene = SCENES[choose("scenes", name, SCENES)](Path(folder))
            force = None if scene.time else _force(_last(run(_tight(scene), progress=False)))
            for method in split_list(methods):
                for factor in map(float, split_list(factors)):
                    yield measure(name, _with(scene, method=method), force, factor)


def measure(name: str, scene: Scene, exact: float | None, factor: float) -> Row:
    """Return what a run costs, its force over the exact one, and its penetration."""
    default, law.FACTOR = law.FACTOR, law.FACTOR * factor
    try:
        result = run(scene, progress=False)
    finally:
        law.FACTOR = default
    steps = [step for step in result.steps if step["converged"]]
    touching = [row for step in steps for row in _contacts(step)]
    size = result.problem.length
    row: Row = {
        "scene": name,
        "method": (scene.contact or scene.obstacle)[0].method,
        "factor": factor,
        "dofs": result.problem.dofs,
        "converged": result.converged,
        "steps": len(steps),
        "failed": len(result.steps) - len(steps),
        "newton": sum(step["newton"] for step in result.steps),
        "linear": sum(step["linear"] for step in result.steps),
        "solves": max(step["solves"] for step in steps),
        "penetration": max(found["penetration"] for found in touching) / size,
    }
    if scene.time and result.converged:
        start = result.record["time"]["start"]["energy"]
        fall = max(step["kinetic"] for step in steps)
        row["energy"] = (steps[-1]["energy"] + steps[-1]["dissipated"] - start) / fall
        row["largest_energy"] = (max(step["energy"] for step in steps) - start) / fall
        row["largest_force"] = max(_force(step) for step in steps)
    elif result.converged and exact:
        row["force"] = _force(steps[-1]) / exact
    return {key: float(f"{v:.4g}") if isinstance(v, float) else v for key, v in row.items()}


def _with(scene: Scene, **keys: Any) -> Scene:
    """Return the scene with keys of its tables of contact."""
    changed = {
        name: [table.model_copy(update=keys) for table in getattr(scene, name)]
        for name in ("contact", "obstacle")
    }
    return scene.model_copy(update=changed)


def _tight(scene: Scene) -> Scene:
    """Return the scene with an augmented Lagrangian of small tolerances."""
    residual = min(_RESIDUAL, 1e-3 * float(scene.petsc.get("snes_scaled_tol") or 1e-7))
    found = _with(scene, method=CONTACT_METHODS[1], tolerance=_GAP)
    return found.model_copy(update={"petsc": {**scene.petsc, "snes_scaled_tol": residual}})


def _last(result: Any) -> dict[str, Any]:
    assert result.converged, result.status
    return dict(result.steps[-1])


def _contacts(step: dict[str, Any]) -> list[dict[str, Any]]:
    return [*step.get("contacts", {}).values(), *step.get("obstacles", {}).values()]


def _force(step: dict[str, Any]) -> float:
    """Return the largest vertical force of a step's contacts [N]."""
    return max(abs(row["force"][2]) for row in _contacts(step))
