"""The duels in jax-fem on the CPU: hexahedra, its Newton method, SciPy's SuperLU."""

from __future__ import annotations

import logging
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax_fem import logger
from jax_fem.generate_mesh import Mesh
from jax_fem.problem import Problem
from jax_fem.solver import solver
from scenes import Duel, main

logger.setLevel(logging.WARNING)


class Body(Problem):
    """Eq. 13 of Smith et al. by automatic differentiation, with a body force and a traction."""

    scene: Duel

    def get_tensor_map(self) -> Any:
        """Return P(grad u)."""
        mu, bulk = self.scene.mu, self.scene.lam + self.scene.mu

        def energy(F: Any) -> Any:
            J = jnp.linalg.det(F)
            return mu / 2 * ((F**2).sum() - 3) - mu * (J - 1) + bulk / 2 * (J - 1) ** 2

        return lambda grad: jax.grad(energy)(grad + jnp.eye(3))

    def get_mass_map(self) -> Any:
        """Return minus the body force."""
        return lambda u, x: -jnp.array(self.scene.body_force)

    def get_surface_maps(self) -> list[Any]:
        """Return minus the traction at a load, of the faces that are loaded."""
        return [lambda u, x, load: -load * jnp.array(self.scene.traction)]


def solve(scene: Duel, degree: int, cells: int) -> dict[str, Any]:
    """Return nodes, displacements, forces and counts."""
    x, connectivity = scene.mesh(cells, degree)
    kind, count = {1: "HEX8", 2: "HEX20"}[degree], [0]
    Body.scene = scene
    on = jnp.array(scene.loaded(x))
    body = Body(
        Mesh(x, connectivity, ele_type=kind),
        vec=3,
        dim=3,
        ele_type=kind,
        dirichlet_bc_info=[[], [], []],
        location_fns=[lambda point, node: on[node]],
    )
    fe, update = body.fes[0], body.newton_update

    def counted(solution: Any) -> Any:
        count[0] += 1
        return update(solution)

    body.newton_update = counted
    u = jnp.array(scene.start(x))
    for load in np.arange(1, scene.steps + 1) / scene.steps:
        fixed, values = scene.prescribed(x, load)
        fe.node_inds_list, fe.vec_inds_list = [fixed // 3], [fixed % 3]
        fe.vals_list = [jnp.array(values)]
        body.internal_vars_surfaces = [
            [jnp.full(s.shape[:2], load)] for s in body.physical_surface_quad_points
        ]
        count[0] -= 1
        options = {
            "umfpack_solver": {},
            "initial_guess": [u],
            "line_search_flag": bool(scene.scatter),
        }
        (u,) = solver(body, options)
    (f,) = body.compute_residual([u])
    return {"x": x, "u": u, "f": f, "newton": count[0], "status": "converged"}


if __name__ == "__main__":
    main(solve)
