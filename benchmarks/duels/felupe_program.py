"""The duels in FElupe: Q1P0 or Q2 hexahedra, its Newton method, MKL's Pardiso."""

from __future__ import annotations

from typing import Any

import felupe
import numpy as np
import pypardiso
from felupe.math import cdya_ik, cdya_il, det, dya, inv, transpose
from scenes import Duel, main

#: Stiffness of its contact over the mean stiffness of the nodes.
PENALTY = 30.0


def material(mu: float, lam: float) -> Any:
    """Return mu/2 (I_C - 3) - mu (J - 1) + lam/2 (J - 1)^2, written in FElupe's way."""

    def stress(x: Any, **_: Any) -> Any:
        J, iFT = det(x[0]), transpose(inv(x[0]))
        return [mu * x[0] + (lam * (J - 1) - mu) * J * iFT, x[-1]]

    def elasticity(x: Any, **_: Any) -> Any:
        J, iFT, eye = det(x[0]), transpose(inv(x[0])), np.eye(3)[..., None, None]
        s = (lam * (J - 1) - mu) * J
        return [mu * cdya_ik(eye, eye) + (lam * J**2 + s) * dya(iFT, iFT) - s * cdya_il(iFT, iFT)]

    return felupe.Material(stress, elasticity)


def solve(scene: Duel, degree: int, cells: int) -> dict[str, Any]:
    """Return nodes, displacements, forces and counts."""
    x, connectivity = scene.mesh(cells, degree)
    nodes, lowest = len(x), x[:, 2].min()
    if scene.plane:  # the node that moves the plane
        x = np.vstack([x, [0, 0, lowest]])
    mesh = felupe.Mesh(x, connectivity, "hexahedron" if degree == 1 else "hexahedron20")
    region = (felupe.RegionHexahedron if degree == 1 else felupe.RegionQuadraticHexahedron)(mesh)
    field = felupe.FieldContainer([felupe.Field(region, dim=3)])
    bulk = scene.lam + scene.mu
    if degree == 1 and not scene.scatter:  # Q1P0: its element for nearly incompressible bodies
        body = felupe.SolidBodyNearlyIncompressible(material(scene.mu, 0), field, bulk=bulk)
    else:
        body = felupe.SolidBody(material(scene.mu, bulk), field)
    load = felupe.PointLoad(field, np.arange(nodes))
    items = [body, load]
    if scene.plane:
        ball = np.flatnonzero(scene.touching(x[:nodes]))
        items.append(
            felupe.ContactRigidPlane(
                field,
                ball,
                nodes,
                [0, 0, 1],
                items=[body],
                multiplier=PENALTY,
                multiplier_tangential=0,
            )
        )
    forces, newton = scene.loads(x[:nodes], connectivity), 0
    field[0].values[:nodes] = scene.start(x[:nodes])
    for part in np.arange(1, scene.steps + 1) / scene.steps:
        fixed, values = scene.prescribed(x[:nodes], part)
        if scene.plane:
            fixed = np.append(fixed, 3 * nodes + np.arange(3))
            values = np.append(values, [0, 0, scene.plane * part])
        load.update(part * forces)
        found = felupe.newtonraphson(
            x0=field,
            items=items,
            dof0=fixed,
            dof1=np.setdiff1d(np.arange(x.size), fixed),
            ext0=values,
            solver=pypardiso.spsolve,
            verbose=0,
            maxiter=100,
        )
        newton += int(found.iterations)
    f = body.assemble.vector(field).toarray()
    return {"x": x, "u": field[0].values, "f": f, "newton": newton, "status": "converged"}


if __name__ == "__main__":
    main(solve)
