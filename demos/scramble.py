# %% [markdown]
# # Smith et al., Figure 3: a scrambled cube returns to rest
#
# Every vertex of a unit cube starts at a random position in a cube of twice its volume, four
# corners are pinned, and the body is released: a quasi-static solve from a state in which many
# elements are inverted. {cite:t}`Smith2018` show that the cube recovers its rest shape
# at $\nu = 0.49$.
#
# | | Smith et al. | this program |
# |---|---|---|
# | $\nu = 0.49$ | recovers its rest shape | 100 of 100 seeds on $10^3$ hexahedra, to 1e-6 |
# | Newton iterations | not published | 22 in the median, 28 at most |
#
# ![A scrambled cube, and the same at rest](../results/extremes/scramble.png)
#
# ```bash
# mpirun -n 2 python demos/scramble.py
# ```
#
# The scene `scramble` minimises the energy directly. A descent may then end in another minimum,
# with some stress and $J > 0$ in most elements; near $\nu = 1/2$ it often does. So the equilibrium
# at $\nu = -0.3$ is found first
# ([continuation in Poisson's ratio](../theory/newton.md#continuation-in-poissons-ratio)): there
# the volume term is too weak to trap elements, and rest is an equilibrium for every $\nu$
# ([all scrambles](../results/extremes.md)).

# %%
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

import fem_snh
from fem_snh.viewing.render import main as render

parser = ArgumentParser(description="A scrambled cube returns to rest.")
parser.add_argument("--cells", type=int, default=10, help="along an edge")
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--out", type=Path, default=Path("out/scramble"))
args = parser.parse_args()

result = fem_snh.run(
    "scramble", nu=0.49, cells=args.cells, seed=args.seed, nu_continuation=[-0.3],
    out=args.out, overwrite=True,
)  # fmt: skip

# %% [markdown]
# The largest displacement component and the energy measure how close the body is to rest.

# %%
displacement = result.problem.x.norm(3)  # the infinity norm [m]; the side is 1 m
last = result.steps[-1]
newton = sum(step["newton"] for step in result.steps)
if MPI.COMM_WORLD.rank == 0:
    print(f"\n{newton} Newton iterations; at the end: largest displacement {displacement:.1e} m,")
    print(f"energy {last['energy']:.1e} J, smallest J {last['min_J']:.6f}")
    print(f"picture: {render(args.out, loads=[0.0, 1.0])}")

assert result.converged, result.status
assert displacement < 1e-6 and abs(last["min_J"] - 1) < 1e-4, (displacement, last)
