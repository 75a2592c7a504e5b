"""Cook's membrane at nu = 0.4999: what locks, and what does not.

    mpirun -n 2 python demos/cook.py

A tapered panel in plane strain, clamped at its left and sheared at its right edge. Full integration
on Q1 keeps the volume at eight points of each cell, and locks; Q1P0 keeps the mean of each cell;
Q2Q1, Taylor-Hood, has a pressure of its own. Published numbers: docs/results/references.md.
"""

from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

from matplotlib.figure import Figure

import fem_snh

parser = ArgumentParser(description=__doc__)
parser.add_argument("--finest", type=int, choices=(16, 32, 64), default=32, help="mesh")
parser.add_argument("--out", type=Path, default=Path("out/cook"))
args = parser.parse_args()

#: One layer of cells: factors are cheap, and nu -> 1/2 costs them nothing.
DIRECT = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}
MESHES = [cells for cells in (2, 4, 8, 16, 32, 64) if cells <= args.finest]
tips: dict[str, list[float]] = {}
for element, meshes in (("Q1", MESHES), ("Q1P0", MESHES), ("Q2Q1", MESHES[:-1])):
    tips[element] = []
    for cells in meshes:
        options = {"element": element, "cells": cells, "petsc": DIRECT}
        result = fem_snh.run("cook", progress=False, **options)
        assert result.converged, (element, cells, result.status)
        tips[element].append(result.steps[-1]["probes"]["tip"][1])

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
    print(f"picture: {args.out / 'cook.png'}")

# Q1 moves less than half as far on every mesh; the others get there, Q2Q1 with 4 x 4 cells.
assert tips["Q1"][-1] < 0.5 * best, tips
assert abs(tips["Q1P0"][-1] / best - 1) < 0.05, tips
assert abs(tips["Q2Q1"][1] / best - 1) < 0.025, tips
