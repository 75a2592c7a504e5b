# %% [markdown]
# # Inflating a thick spherical shell, past its limit point
#
# The pressure in a rubber balloon rises, reaches a maximum, and falls while the balloon goes on
# growing: at a prescribed pressure the solution beyond the maximum is unstable. Here a fluid of
# prescribed *volume* fills the shell, and the pressure is a result.
#
# For an incompressible neo-Hookean wall the exact pressure is
#
# $$
# p = \frac{\mu}{2} \left( \frac{4}{b} + \frac{1}{b^4} - \frac{4}{a} - \frac{1}{a^4} \right),
# \qquad b^3 - 1 = (a^3 - 1) \frac{A^3}{B^3},
# $$
#
# with $a$ and $b$ the stretches of the inner and the outer surface, of radii $A$ and $B$. The wall
# here has $\nu = 0.49$, and two layers of `Q2` cells.
#
# ![Pressure against the stretch of the inside, with the exact curve](inflation.png)
#
# ```bash
# mpirun -n 2 python demos/inflation.py
# ```

# %%
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

import numpy as np
from matplotlib.figure import Figure

import fem_snh
from fem_snh.scenes import Cavity, Geometry, Hold, MaterialChoice, Scene

parser = ArgumentParser(description="A thick spherical shell is inflated by a prescribed volume.")
parser.add_argument("--cells", type=int, default=4, help="along a quarter circle, even")
parser.add_argument("--steps", type=int, default=24)
parser.add_argument("--out", type=Path, default=Path("out/inflation"))
args = parser.parse_args()
outer, stretch = 1.5, 3.0  # outer over inner radius; stretch of the inside at load 1

# %% [markdown]
# ## The scene: an octant, with rollers on its planes of symmetry
#
# Equal steps of the volume would be long steps of the stretch at the start, where the pressure
# rises steeply: a table of amplitudes makes the steps of the stretch equal.

# %%
octant = 4 / 3 * np.pi / 8
loads = np.linspace(0, 1, args.steps + 1)
fractions = ((1 + loads * (stretch - 1)) ** 3 - 1) / (stretch**3 - 1)
scene = Scene(
    name="inflation",
    mesh=Geometry(source="shell", parameters={"layers": 2, "outer": outer}),
    cells=args.cells,
    element="Q2",
    steps=args.steps,
    material=MaterialChoice(name="stable_neo_hookean", E=3.0, nu=0.49),
    hold=[Hold(group=f"{c} = 0", components=(c,)) for c in ("x", "y", "z")],
    cavity=[Cavity(group="inner", volume=octant * (stretch**3 - 1), table="volume")],
    table=[{"name": "volume", "points": np.stack([loads, fractions], axis=1).tolist()}],
)
result = fem_snh.run(scene, out=args.out, overwrite=True)
assert result.converged

# %% [markdown]
# ## Pressure against stretch, on both sides of the maximum


# %%
def exact(a):
    """Return the pressure of the incompressible wall, mu = 1, at a stretch a of the inside."""
    b = (1 + (a**3 - 1) / outer**3) ** (1 / 3)
    return (4 / b + b**-4 - 4 / a - a**-4) / 2


states = [step["cavities"]["inner"] for step in result.steps if step["converged"]]
a = np.array([(1 + state["volume"] / octant) ** (1 / 3) for state in states])
p = np.array([state["pressure"] for state in states])
error = np.abs(p / exact(a) - 1)
if MPI.COMM_WORLD.rank == 0:
    top = p.argmax()
    print(f"largest pressure {p[top]:.4f} at stretch {a[top]:.2f}")
    print(f"at most {100 * error.max():.2f} % from the exact pressure")
    assert 0 < top < len(p) - 1 and error.max() < 0.01
    figure = Figure(figsize=(6, 3.8), layout="constrained")
    ax = figure.subplots()
    fine = np.linspace(1, a.max(), 200)
    ax.plot(fine, exact(fine), color="0.6", label="exact, incompressible")
    ax.plot(a, p, "o", ms=4, label=f"{result.record['cells']} Q2 cells, ν = 0.49")
    ax.set(xlabel="stretch of the inside", ylabel="pressure / μ", ylim=(0, None))
    ax.legend(frameon=False)
    figure.savefig(args.out / "inflation.png", dpi=150)
    print(f"picture: {args.out / 'inflation.png'}")
