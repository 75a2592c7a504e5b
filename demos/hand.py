# %% [markdown]
# # Smith et al., Figures 7 and 8: a hand that closes to a fist
#
# The 24 bones of a hand and its forearm lie in a lattice of hexahedra, whose surface is the skin.
# They close to a fist: fingers press against each other, against the palm and the thumb. As in the
# paper, the bones' motion is noisy and not rigid, $\nu = 0.488$, and each step is solved until the
# norm of the residual is below $10^{-2}$. The paper's rig is not public; here
#
# | | |
# |---|---|
# | skin | a smooth union of capsules, 0.34 m long |
# | bones | capsules between joints; noise of 5 % of a bone's length, a new one in each step |
# | motion | the fingers close, then the thumb over them: 24 steps, 48 at full size |
# | contact | the paper's, by the map to the reference configuration |
#
# ![The hand at loads 0.25 and 1, coloured by the change of volume](hand.png)
#
# ```bash
# mpirun -n 2 python demos/hand.py                             # 2,000 hexahedra
# mpirun -n 2 python demos/hand.py --cells 119 --steps 48      # 39,000, as in the picture
# ```
#
# What a step of the full size costs is in [the results](../results/bones.md). How to give a body
# of your own bones: [bones](../howto/bones.md), [lattices](../howto/lattice.md),
# [self-contact](../howto/self_contact.md).

# %%
from argparse import ArgumentParser
from collections import Counter
from pathlib import Path

from mpi4py import MPI

import numpy as np

import fem_snh
from fem_snh.scenes.builtin.hand import FINGERS, rig
from fem_snh.viewing.render import main as render

parser = ArgumentParser(description="A hand closes to a fist.")
parser.add_argument("--cells", type=int, default=40, help="along hand and forearm")
parser.add_argument("--steps", type=int, default=24, help="load steps, a multiple of 4")
parser.add_argument("--out", type=Path, default=Path("out/hand"))
args = parser.parse_args()

options = {"cells": args.cells, "steps": args.steps}
result = fem_snh.run("hand", **options, out=args.out, overwrite=True)
assert result.converged, result.status

# %% [markdown]
# ## What a step takes, and what touches
#
# The last steps, in which the fingers press on the palm, take most iterations. `solves` says how
# often a step is solved until the pairs that touch have settled.

# %%
steps = [step for step in result.steps if step["converged"]]
newton = np.mean([step["newton"] for step in steps])
contact = [step["self_contact"] for step in steps]

# %% [markdown]
# Contact is the force of springs between points of the skin. Each point belongs to the bone that is
# closest to it; so we know which part of the hand presses on which.

# %%
bones = rig()


def closest_bones(X):
    """Return the names of the bones whose axes are closest to reference positions (n, 3)."""
    distances = []
    for bone in bones:
        axis = np.subtract(bone.end, bone.start)
        along = np.clip((X - bone.start) @ axis / (axis @ axis), 0, 1)
        distances.append(np.linalg.norm(X - bone.start - along[:, None] * axis, axis=1))
    return np.array([bone.name for bone in bones])[np.argmin(distances, axis=0)]


def part(name):
    """Return the finger of a bone, or palm."""
    return "palm" if name.endswith(("metacarpal", "carpals")) else name.split("_")[0]


term = next(term for term in result.problem.terms if term.name == "self_contact")
samples, targets, forces = term.spring_forces(result.problem.split(result.problem.x)[0])
between = Counter()
for first, second, force in zip(*map(closest_bones, (samples, targets)), forces, strict=True):
    between[frozenset((part(first), part(second)))] += force

# %% [markdown]
# ## Volume
#
# Corotational elasticity with the same constants loses volume where flesh is compressed. The paper
# could not complete the hand with it; here it converges. Both are computed without contact.

# %%
materials = {"stable_neo_hookean": 0.0, "corotational": 0.0}
for name in materials:
    run = fem_snh.run("hand", **options, contact=False, material=name, progress=False)
    materials[name] = 1 - run.steps[-1]["volume_ratio"]

if MPI.COMM_WORLD.rank == 0:
    print(f"{result.record['cells']} hexahedra, {len(steps)} steps, Newton {newton:.1f} a step")
    print(f"at the end {contact[-1]['pairs']} points touch: {contact[-1]['force']:.0f} N")
    for parts, force in between.most_common():
        print(f"  {' and '.join(sorted(parts))}: {force:.2f} N")
    print(f"solves of a step: at most {max(step['solves'] for step in steps)}")
    for name, lost in materials.items():
        print(f"volume lost without contact, {name}: {lost:.2%}")
    picture = render(args.out, args.out / "hand.png", [0.25, 1.0])
    print(f"picture: {picture}")

# %%
assert contact[-1]["force"] > 10  # the fist is closed:
touching = [("index", "middle"), ("middle", "ring"), ("ring", "little"), ("index", "thumb")]
touching += [(finger, "palm") for finger in FINGERS]
assert all(between[frozenset(pair)] > 0.5 for pair in touching)
assert 1 - steps[-1]["volume_ratio"] < 0.015
assert materials["corotational"] > 3 * materials["stable_neo_hookean"]
