"""The duels in fedoo: hexahedra, simcoon's Neo-Hookean energy, its Newton method, MKL's Pardiso."""

from __future__ import annotations

from typing import Any

import fedoo
import numpy as np
from scenes import Duel, main

#: Stiffness of contact over E h.
PENALTY = 100.0


def solve(scene: Duel, degree: int, cells: int) -> dict[str, Any]:
    """Return nodes, displacements, forces and counts."""
    x, connectivity = scene.mesh(cells, degree)
    fedoo.ModelingSpace("3D")
    nodes, lowest = len(x), x[:, 2].min()
    if scene.plane:  # a face that moves up from below
        x = np.vstack(
            [x, [(i, j, lowest) for i, j in ((-25, -25), (25, -25), (25, 25), (-25, 25))]]
        )
    mesh = fedoo.Mesh(x, connectivity, {1: "hex8", 2: "hex20"}[degree])
    law = fedoo.constitutivelaw.Simcoon("NEOHC", np.array([scene.mu, scene.lam + 2 / 3 * scene.mu]))
    method = "fbar" if degree == 1 and scene.lam > 10 * scene.mu else None
    form = fedoo.weakform.StressEquilibrium(law, nlgeom="UL", incompressibility=method)
    body = fedoo.Assembly.create(form, mesh)
    parts = [body]
    if scene.plane or len(scene.parts) > 1:
        slaves = np.flatnonzero(scene.touching(x[:nodes]))
        masters = np.arange(nodes, nodes + 4)[None]
        if not scene.plane:  # the upper block's nodes on the lower block's faces
            masters = connectivity[scene.touching(x)[connectivity[:, 4:8]].all(axis=1), 4:8]
            slaves = np.setdiff1d(slaves, masters)
        surface = fedoo.Mesh(x, masters[:, [(0, 1, 2), (0, 2, 3)]].reshape(-1, 3), "tri3")
        contact = fedoo.constraint.Contact(slaves, surface, search_algorithm="search_nearest")
        size = abs(lowest) or 1.0
        contact.eps_n, contact.max_dist = PENALTY * scene.E * size / cells, 4 * size
        parts.append(contact)
    problem = fedoo.problem.NonLinear(fedoo.Assembly.sum(*parts) if len(parts) > 1 else body)
    names, loads = ("DispX", "DispY", "DispZ"), scene.loads(x[:nodes], connectivity)
    if scene.plane:
        problem.bc.add("Dirichlet", np.arange(nodes, nodes + 4), "Disp", [0, 0, scene.plane])
    for chosen, component, value in scene.conditions:
        at = np.flatnonzero(chosen(x[:nodes]))
        end, half = (value(x[at], load) for load in (1.0, 0.5))
        if np.allclose(2 * half, end):
            problem.bc.add("Dirichlet", at, names[component], end)
            continue
        for node in at:  # its functions of time return one number
            problem.bc.add(
                "Dirichlet",
                [node],
                names[component],
                1.0,
                time_func=lambda load, i=node, value=value: float(value(x[[i]], load)[0]),
            )
    for name, force in zip(names, loads.T, strict=True):
        if len(on := np.flatnonzero(force)):
            problem.bc.add("Neumann", on, name, force[on])
    counts = [0]
    iterate = problem.solve_nr_increment

    def counted() -> Any:
        counts[0] += 1
        return iterate()

    problem.solve_nr_increment = counted
    if scene.scatter:
        problem.set_dof("Disp", scene.start(x).T)
    problem.nlsolve(dt=1 / scene.steps, dt_min=1 / scene.steps / 64, print_info=0)
    newton = counts[0]
    u = np.column_stack([problem.get_disp(name) for name in names])
    f = np.reshape(problem.get_ext_forces(), (3, -1)).T
    return {"x": x, "u": u, "f": f, "newton": newton, "status": "converged"}


if __name__ == "__main__":
    main(solve)
