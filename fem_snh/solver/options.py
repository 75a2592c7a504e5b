"""PETSc options of projected Newton, beside SNES's own."""

from __future__ import annotations

from petsc4py import PETSc

from fem_snh.choices import HESSIANS
from fem_snh.errors import BadInput, choose

Options = dict[str, str | float]

#: Under the same prefix as SNES's, with their defaults.
OPTIONS: Options = {
    "snes_hessian": "adaptive",  # exact | clamp | abs | adaptive | trust
    "snes_adaptive_filter": "clamp",  # what adaptive falls back to: clamp | abs
    "snes_adaptive_retry": 0.1,  # after it did: exact again when the residual fell by this factor
    "snes_scaled_tol": 1e-7,  # converged when ||residual||_2 <= this * E V^(2/3)
    "snes_forcing_max": 0.1,  # largest relative tolerance of a linear solve; 0: always ksp_rtol
    "snes_corrections": 0,  # quasi-Newton steps after a step, at most; trust: 640, in its region
    "snes_armijo": 1e-4,  # sufficient decrease
    "snes_min_step": 1e-10,  # shortest step of the line search
}


def read(prefix: str, given: Options) -> Options:
    """What PETSc's database has of them, else as given."""
    database, found = PETSc.Options(prefix), {}
    for name, default in OPTIONS.items():
        get = database.getString if isinstance(default, str) else database.getReal
        found[name] = get(name, given[name])
    return found


def check(options: Options, not_least: str) -> None:
    """Raises BadInput for words that are none, and for what a problem cannot do.

    ``not_least``: what kind of a problem it is whose energy is not least at a solution, or "".
    """
    policy = choose("hessian", str(options["snes_hessian"]), HESSIANS)
    if not_least and policy == "trust":
        raise BadInput(f"hessian 'trust' needs an energy that is least: not {not_least}")
    if not_least and float(options["snes_corrections"]) > 0:
        raise BadInput(f"snes_corrections needs an energy that is least: not {not_least}")
    choose("snes_adaptive_filter", str(options["snes_adaptive_filter"]), ("clamp", "abs"))
