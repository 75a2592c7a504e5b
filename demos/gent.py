# %% [markdown]
# # A material of your own: Gent's rubber
#
# A material is one function that returns one expression. This one is Gent's energy
# {cite}`Gent1996`, completed like stable Neo-Hookean so that it is stress-free at rest:
#
# $$
# \psi = -\frac{\mu L}{2} \log\left(1 - \frac{I_C - 3}{L}\right)
#        - \mu (J - 1) + \frac{\lambda}{2} (J - 1)^2 .
# $$
#
# It stiffens without bound as $I_C - 3$ approaches the limit $L$ of the polymer chains. Stress,
# Hessian, eigensystem, filters and C kernels are derived from the expression, and $\mu$, $\lambda$
# are fitted to $(E, \nu)$.
#
# ![Stress against stretch of Gent and stable Neo-Hookean](gent.png)
#
# ```bash
# mpirun -n 2 python demos/gent.py
# ```
#
# The same function works on the command line and in scene files:
#
# ```bash
# fem-snh materials demos/gent.py:gent --report
# fem-snh run pull --material demos/gent.py:gent
# ```

# %%
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

import numpy as np
from matplotlib.figure import Figure
from sympy import log

import fem_snh


def gent(I_C, J, mu, lam, *, limit=30.0):
    """Gent 1996, stable at rest; infinite where I_C - 3 >= limit."""
    return -mu * limit / 2 * log(1 - (I_C - 3) / limit) - mu * (J - 1) + lam / 2 * (J - 1) ** 2


# %% [markdown]
# Arguments are deformation measures (`I1`, `I_C`, `II_C`, `J`, or the stretches `s0`, `s1`, `s2`),
# then the constants to be fitted, then keyword-only shape parameters. At a point the material
# behaves like a built-in one:

# %%
parser = ArgumentParser(description="A material of one's own.")
parser.add_argument("--cells", type=int, default=6, help="along an edge")
parser.add_argument("--out", type=Path, default=Path("out/gent"))


def stress(material, stretches):
    """Return the nominal uniaxial stress [Pa] at constant volume, for each of ``stretches``."""
    F = np.array([np.diag([s, s**-0.5, s**-0.5]) for s in stretches])
    P = material.pk1(F)
    return P[:, 0, 0] - P[:, 1, 1] * stretches**-1.5


# %%
if __name__ == "__main__":
    args = parser.parse_args()
    snh = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.49)
    own = fem_snh.material(gent, E=1.0, nu=0.49, limit=10.0)
    assert np.allclose(own.lame, snh.lame)
    assert own.energy(np.diag([4.0, 1.0, 1.0])) == np.inf  # I_C - 3 = 15: beyond the limit
    inverted = np.diag([1.0, 1.0, -0.2])
    assert np.linalg.eigvalsh(own.hessian(inverted, filter="clamp")).min() > -1e-12

    # A cube pulled to twice its length, with both materials; neither has an origin barrier.
    force = {}
    for name, material, shape in (
        ("gent", gent, {"material.limit": 10.0}),
        ("stable_neo_hookean", "stable_neo_hookean", {"material.barrier": False}),
    ):
        options = {"cells": args.cells, "out": args.out / name, "overwrite": True, **shape}
        result = fem_snh.run("pull", material=material, **options)
        assert result.converged, result.status
        force[name] = result.steps[-1]["reactions"]["right"][0]

    if MPI.COMM_WORLD.rank == 0:
        stretches = np.linspace(1, 3.2, 200)
        figure = Figure(figsize=(6, 4.2), layout="constrained")
        ax = figure.subplots()
        ax.plot(stretches, stress(own, stretches), label="Gent, limit = 10")
        ax.plot(stretches, stress(snh, stretches), label="stable Neo-Hookean")
        ax.set(xlabel="stretch", ylabel="nominal stress [E]", title="uniaxial, incompressible")
        ax.legend(frameon=False)
        figure.savefig(args.out / "gent.png", dpi=200)
        print(f"force at twice the length: {force}\npicture: {args.out / 'gent.png'}")
    assert force["gent"] > force["stable_neo_hookean"]
