# %% [markdown]
# # A block of two materials on a spring foundation
#
# A block of soft and stiff rubber is pressed onto a foundation that pushes back where the block
# sinks into it, and does not pull where it lifts off. The materials come by meshtags, and the
# foundation is an energy of one's own:
#
# $$
# E_f = \int_\Gamma \frac{k}{2} \min(u_z, 0)^2 \, \mathrm{d}A .
# $$
#
# dolfinx assembles it; its Hessian is filtered facet by facet. A `Constant` raises the load.
#
# ![Settlement of the bottom for three loads](foundation.png)
#
# ```bash
# mpirun -n 2 python demos/foundation.py
# ```

# %%
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh
from matplotlib.figure import Figure

import fem_snh

parser = ArgumentParser(description="Two materials on a spring foundation.")
parser.add_argument("--cells", type=int, default=6, help="along the height")
parser.add_argument("--out", type=Path, default=Path("out/foundation"))
args = parser.parse_args()
comm, n = MPI.COMM_WORLD, args.cells

# %% [markdown]
# ## Mesh, tags and space, by dolfinx: cells 1 (soft) and 2, loaded top 3, bottom 4

# %%
hexahedra = mesh.CellType.hexahedron
domain = mesh.create_box(comm, [[0, 0, 0], [3, 1, 1]], [3 * n, n, n], hexahedra)
new = hasattr(fem, "functionspace")  # since dolfinx 0.7
V = fem.functionspace(domain, ("P", 1, (3,))) if new else fem.VectorFunctionSpace(domain, ("P", 1))


def tagged(dim, parts):
    """Return meshtags of entities: those of (tag, entities) pairs."""
    entities = np.hstack([found for _, found in parts])
    values = np.hstack([np.full(len(found), tag, np.int32) for tag, found in parts])
    order = np.argsort(entities)
    return mesh.meshtags(domain, dim, entities[order], values[order])


soft_cells = mesh.locate_entities(domain, 3, lambda x: x[0] < 1.5 + 1e-9)
stiff_cells = mesh.locate_entities(domain, 3, lambda x: x[0] > 1.5 - 1e-9)
cells = tagged(3, [(1, soft_cells), (2, stiff_cells)])
pressed = mesh.locate_entities_boundary(
    domain, 2, lambda x: np.isclose(x[2], 1) & (abs(x[0] - 1.5) < 0.5 + 1e-9)
)
bottom = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[2], 0))
dx = ufl.Measure("dx", domain=domain, subdomain_data=cells)
metadata = {"quadrature_degree": 4}  # the same for energy and force, where a facet lifts off
tags = tagged(2, [(3, pressed), (4, bottom)])
ds = ufl.Measure("ds", domain=domain, subdomain_data=tags, metadata=metadata)

# %% [markdown]
# ## The problem
#
# Rollers on two faces: conditions on single components.

# %%
u = fem.Function(V)
k, pressure, zero = (fem.Constant(domain, value) for value in (2.0, 0.0, 0.0))
bcs = []
for c in (0, 1):
    face = mesh.locate_entities_boundary(domain, 2, lambda x, c=c: np.isclose(x[c], 0))
    bcs.append(fem.dirichletbc(zero, fem.locate_dofs_topological(V.sub(c), 2, face), V.sub(c)))
soft = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.45)
stiff = fem_snh.material("stable_neo_hookean", E=5.0, nu=0.45)
sinking = ufl.conditional(ufl.lt(u[2], 0), u[2], 0)
terms = [k / 2 * sinking**2 * ds(4), pressure * u[2] * ds(3)]
materials = {soft: dx(1), stiff: dx(2)}
problem = fem_snh.NonlinearProblem(u, materials, bcs=bcs, terms=terms)

# %% [markdown]
# ## The loop over loads: at equilibrium the foundation carries the load

# %%
force = fem.form(k * sinking * ds(4))
area = comm.allreduce(fem.assemble_scalar(fem.form(fem.Constant(domain, 1.0) * ds(3))))
X, owned = V.tabulate_dof_coordinates(), V.dofmap.index_map.size_local
middle = np.flatnonzero(np.isclose(X[:owned, 2], 0) & np.isclose(X[:owned, 1], 0))
lines = {}
for value in (0.05, 0.1, 0.2):
    pressure.value = value
    problem.solve()
    assert problem.solver.getConvergedReason() > 0
    carried = comm.allreduce(fem.assemble_scalar(force))
    assert abs(carried + value * area) < 1e-4 * value * area
    points = comm.gather(np.stack([X[middle, 0], u.x.array.reshape(-1, 3)[middle, 2]], axis=1))
    if comm.rank == 0:
        lines[value] = np.array(sorted(map(tuple, np.vstack(points))))
        print(f"pressure {value}: the foundation carries {-carried:.6f} of {value * area:.6f}")

# %%
if comm.rank == 0:
    figure = Figure(figsize=(6, 3.6), layout="constrained")
    ax = figure.subplots()
    for value, line in lines.items():
        ax.plot(*line.T, label=f"pressure {value}")
    ax.set(xlabel="x (soft to 1.5, then stiff)", ylabel="$u_z$ of the bottom")
    ax.legend(frameon=False)
    args.out.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.out / "foundation.png", dpi=150)
    print(f"picture: {args.out / 'foundation.png'}")
    assert lines[0.2][:, 1].max() > 0  # lifts off
