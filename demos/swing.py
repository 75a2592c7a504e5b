# %% [markdown]
# # A swinging cantilever: what each time integrator does with energy
#
# A rubber bar, 0.5 m long and 0.1 m thick, is clamped at its left end and released from rest under
# its weight. It swings through half of its length. The sum of kinetic, elastic and potential energy
# is constant: what an integrator loses of it is numerical dissipation, here after two swings and
# relative to the work of the weight down to the lowest point. [](../howto/time.md) helps to choose
# an integrator.
#
# | 48 steps of 25 ms | energy lost | lowest point of the tip | Newton iterations |
# |---|---|---|---|
# | `newmark` | 0.01 % | -0.247 m | 199 |
# | `generalized_alpha` | 0.09 % | -0.247 m | 193 |
# | `bdf2` | 5.8 % | -0.240 m | 191 |
# | `backward_euler` | 26 % | -0.208 m | 194 |
# | `semi_implicit` | 27 % | -0.163 m | 48 |
#
# ![Energy and tip of a swinging cantilever by five integrators](swing.png)
#
# ```bash
# mpirun -n 2 python demos/swing.py
# ```

# %%
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

import fem_snh
from fem_snh.choices import INTEGRATORS
from fem_snh.scenes import Geometry, Gravity, Hold, MaterialChoice, Probe, Scene, Time
from fem_snh.viewing.plots.runs import energy_table
from fem_snh.viewing.plots.style import legend, subplots

parser = ArgumentParser(description="A swinging cantilever, with every time integrator.")
parser.add_argument("--cells", type=int, default=3, help="along the diameter")
parser.add_argument("--steps", type=int, default=48, help="time steps")
parser.add_argument("--out", type=Path, default=Path("out/swing"))
args = parser.parse_args()

# %% [markdown]
# Two swings of about 0.5 s. Every material of a scene in time has a density; gravity needs no
# table, as forces are constant in time unless a table says otherwise.

# %%
SCENE = Scene(
    name="swing",
    mesh=Geometry(source="cylinder", parameters={"radius": 0.05, "length": 0.5}),
    cells=args.cells,
    element="Q1P0",
    material=MaterialChoice(name="stable_neo_hookean", E=1e6, nu=0.45, density=1000.0),
    hold=[Hold(group="left")],
    gravity=Gravity(vector=(0, 0, -9.81)),
    probe=[Probe(name="tip", point=(0.5, 0, 0))],
    time=Time(duration=1.2, steps=args.steps),
)
runs = {}
for integrator in INTEGRATORS:
    result = fem_snh.run(SCENE, progress=False, **{"time.integrator": integrator})
    assert result.converged
    runs[integrator] = result
released = max(-row["potential"] for row in runs["newmark"].steps)
lost = {name: -run.steps[-1]["energy"] / released for name, run in runs.items()}

# %%
if MPI.COMM_WORLD.rank == 0:
    figure, (left, right) = subplots(2)
    print("\nintegrator          energy lost   lowest tip [m]   Newton")
    for integrator, result in runs.items():
        tip = [row["probes"]["tip"][2] for row in result.steps]
        newton = sum(row["newton"] for row in result.steps)
        print(f"{integrator:18}  {lost[integrator]:10.2%}   {min(tip):14.4f}   {newton:6}")
        rows = energy_table(result.record)
        line = "k--" if integrator == "newmark" else "-"
        left.plot(rows["time"], rows["energy"], line, label=integrator)
        right.plot(rows["time"], [0.0, *tip], line)
    left.set(xlabel="time [s]", ylabel="kinetic + elastic + potential energy [J]")
    right.set(xlabel="time [s]", ylabel="displacement of the tip [m]")
    legend(figure, left)
    args.out.mkdir(parents=True, exist_ok=True)
    figure.savefig(args.out / "swing.png", dpi=150)
    print(f"picture: {args.out / 'swing.png'}")

# %% [markdown]
# Newmark's method keeps the energy, generalised-alpha almost; BDF2 loses a little, the methods of
# first order a lot:

# %%
assert abs(lost["newmark"]) < 0.002 and abs(lost["generalized_alpha"]) < 0.005, lost
assert 0.02 < lost["bdf2"] < 0.1 < 0.2 < lost["backward_euler"] < lost["semi_implicit"], lost
