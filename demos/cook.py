# %% [markdown]
# # Cook's membrane at ν = 0.4999: which elements lock
#
# A tapered panel in plane strain, clamped at its left edge and sheared at its right one. `Q1`
# evaluates the volume term at four points of each element, and locks; `Q1P0` at the mean of each
# element; `Q2Q1` (Taylor-Hood) has an unknown pressure ([mixed forms](../theory/mixed_forms.md)).
# Published numbers are [here](../results/references.md), the measured cost of accuracy
# [here](../results/tradeoff.md).
#
# ![Displacement of the tip against the number of cells](cook.png)
#
# ![Von Mises stress of the three elements](von_mises.png)
#
# ```bash
# mpirun -n 2 python demos/cook.py
# ```

# %%
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

from matplotlib.figure import Figure

import fem_snh
from fem_snh.viewing.render import compare

parser = ArgumentParser(description="Cook's membrane with three elements.")
parser.add_argument("--finest", type=int, choices=(16, 32, 64), default=32, help="mesh")
parser.add_argument("--out", type=Path, default=Path("out/cook"))
args = parser.parse_args()

# %% [markdown]
# In two dimensions the program solves with sparse factors, which $\nu \to 1/2$ does not make
# slower. One run of each element also writes the von Mises stress, a mean over each cell.

# %%
PICTURED = {"Q1": 16, "Q1P0": 16, "Q2Q1": 8}  # cells along a side: as many nodes
STRESS = {"fields": ["von_mises"], "overwrite": True}
MESHES = [cells for cells in (2, 4, 8, 16, 32, 64) if cells <= args.finest]
tips: dict[str, list[float]] = {}
for element, meshes in (("Q1", MESHES), ("Q1P0", MESHES), ("Q2Q1", MESHES[:-1])):
    tips[element] = []
    for cells in meshes:
        options = {"element": element, "cells": cells}
        if cells == PICTURED[element]:
            options |= STRESS | {"out": args.out / element}
        result = fem_snh.run("cook", progress=False, **options)
        assert result.converged, (element, cells, result.status)
        tips[element].append(result.steps[-1]["probes"]["tip"][1])

# %%
best = tips["Q2Q1"][-1]
if MPI.COMM_WORLD.rank == 0:
    figure = Figure(figsize=(6, 4.2), layout="constrained")
    ax = figure.subplots()
    print("displacement of the tip [mm]\ncells" + "".join(f"{n:8}" for n in MESHES))
    for element, found in tips.items():
        print(f"{element:5}" + "".join(f"{tip:8.3f}" for tip in found))
        ax.semilogx(MESHES[: len(found)], found, "o-", ms=4, label=element)
    ax.axhline(best, color="0.6", lw=0.8, ls="--")
    ax.set(xlabel="cells along a side", ylabel="displacement of the tip [mm]", ylim=(0, None))
    ax.set_xticks(MESHES, labels=MESHES)
    ax.set_title(r"Cook's membrane  ·  Neo-Hookean (Simo), $\nu$ = 0.4999")
    ax.minorticks_off()
    ax.legend(frameon=False)
    args.out.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.out / "cook.png", dpi=200)
    stresses = args.out / "von_mises.png"
    compare([args.out / element for element in tips], stresses, None, list(tips), "von_mises")
    print(f"pictures: {args.out / 'cook.png'}, {stresses}")

# %% [markdown]
# `Q1` moves less than half as far on every mesh, and its stress is as wrong. The others converge,
# `Q2Q1` with 4 x 4 cells.

# %%
assert tips["Q1"][-1] < 0.5 * best, tips
assert abs(tips["Q1P0"][-1] / best - 1) < 0.05, tips
assert abs(tips["Q2Q1"][1] / best - 1) < 0.025, tips
