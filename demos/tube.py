# %% [markdown]
# # A thick-walled tube, inflated to three times its radius
#
# Every radius of a long incompressible tube is known from the inner one: $b^2 - a^2 = B^2 - A^2$.
# So the pressure that a Neo-Hookean wall needs is known exactly,
#
# $$
# \frac{p}{\mu} = \ln \frac{B}{A} - \ln \frac{b}{a}
#     + \frac{a^2 - A^2}{2} \left( \frac{1}{a^2} - \frac{1}{b^2} \right),
# $$
#
# and a section in [two dimensions](../howto/two_dimensions.md) has it to four digits: a quarter of
# the ring in plane strain, or a strip that revolves.
#
# ![Pressure against the stretch of the inner radius, with the exact curve](tube.png)
#
# ```bash
# mpirun -n 2 python demos/tube.py
# ```

# %%
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

import numpy as np
from matplotlib.figure import Figure

import fem_snh
from fem_snh.scenes.builtin.tube import inflation_pressure

parser = ArgumentParser(description="A thick-walled tube is inflated by a follower pressure.")
parser.add_argument("--cells", type=int, default=8, help="cells through the wall")
parser.add_argument("--out", type=Path, default=Path("out/tube"))
args = parser.parse_args()
A, B, STRETCH = 1.0, 2.0, 3.0

# %% [markdown]
# The scene's pressure grows in equal steps to that of a stretch of 3; mu = 1.

# %%
highest = inflation_pressure(STRETCH, A, B)
found: dict[str, np.ndarray] = {}
for kinematics in ("plane_strain", "axisymmetric"):
    result = fem_snh.run(
        "tube", kinematics=kinematics, cells=args.cells, inflation=STRETCH, steps=8, progress=False
    )
    assert result.converged, (kinematics, result.status)
    found[kinematics] = np.array([1 + row["probes"]["inner"][0] / A for row in result.steps])
pressures = np.array([row["load"] for row in result.steps]) * highest

# %%
exact = {k: [inflation_pressure(a, A, B) for a in stretches] for k, stretches in found.items()}
if MPI.COMM_WORLD.rank == 0:
    figure = Figure(figsize=(6, 4.2), layout="constrained")
    ax = figure.subplots()
    curve = np.linspace(1, 1.05 * STRETCH, 200)
    ax.plot(curve, [inflation_pressure(a, A, B) for a in curve], color="0.6", label="exact")
    for (kinematics, stretches), mark in zip(found.items(), "ox", strict=True):
        print(f"{kinematics:13}" + "".join(f"{a:9.5f}" for a in stretches))
        ax.plot(stretches, pressures, mark, label=kinematics)
    ax.set(xlabel="stretch of the inner radius", ylabel="pressure over μ", ylim=(0, None))
    ax.legend(frameon=False)
    args.out.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.out / "tube.png", dpi=200)
    print(f"picture: {args.out / 'tube.png'}")

# %% [markdown]
# The exact pressure of the stretches that were found, against the one that was prescribed:

# %%
for kinematics, values in exact.items():
    assert np.allclose(values, pressures, rtol=1e-4), (kinematics, values, pressures)
