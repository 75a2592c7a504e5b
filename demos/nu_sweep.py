"""How volume is kept, and what it costs, as nu goes to 1/2: twelve twisted cubes, two at a time.

    python demos/nu_sweep.py      (mpirun -n 2 works too: then rank 0 does it)

The same from the shell:

    fem-snh sweep twist --nu 0.3,0.4,0.45,0.49,0.495,0.499 --set angle=1.5708 \\
        --material stable_neo_hookean,neo_hookean --cells 5 --steps 4 --jobs 2 --out out/nu_sweep

Every point is a process of its own, so one that dies costs one row. Call it again and nothing is
left to do; end it half way, and it goes on from there.
"""

from math import pi

from mpi4py import MPI

from fem_snh.studies.sweep import sweep

AXES = {
    "material": ["stable_neo_hookean", "neo_hookean"],
    "nu": [0.3, 0.4, 0.45, 0.49, 0.495, 0.499],
    "cells": 5,
    "angle": pi / 2,
    "steps": 4,
}

if MPI.COMM_WORLD.rank == 0:
    table = sweep("twist", "out/nu_sweep", AXES, jobs=2)
    table["volume change"] = table["volume_ratio"] - 1
    print(table.pivot(index="nu", columns="material", values="volume change"))
    print(table.pivot(index="nu", columns="material", values="linear"))
    print("table and picture: out/nu_sweep/sweep.csv, sweep.png")

    # The closer to incompressible, the less volume is lost.
    assert table["converged"].all()
    for material, rows in table.groupby("material"):
        change = rows.sort_values("nu")["volume change"].abs()
        assert change.is_monotonic_decreasing and change.iloc[-1] < 2e-3, (material, change)
