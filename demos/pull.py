# %% [markdown]
# # Chen & Barbič, Figure 3: more or less nonlinear, the same at small strain
#
# A cube of 1 m is clamped at two opposite faces and pulled apart: the total force on a face against
# their distance. The exponent `alpha` makes stable Neo-Hookean softer or stiffer at large
# stretches and leaves the small ones alone
# ([theory](../theory/energies.md#nonlinearity-and-mixing)). The figure states neither $E$, nor
# $\nu$, nor its values of
# $\alpha$, so shapes are compared.
#
# | | Chen & Barbič | this program |
# |---|---|---|
# | stiffness at rest | the same for every $\alpha$ | 1.0720 to 1.0722 N/m |
# | $\alpha = 1$ | concave | concave |
# | larger $\alpha$ | stiffer | 0.518 N ($\alpha = 0.5$) to 2.134 N ($\alpha = 2$) at 2 m |
#
# ![Force against distance for five values of alpha](figure_3.png)
#
# ```bash
# mpirun -n 2 python demos/pull.py
# ```

# %%
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

from matplotlib.figure import Figure

import fem_snh

parser = ArgumentParser(description="A cube pulled apart, with several exponents alpha.")
parser.add_argument("--cells", type=int, default=10, help="along an edge")
parser.add_argument("--alphas", type=float, nargs="+", default=[0.5, 0.75, 1.0, 1.5, 2.0])
parser.add_argument("--out", type=Path, default=Path("out/pull"))
args = parser.parse_args()

# %% [markdown]
# For each `alpha` one run goes to twice the length, and one of a tiny step gives the stiffness at
# rest.

# %%
TINY = 1e-4
curves, slopes = {}, {}
for alpha in args.alphas:
    options = {"cells": args.cells, "material.alpha": alpha}
    whole = fem_snh.run("pull", out=args.out / f"{alpha}", overwrite=True, **options)
    tiny = fem_snh.run("pull", stretch=1 + TINY, steps=1, progress=False, **options)
    assert whole.converged and tiny.converged
    force = [0.0, *(step["reactions"]["right"][0] for step in whole.steps)]
    curves[alpha] = [1.0, *(1 + step["load"] for step in whole.steps)], force
    slopes[alpha] = tiny.steps[-1]["reactions"]["right"][0] / TINY

# %%
if MPI.COMM_WORLD.rank == 0:
    figure = Figure(figsize=(6, 4.5), layout="constrained")
    ax = figure.subplots()
    print("\nalpha   stiffness at rest [N/m]   force at 2 m [N]")
    for alpha, (distance, force) in curves.items():
        print(f"{alpha:5}   {slopes[alpha]:23.4f}   {force[-1]:16.4f}")
        ax.plot(distance, force, "o-", ms=3.5, label=rf"$\alpha$ = {alpha:g}")
    ax.axline((1, 0), slope=slopes[1.0], color="0.6", lw=0.8, ls="--", label="linear")
    ax.set(xlabel="distance of the two faces [m]", ylabel="force on a face [N]")
    ax.set(title=r"pull  ·  stable Neo-Hookean, E = 1 Pa, $\nu$ = 0.3", ylim=(0, None))
    ax.legend(frameon=False)
    figure.savefig(args.out / "figure_3.png", dpi=200)
    print(f"picture: {args.out / 'figure_3.png'}")

# %% [markdown]
# The same stiffness at rest, stiffer with alpha, and concave for alpha = 1:

# %%
assert all(abs(slope / slopes[1.0] - 1) < 1e-3 for slope in slopes.values()), slopes
ends = [curves[alpha][1][-1] for alpha in args.alphas]
assert ends == sorted(ends), ends
force = curves[1.0][1]
assert all(a + c < 2 * b for a, b, c in zip(force, force[1:], force[2:], strict=False)), force
