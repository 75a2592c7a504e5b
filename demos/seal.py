# %% [markdown]
# # An O-ring between two plates
#
# Plates with friction press a cord of rubber, ν = 0.499, by 30 % of its height: a section of
# [two dimensions](../howto/two_dimensions.md), of the ring and of half of a straight cord.
#
# ![Force of the plates against the squeeze](seal.png)
#
# ```bash
# mpirun -n 2 python demos/seal.py
# ```

# %%
from argparse import ArgumentParser
from math import pi
from pathlib import Path

from mpi4py import MPI

from matplotlib.figure import Figure

import fem_snh

parser = ArgumentParser(description="The force on an O-ring between two plates.")
parser.add_argument("--cells", type=int, default=8, help="cells along the cord's diameter")
parser.add_argument("--out", type=Path, default=Path("out/seal"))
args = parser.parse_args()

# %% [markdown]
# Forces are of the whole turn, and of half a cord per length: both become forces per length.

# %%
LENGTHS = {"axisymmetric": 2 * pi * 5, "plane_strain": 0.5}
forces: dict[str, list[float]] = {}
for kinematics, length in LENGTHS.items():
    result = fem_snh.run("seal", cells=args.cells, kinematics=kinematics, progress=False)
    assert result.converged, (kinematics, result.status)
    forces[kinematics] = [-row["obstacles"]["upper"]["force"][1] / length for row in result.steps]

# %%
if MPI.COMM_WORLD.rank == 0:
    figure = Figure(figsize=(6, 4.2), layout="constrained")
    ax = figure.subplots()
    for kinematics, found in forces.items():
        print(f"{kinematics:13}" + "".join(f"{force:8.3f}" for force in found) + " N/mm")
        squeezes = [0.3 * (i + 1) / len(found) for i in range(len(found))]
        ax.plot([0, *squeezes], [0, *found], "o-", ms=4, label=kinematics)
    ax.set(xlabel="squeeze, in the height of the cord", ylabel="force per length [N/mm]")
    ax.legend(frameon=False)
    args.out.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.out / "seal.png", dpi=200)
    print(f"picture: {args.out / 'seal.png'}")

# %% [markdown]
# The ring is nearly a straight cord, and stiffens.

# %%
ring, cord = forces.values()
assert abs(ring[-1] / cord[-1] - 1) < 0.03, forces
assert ring[-1] - ring[-2] > 2 * ring[0], forces
