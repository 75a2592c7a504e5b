# %% [markdown]
# # FEniCSx's hyperelasticity tutorial in one load step
#
# [The tutorial](https://jsdokken.com/dolfinx-tutorial/chapter2/hyperelasticity.html) of Dokken and
# Wells bends a cantilever of Neo-Hookean rubber by a traction at its end. Its Newton solver takes
# the load in nine steps, and diverges if it gets all of it in one. This page has the tutorial's
# mesh, space, tags, conditions and loads, and then `fem_snh.NonlinearProblem` in place of its
# solver: the whole load in one step.
#
# ![The beam's axis after the tutorial's nine steps and after one](tutorial_beam.png)
#
# ```bash
# mpirun -n 2 python demos/tutorial_beam.py
# ```

# %%
from argparse import ArgumentParser
from pathlib import Path
from time import perf_counter

from mpi4py import MPI

import dolfinx.fem.petsc
import dolfinx.nls.petsc
import numpy as np
import ufl
from dolfinx import fem, mesh
from matplotlib.figure import Figure

import fem_snh

parser = ArgumentParser(description="The tutorial's beam, by its solver and by ours.")
parser.add_argument("--cells", default="20,5,5", help="along the edges")
parser.add_argument("--out", type=Path, default=Path("out/tutorial_beam"))
args = parser.parse_args()
comm, cells = MPI.COMM_WORLD, [int(n) for n in args.cells.split(",")]

# %% [markdown]
# ## The tutorial's problem

# %%
L, E, nu = 20.0, 1e4, 0.3
domain = mesh.create_box(comm, [[0, 0, 0], [L, 1, 1]], cells, mesh.CellType.hexahedron)
new = hasattr(fem, "functionspace")  # since dolfinx 0.7
V = fem.functionspace(domain, ("P", 2, (3,))) if new else fem.VectorFunctionSpace(domain, ("P", 2))
left = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[0], 0))
right = mesh.locate_entities_boundary(domain, 2, lambda x: np.isclose(x[0], L))
facets, tags = np.hstack([left, right]), np.repeat([1, 2], [len(left), len(right)])
order = np.argsort(facets)
facet_tag = mesh.meshtags(domain, 2, facets[order], tags[order].astype(np.int32))
bcs = [fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, left), V)]
B, T = fem.Constant(domain, (0.0, 0.0, 0.0)), fem.Constant(domain, (0.0, 0.0, 0.0))
u, v = fem.Function(V), ufl.TestFunction(V)
steps, degree = 9, {"quadrature_degree": 4}
ds = ufl.Measure("ds", domain=domain, subdomain_data=facet_tag, metadata=degree)
dx = ufl.Measure("dx", domain=domain, metadata=degree)

# %% [markdown]
# Its stored energy is `neo_hookean` here, so `m.ufl(F)` gives the tutorial's residual.

# %%
m = fem_snh.material("neo_hookean", E=E, nu=nu)
F = ufl.variable(ufl.Identity(3) + ufl.grad(u))
P = ufl.diff(m.ufl(F), F)
residual = ufl.inner(ufl.grad(v), P) * dx - ufl.inner(v, B) * dx - ufl.inner(v, T) * ds(2)


def axis():
    """Return, on rank 0, the deformed axis of the beam: (n, 2) coordinates x and z."""
    X, owned = V.tabulate_dof_coordinates(), V.dofmap.index_map.size_local
    on_axis = np.flatnonzero(np.isclose(X[:owned, 1:], 0.5).all(axis=1))
    points = (X[:owned] + u.x.array.reshape(-1, 3)[:owned])[on_axis][:, ::2]
    found = comm.gather(np.hstack([X[on_axis, :1], points]))
    return sorted(map(tuple, np.vstack(found))) if found else []


# %% [markdown]
# ## The tutorial's solver

# %%
kind = getattr(fem.petsc, "NewtonSolverNonlinearProblem", fem.petsc.NonlinearProblem)
newton = dolfinx.nls.petsc.NewtonSolver(comm, kind(residual, u, bcs))
newton.atol = newton.rtol = 1e-8
newton.convergence_criterion = "incremental"
start, theirs = perf_counter(), [axis()]
for n in range(1, steps + 1):
    T.value[2] = -1.5 * n
    assert newton.solve(u)[1]
    u.x.scatter_forward()
    theirs.append(axis())
tutorial_seconds = perf_counter() - start

# %% [markdown]
# ## Three lines in its place: the loads are an energy

# %%
start, u.x.array[:] = perf_counter(), 0.0
loads = -ufl.inner(B, u) * dx - ufl.inner(T, u) * ds(2)
options = {"snes_scaled_tol": 1e-9}
problem = fem_snh.NonlinearProblem(u, {m: dx}, bcs=bcs, terms=[loads], petsc_options=options)
problem.solve()
our_seconds, ours = perf_counter() - start, axis()
assert problem.solver.getConvergedReason() > 0

# %%
if comm.rank == 0:
    figure = Figure(figsize=(6, 4.2), layout="constrained")
    ax = figure.subplots()
    for line in theirs:
        ax.plot(*np.array(line)[:, 1:].T, ".-", color="0.6", markersize=4)
    ax.lines[0].set_label(f"the tutorial's {steps} load steps")
    ax.plot(*np.array(ours)[:, 1:].T, label="NonlinearProblem, one step")
    ax.set(xlabel="x", ylabel="z", aspect="equal")
    ax.legend(frameon=False)
    args.out.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.out / "tutorial_beam.png", dpi=150)
    print(f"tutorial: {tutorial_seconds:.1f} s; NonlinearProblem: {our_seconds:.1f} s")
    print(f"picture: {args.out / 'tutorial_beam.png'}")
    assert np.allclose(ours, theirs[-1], atol=1e-4)
