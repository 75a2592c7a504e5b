# %% [markdown]
# # Smith et al., Figure 1: arms swung across the chest
#
# Thirteen bones drive the flesh of a torso: spine, thorax, neck, and in each arm clavicle, shoulder
# blade, humerus, forearm and hand. The arms swing across the chest, the left one above the right
# one, and press on it and on each other. As in the paper, the body is a lattice of hexahedra,
# $\nu = 0.488$, and each step is solved until the norm of the residual is below $10^{-2}$. The
# paper's model is not public: this one is a smooth union of capsules, 1.5 m from fingertip to
# fingertip.
#
# ![The torso with arms spread, half way, and with crossed arms](torso.png)
#
# ```bash
# mpirun -n 2 python demos/torso.py                # 2,400 hexahedra, in half a minute
# mpirun -n 2 python demos/torso.py --cells 144    # the paper's 45,800, as in the picture
# ```
#
# What a step of the full size costs is in [the results](../results/bones.md).

# %%
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

import numpy as np

import fem_snh
from fem_snh.viewing.render import main as render

parser = ArgumentParser(description="The arms of a torso swing across the chest.")
parser.add_argument("--cells", type=int, default=50, help="from fingertip to fingertip")
parser.add_argument("--steps", type=int, default=10, help="load steps")
parser.add_argument("--out", type=Path, default=Path("out/torso"))
args = parser.parse_args()

options = {"cells": args.cells, "steps": args.steps}
result = fem_snh.run("torso", **options, out=args.out, overwrite=True)
assert result.converged, result.status

# %% [markdown]
# ## Self-contact
#
# Without it the arms pass through each other and into the chest. The run is the same but for the
# contact.

# %%
through = fem_snh.run("torso", **options, contact=False, progress=False)
assert through.converged, through.status

# %%
steps = [step for step in result.steps if step["converged"]]
newton = np.mean([step["newton"] for step in steps])
contact = [step["self_contact"] for step in steps]
cell = 1.51 / args.cells
penetration = max(row["penetration"] for row in contact) / cell
solves = max(step["solves"] for step in steps)

if MPI.COMM_WORLD.rank == 0:
    print(f"{result.record['cells']} hexahedra, {len(steps)} steps, Newton {newton:.1f} a step")
    print(f"contact: {contact[-1]['force']:.0f} N, solves of a step: at most {solves}")
    print(f"largest penetration: {penetration:.1%} of a cell")
    print(f"volume: {steps[-1]['volume_ratio'] - 1:+.2%}")
    energies = [run.steps[-1]["energy"] for run in (result, through)]
    print("elastic energy with contact {:.3f} J, without {:.3f} J".format(*energies))
    picture = render(args.out, args.out / "torso.png", [1 / args.steps, 0.5, 1.0])
    print(f"picture: {picture}")

# %%
assert contact[-1]["force"] > 5 and penetration < 0.25 and solves <= 5
assert abs(steps[-1]["volume_ratio"] - 1) < 0.01
assert result.steps[-1]["energy"] > through.steps[-1]["energy"]
