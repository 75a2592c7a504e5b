# %% [markdown]
# # A sweep: how volume is kept, and what it costs, as ν → 1/2
#
# Twelve twisted cubes, two materials and six values of $\nu$, two processes at a time. The same
# from the shell:
#
# ```bash
# fem-snh sweep twist --nu 0.3,0.4,0.45,0.49,0.495,0.499 --set angle=1.5708 \
#     --material stable_neo_hookean,neo_hookean --cells 5 --steps 4 --jobs 2 --out out/nu_sweep
# ```
#
# Each point is a process of its own, so one that fails costs one row. A second call finds all rows
# and runs nothing; an interrupted sweep continues where it stopped.
#
# ![Volume change and linear iterations against Poisson's ratio](nu_sweep.png)
#
# ```bash
# python demos/nu_sweep.py      # mpirun -n 2 works, too: rank 0 runs the sweep
# ```

# %%
from argparse import ArgumentParser
from math import pi

from mpi4py import MPI

from fem_snh.studies.sweep import sweep

parser = ArgumentParser(description="A sweep over the material and Poisson's ratio.")
parser.add_argument("--nus", type=float, nargs="+", default=[0.3, 0.4, 0.45, 0.49, 0.495, 0.499])
args = parser.parse_args()
AXES = {
    "material": ["stable_neo_hookean", "neo_hookean"],
    "nu": args.nus,
    "cells": 5,
    "angle": pi / 2,
    "steps": 4,
}

# %% [markdown]
# The result is a pandas table. The closer the material is to incompressible, the less volume is
# lost.

# %%
if MPI.COMM_WORLD.rank == 0:
    table = sweep("twist", "out/nu_sweep", AXES, jobs=2)
    table["volume change"] = table["volume_ratio"] - 1
    print(table.pivot(index="nu", columns="material", values="volume change"))
    print(table.pivot(index="nu", columns="material", values="linear"))
    print("table and picture: out/nu_sweep/sweep.csv, sweep.png")

    assert table["converged"].all()
    for material, rows in table.groupby("material"):
        change = rows.sort_values("nu")["volume change"].abs()
        assert change.is_monotonic_decreasing and change.iloc[-1] < 2e-3, (material, change)
