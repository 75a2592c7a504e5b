# %% [markdown]
# # Smith et al., Figure 2: a flexed elbow, as ν → 1/2
#
# An arm of two bones in flesh is flexed by a right angle. The bones are rigid, the joint between
# them is soft. The smaller ν is, the more volume the flesh loses in front of the elbow; only as
# ν → 1/2 does it bulge beside it.
#
# | ν | change of the flesh's volume | bulge | Newton iterations in 9 steps |
# |---|---|---|---|
# | 0 | −1.09 % | 0.3 mm | 27 |
# | 0.3 | −0.54 % | 2.1 mm | 27 |
# | 0.4 | −0.27 % | 3.4 mm | 32 |
# | 0.45 | −0.14 % | 4.1 mm | 39 |
# | 0.488 | −0.03 % | 4.7 mm | 47 |
# | 0.499 | −0.00 % | 4.9 mm | 36 |
#
# ![Six flexed elbows by Poisson's ratio, coloured by the change of volume](elbow.png)
#
# The same from the shell, a process for each ν:
#
# ```bash
# fem-snh sweep elbow --nu 0,0.3,0.4,0.45,0.488,0.499 --cells 28 --jobs 2 --render J --out out/elbow
# ```
#
# ```bash
# python demos/elbow.py               # 4,700 tetrahedra; mpirun -n 2 works, too
# python demos/elbow.py --cells 40    # 11,200 tetrahedra, the default of the scene
# ```
#
# The paper gives neither the arm nor its moduli. This one is `meshes/arm.geo`, 0.52 m long;
# [the how-to](../howto/bones.md) has bones in a mesh of your own, and
# [the results](../results/bones.md) flexions of 120° and of 90° in one step.

# %%
import json
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

import numpy as np

from fem_snh.studies.sweep import sweep
from fem_snh.viewing.states import States

parser = ArgumentParser(description="An elbow is flexed, for several values of Poisson's ratio.")
parser.add_argument("--nus", type=float, nargs="+", default=[0, 0.3, 0.4, 0.45, 0.488, 0.499])
parser.add_argument("--cells", type=int, default=28, help="along the arm")
parser.add_argument("--steps", type=int, default=9, help="to the right angle")
parser.add_argument("--out", type=Path, default=Path("out/elbow"))
args = parser.parse_args()
AXES = {"nu": args.nus, "cells": args.cells, "steps": args.steps}

# %% [markdown]
# ## Volume and bulge
#
# Each step's row has the volume of the flesh relative to that at rest. The bulge is the largest
# displacement of the flesh away from the plane in which the arm is flexed.


# %%
def results(folder):
    """Return the volume of the flesh, the bulge [m] and the Newton iterations of a run."""
    steps = json.loads((folder / "run.json").read_text())["steps"]
    states = States(folder / "fields.pvd")
    y = np.asarray(states.mesh.points)[:, 1]
    bulge = (states.displacement(len(states) - 1)[:, 1] * np.sign(y)).max()
    return steps[-1]["volumes"]["flesh"], bulge, sum(step["newton"] for step in steps)


if MPI.COMM_WORLD.rank == 0:
    table = sweep("elbow", args.out, AXES, jobs=2, render="J").sort_values("nu")
    assert table["converged"].all()
    rows = [results(args.out / point) for point in table["point"]]
    for nu, (volume, bulge, newton) in zip(table["nu"], rows, strict=True):
        print(f"nu {nu:<5g}  volume {100 * (volume - 1):+.2f} %", end="  ")
        print(f"bulge {1e3 * bulge:.1f} mm  {newton} Newton iterations")
    volumes, bulges, _ = zip(*rows, strict=True)
    assert list(volumes) == sorted(volumes), "volume rises with nu"
    assert list(bulges) == sorted(bulges), "so does the bulge"
    assert volumes[-1] > 0.995 or max(args.nus) < 0.488
    print(f"picture: {args.out / 'bodies.png'}")
