"""Energy terms of a scene: each an energy with its derivatives, in a file of its own.

A term has ``name``, ``energy(u)`` [J] and ``add_residual(u, r)``; `Elastic` also has the Jacobian.
A scene's problem holds the terms the scene names, and no others. `mass_matrix` is what inertia
brings to eigenfrequencies.
"""

from fem_snh.fem.terms.elastic import Elastic
from fem_snh.fem.terms.mass import mass_matrix
from fem_snh.fem.terms.traction import Traction

__all__ = ["Elastic", "Traction", "mass_matrix"]
