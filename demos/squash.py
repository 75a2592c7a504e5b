# %% [markdown]
# # Smith et al., Figure 11: an octopus between cylinders
#
# An octopus falls on three cylinders. A fourth one squashes it until cells invert, and rises
# again: the octopus comes back to its shape. As in the paper, $\nu = 0.46$, the cells are linear
# tetrahedra, and each frame takes ten semi-implicit steps (Baraff & Witkin 1998): one linear solve
# each, without a line search. The paper does not give the rest; here
#
# | | |
# |---|---|
# | octopus | 0.54 m from tip to tip, 3.2 kg: a bell, eight tapering arms (`meshes/octopus.geo`) |
# | material | $E$ = 0.3 MPa, density 1000 kg/m³, mass damping 10/s; wet: friction 0.05 |
# | cylinders | radius 25 mm, axes 60 mm apart; the press: radius 120 mm |
# | frames | 24 a second, for 2.25 s |
# | press | down from 1 to 1.25 s, to 20 mm from the middle cylinder; up from 1.375 to 1.625 s |
#
# ![The octopus before, while and after it is squashed](squash.png)
#
# ```bash
# mpirun -n 2 python demos/squash.py               # 20,000 tetrahedra, a movie
# mpirun -n 2 python demos/squash.py --cells 157   # the paper's 394,000
# ```
#
# What other materials do, and what a frame costs, is in [the results](../results/squash.md).

# %%
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

import numpy as np
from scipy.spatial.transform import Rotation

import fem_snh
from fem_snh.viewing.render import main as render
from fem_snh.viewing.render import movie
from fem_snh.viewing.states import States

parser = ArgumentParser(description="An octopus is squashed between cylinders, and recovers.")
parser.add_argument("--cells", type=int, default=54, help="from tip to tip of the arms")
parser.add_argument("--substeps", type=int, default=10, help="time steps a frame")
parser.add_argument("--out", type=Path, default=Path("out/squash"))
parser.add_argument("--seconds", type=float, default=4, help="length of the movie; 0: no movie")
args = parser.parse_args()

options = {"cells": args.cells, "substeps": args.substeps}
result = fem_snh.run("squash", **options, out=args.out, overwrite=True)
assert result.converged, result.status
steps = result.steps

# %% [markdown]
# ## How far it is squashed
#
# $J$ is the ratio of a cell's volume to its volume at rest; below zero the cell is inverted.

# %%
smallest = min(steps, key=lambda step: step["min_J"])
force = max(abs(step["obstacles"]["press"]["force"][2]) for step in steps)
assert smallest["min_J"] < 0.05 and steps[-1]["min_J"] > 0

# %% [markdown]
# ## Whether it comes back
#
# The shape at the end is compared with that at rest on the cylinders, before the press moves. The
# rigid motion between them is left out.


# %%
def distances(folder):
    """Return the distances of the nodes (n,) from the shape at rest, in the span of the arms."""
    states = States(folder / "fields.pvd")
    rest = int(np.abs(np.array(states.loads) - 1.0).argmin())  # their times [s]
    X = np.asarray(states.mesh.points)
    x, y = X + states.displacement(len(states) - 1), X + states.displacement(rest)
    x, y = x - x.mean(axis=0), y - y.mean(axis=0)
    rotation, _ = Rotation.align_vectors(y, x)
    return np.linalg.norm(rotation.apply(x) - y, axis=1) / np.ptp(X[:, 0])


if MPI.COMM_WORLD.rank == 0:
    d = distances(args.out)
    mean, largest = np.sqrt((d**2).mean()), d.max()
    cells, seconds = result.record["cells"], result.record["seconds"]["total"]
    print(f"{cells} tetrahedra, {len(steps)} steps, {seconds:.0f} s")
    print(f"squashed: smallest J {smallest['min_J']:.2f}, press {force:.0f} N")
    print(
        f"released: smallest J {steps[-1]['min_J']:.2f}, "
        f"{100 * mean:.2f} % from its shape, at most {100 * largest:.2f} %"
    )
    assert mean < 0.01 and (largest < 0.01 or args.cells < 54)  # coarser meshes: the mean
    picture = render(args.out, args.out / "squash.png", [1.0, 1.25, 2.25])
    print(f"picture: {picture}")
    if args.seconds:
        print(f"movie: {movie(args.out, args.out / 'squash.gif', seconds=args.seconds)}")
