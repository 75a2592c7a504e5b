# %% [markdown]
# # A bushing, turned and pushed
#
# Rubber, ν = 0.499, is bonded to two steel sleeves; the inner one is turned by half a radian. In
# the middle of a long bushing a circle of radius $r$ turns as a whole: incompressible Neo-Hookean
# rubber has the torque $4 \pi \mu L \varphi / (a^{-2} - b^{-2})$ at any angle. The free ends of one
# that is 30 mm long take 0.1 % of it, and a push along the axis by 4 mm hardly less. All are
# sections of [two dimensions](../howto/two_dimensions.md).
#
# ![Torque against the angle, with the exact line](bushing.png)
#
# ```bash
# mpirun -n 2 python demos/bushing.py
# ```

# %%
from argparse import ArgumentParser
from math import pi
from pathlib import Path

from mpi4py import MPI

from matplotlib.figure import Figure

import fem_snh

parser = ArgumentParser(description="The torque of a bushing.")
parser.add_argument("--cells", type=int, default=4, help="cells through the wall")
parser.add_argument("--out", type=Path, default=Path("out/bushing"))
args = parser.parse_args()
LENGTH, ANGLE, STEPS = 30.0, 0.5, 5  # mm, rad

# %% [markdown]
# In plane strain the torque is per length and about z; that of the body of revolution is about y.

# %%
CASES = {
    "plane strain": ({"kinematics": "plane_strain", "radial": 0.0}, 2, LENGTH),
    "free ends": ({"axial": 0.0}, 1, 1.0),
    "free ends, pushed": ({"axial": 4.0}, 1, 1.0),
}
torques: dict[str, list[float]] = {}
for name, (options, axis, length) in CASES.items():
    result = fem_snh.run(
        "bushing", cells=args.cells, angle=ANGLE, steps=STEPS, progress=False, **options
    )
    assert result.converged, (name, result.status)
    torques[name] = [length * row["moments"]["inner"][axis] / 1e3 for row in result.steps]

# %%
mu = 3.0 / 2 / (1 + 0.499)
exact = 4 * pi * mu * LENGTH * ANGLE / (10**-2 - 20**-2) / 1e3
if MPI.COMM_WORLD.rank == 0:
    figure = Figure(figsize=(6, 4.2), layout="constrained")
    ax = figure.subplots()
    ax.plot([0, ANGLE], [0, exact], color="0.6", label="exact, long")
    angles = [ANGLE * (i + 1) / STEPS for i in range(STEPS)]
    for (name, found), mark in zip(torques.items(), "osx", strict=True):
        print(f"{name:18}" + "".join(f"{torque:9.4f}" for torque in found) + " N m")
        ax.plot(angles, found, mark, label=name)
    ax.set(xlabel="angle [rad]", ylabel="torque [N m]", xlim=(0, None), ylim=(0, None))
    ax.legend(frameon=False)
    args.out.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.out / "bushing.png", dpi=200)
    print(f"picture: {args.out / 'bushing.png'}")

# %%
assert abs(torques["plane strain"][-1] / exact - 1) < 1e-3, (torques, exact)
assert 0.9 * exact < torques["free ends"][-1] < exact, torques
