"""The duels in Newton: tetrahedra of degree 1, its VBD solver on the CPU, in time until at rest."""

from __future__ import annotations

from typing import Any

import newton
import numpy as np
import warp as wp
from scenes import Duel, main

#: Steps of a frame of 1/60 s each in ten parts, as in its examples of soft bodies.
STEP, ITERATIONS = 1 / 600, 10
#: The body rests if no node moves by more than this share of its size within so many steps.
REST, WINDOW = 2e-5, 60
#: E / (density L^2) [1/s^2] and damping over E [s]: those of the bar, at any scale.
RATE, DAMPING = 125.0, 1e-2
#: The six tetrahedra of a hexahedron.
TETRAHEDRA = [(0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6), (0, 5, 1, 6)]


def forces(x: np.ndarray, u: np.ndarray, tets: np.ndarray, lam: float, mu: float) -> np.ndarray:
    """Return the internal forces (n, 3) of eq. 13 of Smith et al. in double precision."""
    edges = [(y[tets[:, 1:]] - y[tets[:, :1]]).transpose(0, 2, 1) for y in (x, x + u)]
    F, volume = edges[1] @ np.linalg.inv(edges[0]), np.linalg.det(edges[0]) / 6
    a, b, c = F.transpose(2, 0, 1)
    cofactor = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    J = np.linalg.det(F)[:, None, None]
    P = mu * F + ((lam + mu) * (J - 1) - mu) * cofactor
    H = volume[:, None, None] * P @ np.linalg.inv(edges[0]).transpose(0, 2, 1)
    f = np.zeros_like(x)
    for i in range(3):
        np.add.at(f, tets[:, i + 1], H[..., i])
    np.add.at(f, tets[:, 0], -H.sum(axis=2))
    return f


def solve(scene: Duel, degree: int, cells: int) -> dict[str, Any]:
    """Return nodes, displacements, forces and counts."""
    wp.config.quiet = True
    x, connectivity = scene.mesh(cells)
    tets = connectivity[:, np.array(TETRAHEDRA)].reshape(-1, 4)
    size = float(np.ptp(x, axis=0).max())
    density = scene.E / (RATE * size**2)
    builder = newton.ModelBuilder(gravity=wp.vec3(0, 0, scene.body_force[2] / density))
    builder.add_soft_mesh(
        pos=wp.vec3(0, 0, 0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0, 0, 0),
        vertices=[wp.vec3(*p) for p in x],
        indices=tets.ravel().tolist(),
        density=density,
        k_mu=scene.mu,
        k_lambda=scene.lam,
        k_damp=DAMPING * scene.E,
    )
    fixed = np.unique(scene.prescribed(x, 1.0)[0] // 3)
    for node in fixed:
        builder.particle_flags[node] &= ~int(newton.ParticleFlags.ACTIVE)
        builder.particle_mass[node] = 0.0
    builder.color()
    model = builder.finalize()
    solver = newton.solvers.SolverVBD(
        model, iterations=ITERATIONS, particle_enable_tile_solve=False
    )
    state, other, control = model.state(), model.state(), model.control()
    place = (x + scene.start(x)).astype(np.float32)
    state.particle_q.assign(place)
    moving, steps, before = scene.steps > 1, 0, place
    while True:
        steps += 1
        load = min(1.0, steps / (WINDOW * scene.steps / 4))
        if moving:
            place = state.particle_q.numpy().copy()
            u = np.zeros_like(x)
            dofs, values = scene.prescribed(x, load)
            u.flat[dofs] = values
            place[fixed] = (x + u)[fixed]
            state.particle_q.assign(place)
        state.clear_forces()
        solver.step(state, other, control, None, STEP)
        state, other = other, state
        if steps % WINDOW == 0 and load == 1.0:
            place = state.particle_q.numpy().copy()
            if not np.isfinite(place).all():
                raise FloatingPointError(f"positions are not finite after {steps} steps")
            if np.abs(place - before).max() < REST * size:
                break
            before = place
    u = state.particle_q.numpy() - x
    f = forces(x, u, tets, scene.lam, scene.mu)
    return {"x": x, "u": u, "f": f, "newton": steps, "status": f"at rest after {steps} time steps"}


if __name__ == "__main__":
    main(solve)
