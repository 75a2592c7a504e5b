"""dolfinx programs with contact for tests."""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dolfinx_mesh
from dolfinx_programs import vector_space

import fem_snh
from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import group_nodes
from fem_snh.mesh import mesh

MATERIAL = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)
TIGHT = {"snes_scaled_tol": 1e-10}


def program(
    body: mesh.Mesh, moved: dict[str, float], *terms: Any, energy: Any = None
) -> fem_snh.NonlinearProblem:
    """Return a problem of degree 1 whose groups move vertically by given distances.

    Its material is `MATERIAL`, or an ``energy`` density of u in UFL takes its place.
    """
    V = vector_space(body.domain)
    u, prescribed = fem.Function(V), fem.Function(V)
    nodes = {name: group_nodes(V, body, name) for name in moved}
    for name, distance in moved.items():
        prescribed.x.array.reshape(-1, 3)[nodes[name], 2] = distance
    bcs = [_dolfinx.prescribed(prescribed, np.unique(np.concatenate(list(nodes.values()))))]
    materials, forms = ({}, [energy(u) * ufl.dx]) if energy else ({MATERIAL: ufl.dx}, [])
    return fem_snh.NonlinearProblem(
        u, materials, bcs=bcs, terms=[*forms, *terms], petsc_options=TIGHT
    )


def surface(body: mesh.Mesh, *names: str) -> Any:
    """Return the measures ds(1), ds(2), ... of groups."""
    facets = [body.group(name).entities for name in names]
    values = np.repeat(np.arange(1, len(names) + 1), [len(found) for found in facets])
    every = np.concatenate(facets)
    order = np.argsort(every)
    tags = dolfinx_mesh.meshtags(
        body.domain, 2, every[order].astype(np.int32), values[order].astype(np.int32)
    )
    ds = ufl.Measure("ds", body.domain, subdomain_data=tags)
    return [ds(number + 1) for number in range(len(names))]
