# %% [markdown]
# # Cook's membrane at 0.1 %: the mesh that an accuracy requires
#
# How many cells does an answer need, and where? State the accuracy
# ([guide](../howto/error.md#state-the-accuracy)): the run estimates its error, bisects the
# triangles that hold it, and ends when the value is known. At ν = 0.4999 most of the error is at
# two corners, where the stress has no limit.
#
# ![The last mesh, and the error of the corner's displacement in each cell](mesh.png)
#
# ```bash
# python demos/accuracy.py
# ```

# %%
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

import fem_snh
from fem_snh.scenes import Accuracy
from fem_snh.viewing.render import main as render

parser = ArgumentParser(description="Cook's membrane to an accuracy.")
parser.add_argument("--within", type=float, default=0.001, help="relative accuracy")
parser.add_argument("--out", type=Path, default=Path("out/accuracy"))
args = parser.parse_args()

# %% [markdown]
# The corner's displacement in the limit of uniform meshes of `Q2Q1` up to 128 cells along a side,
# known to 0.004 % ([references](../results/references.md)).

# %%
CORNER = 6.93667
scene = fem_snh.scenes.load("cook", element="P2P1", cells=8).model_copy(
    update={"accuracy": Accuracy(goals=["corner.y"], within=args.within)}
)
result = fem_snh.run(scene, out=args.out, overwrite=True, progress=False)

# %%
levels = result.record["accuracy"]["levels"]
if MPI.COMM_WORLD.rank == 0:
    print("displacement of the corner [mm]\ncells  unknowns   value  bound    true error")
    for level in levels:
        goal = level["goals"]["corner.y"]
        true = (goal["corrected"] - CORNER) / CORNER
        bound = "" if goal["bound"] is None else f"{goal['within']:.2%}"
        print(
            f"{level['cells']:5} {level['dofs']:9} {goal['corrected']:8.4f} {bound:>6} {true:12.3%}"
        )
    print(f"picture: {render(args.out, args.out / 'mesh.png', field='error_corner_y')}")

# %% [markdown]
# One level has no bound: the second measures it. Every bound contains the error. A uniform mesh of
# 128 cells along a side, 148,739 unknowns of the same element, is 0.2 % off.

# %%
assert result.record["accuracy"]["reached"]
for level in levels[1:]:
    goal = level["goals"]["corner.y"]
    assert abs(goal["corrected"] - CORNER) <= goal["bound"], level
