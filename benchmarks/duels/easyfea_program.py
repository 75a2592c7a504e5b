"""The duels in EasyFEA: hexahedra, an energy that JAX differentiates, MKL's Pardiso."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from EasyFEA import ElemType, Mesh, Models, Simulations
from EasyFEA.FEM import GroupElemFactory
from EasyFEA.Models._autodiff import Enable_x64
from scenes import EDGES, Duel, main

#: gmsh's order of the edges of a hexahedron.
GMSH = [
    (0, 1),
    (0, 3),
    (0, 4),
    (1, 2),
    (1, 5),
    (2, 3),
    (2, 6),
    (3, 7),
    (4, 5),
    (4, 7),
    (5, 6),
    (6, 7),
]
ORDER = [*range(8), *(8 + [tuple(sorted(e)) for e in EDGES].index(e) for e in GMSH)]


def solve(scene: Duel, degree: int, cells: int) -> dict[str, Any]:
    """Return nodes, displacements, forces and counts."""
    Enable_x64()
    x, connectivity = scene.mesh(cells, degree)
    kind = {1: ElemType.HEXA8, 2: ElemType.HEXA20}[degree]
    group = GroupElemFactory.Create(kind, connectivity[:, ORDER[: connectivity.shape[1]]], x)
    mesh = Mesh({kind: group})
    mu, bulk = scene.mu, scene.lam + scene.mu

    def energy(C: Any) -> Any:
        J = jnp.sqrt(jnp.linalg.det(C))
        return mu / 2 * (jnp.trace(C) - 3) - mu * (J - 1) + bulk / 2 * (J - 1) ** 2

    simulation = Simulations.HyperElastic(
        mesh, Models.HyperElastic.AutoDiff(3, energy), maxIter=100
    )
    simulation._Set_solutions(simulation.problemType, scene.start(x).ravel())
    loads, newton = scene.loads(x, connectivity), 0
    for load in np.arange(1, scene.steps + 1) / scene.steps:
        simulation.Bc_Init()
        fixed, values = scene.prescribed(x, load)
        for i, axis in enumerate("xyz"):
            own = fixed % 3 == i
            simulation.add_dirichlet(fixed[own] // 3, [values[own]], [axis])
            # It divides forces by the number of nodes: they are of all nodes together.
            force = load * len(x) * loads[:, i]
            simulation.add_neumann(np.arange(len(x)), [force], [axis])
        u = simulation.Solve()
        newton += simulation._Simu__newtonIter
    f = -simulation.Get_K_C_M_F()[3].toarray()
    return {"x": x, "u": u, "f": f, "newton": newton, "status": "converged"}


if __name__ == "__main__":
    main(solve)
