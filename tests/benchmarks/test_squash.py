"""The octopus between cylinders: its mesh, linearised contact, and its benchmark's distances."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import cube
from contact_problems import plane, translation

from fem_snh import _dolfinx
from fem_snh.contact.law import ContactLaw
from fem_snh.contact.obstacle_contact import RigidContact
from fem_snh.contact.obstacle_pair import ObstaclePair
from fem_snh.contact.surface_quadrature import SurfaceQuadrature

mpi = pytest.mark.mpi


def pair_below(comm, motion):
    """The contact of a unit cube, 0.01 deep in a plane that moves; and the nodes."""
    V = _dolfinx.function_space(cube(comm, "tetrahedron", 2).domain, 1, (3,))
    surface, X = SurfaceQuadrature(V), V.tabulate_dof_coordinates()
    obstacle = plane((0, 0, 0.01), motion=motion)
    chosen = RigidContact("plane", obstacle)
    law = ContactLaw(chosen, "obstacle", surface.weights, np.full(1, 100.0), height=0.5)
    return ObstaclePair("plane", surface, X, obstacle, law), X


@mpi
def test_linearised_contact_follows_a_plane_that_recedes(comm):
    pair, X = pair_below(comm, translation((0, 0, -0.05)))
    u = np.zeros_like(X)

    def force(u):
        return comm.allreduce(pair.nodal_forces(u)[:, 2].sum())

    assert force(u) == pytest.approx(100 * 0.01)
    for linearised in (False, True):
        pair.linearised = linearised
        pair.set_load(0.0)
        pair.begin_step(u)
        pair.set_load(1.0)  # the plane is now 0.04 below the cube
        assert force(u) == pytest.approx(-100 * 0.04 if linearised else 0.0)
        curved = comm.allreduce(np.abs(pair.matrices(u, "clamp")[1]).sum())
        assert (curved > 0) == linearised
        # At another displacement the plane only pushes.
        assert force(u - (0, 0, 0.03)) == 0.0
        assert force(u - (0, 0, 0.06)) == pytest.approx(100 * 0.02)
        pair.end_step(u)
        assert force(u) == 0.0
