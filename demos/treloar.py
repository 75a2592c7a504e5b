# %% [markdown]
# # Treloar's rubber: which material fits
#
# Treloar's tests of 1944 {cite}`Treloar1944` stretch one rubber in three ways: in one direction, in
# two, and in one with the width held. A material that is fitted to one of them need not predict the
# others. This program fits five energies to all three at once and compares them with the constants
# that Ogden published {cite}`Ogden1972`.
#
# ![Stress against stretch in three tests, with the fits of five energies](treloar.png)
#
# ```bash
# python demos/treloar.py
# ```
#
# The same on the command line, with all materials:
#
# ```bash
# fem-snh fit --all treloar
# ```

# %%
from argparse import ArgumentParser
from pathlib import Path

from mpi4py import MPI

import fem_snh
from fem_snh.studies.fit import ordered
from fem_snh.viewing.plots.materials import draw_fits

MATERIALS = ["ogden", "gent", "yeoh", "stable_fung", "neo_hookean"]

# %% [markdown]
# Ogden's constants are $\mu_p = (0.63, 0.0012, -0.01)$ MPa and $\alpha_p = (1.3, 5, -2)$. Here the
# $\mu_p$ are weights, whose common factor follows from E. Only E is fitted then.

# %%
PUBLISHED = {"exponents": (1.3, 5.0, -2.0), "weights": (0.63, 0.0012, -0.01)}
parser = ArgumentParser(description="Fits to Treloar's data.")
parser.add_argument("--out", type=Path, default=Path("out/treloar"))

# %%
if __name__ == "__main__":
    args = parser.parse_args()
    if MPI.COMM_WORLD.rank == 0:  # a fit takes less than a second
        fits = ordered([fem_snh.fit(name, "treloar") for name in MATERIALS])
        published = fem_snh.fit("ogden", "treloar", held=PUBLISHED)
        print(f"E of Ogden's constants: {published.E / 1e6:.3f} MPa, published 1.268 MPa")
        for f in [*fits, published]:
            name = "published" if f is published else f.name
            print(f"{name:12} {len(f.parameters)} parameters, R^2 {f.r_squared:.4f}")
        best = fits[0]
        assert best.name == "ogden"
        assert best.stable_at_data
        assert best.rms < published.rms
        print(best.table())
        best.write(args.out / "fit.json")
        print(draw_fits(fits, args.out / "treloar.png"))
