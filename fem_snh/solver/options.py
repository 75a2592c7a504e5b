"""The PETSc options of projected Newton that SNES and KSP do not have, and checks of options.

The documentation lists `OPTIONS`; ``-snes_view`` prints their values.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from petsc4py import PETSc

from fem_snh._petsc import default_options, option_used
from fem_snh.choices import (
    DEFAULT_HESSIAN,
    DEFAULT_LBFGS_MAX_IT,
    FILTERS,
    GLOBALIZATION_OF_NAMED_HESSIAN,
    GLOBALIZATIONS,
    HESSIANS,
)
from fem_snh.errors import BadInput, Range, bad_value, choose, in_words
from fem_snh.records.run_record import Note
from fem_snh.solver.linear_choice import CHOICES

Value = str | float
Values = dict[str, Value]


_PART, _RELATIVE = Range(0, 1), Range(0, 1, open_high=True)
_COUNT = Range(0, 1e9, whole=True)
#: The largest accepted tolerance of ||residual|| / (E V^(2/3)): strains of about 1e-2.
_LARGEST_RESIDUAL = 1e-2


class Option(NamedTuple):
    """An option under the solver's prefix.

    Attributes
    ----------
    default : str or float
    meaning : str
        The description in the documentation.
    origin : str
        The source of the name and the default value.
    accepted : Range or sequence of str, optional
        The values that `read` accepts; empty if `read_choices` or `choose_linear_solver` checks.
    """

    default: Value
    meaning: str
    origin: str
    accepted: Range | Sequence[str] = ()


_NW = "Nocedal & Wright 2006"
_MEASURED = "measured: python -m benchmarks negative_curvature"

#: The options by name, without the leading dash. `defaults_for` replaces the defaults of
#: ``snes_globalization`` and ``snes_lbfgs_max_it``, which depend on the globalization.
OPTIONS: dict[str, Option] = {
    "snes_hessian": Option(
        DEFAULT_HESSIAN, "Hessian: exact, clamp, abs or adaptive", "Teran et al. 2005 (clamp)"
    ),
    "snes_globalization": Option(
        "linesearch",
        "linesearch or trust_region, the default of a minimisation problem",
        f"{_NW}, chapters 3 and 4",
    ),
    "snes_linear_solver": Option(
        CHOICES[0],
        "iterative, direct (sparse factors), or automatic: direct for bars, thin sheets, layers "
        "near nu = 1/2, and in two dimensions unless iterations are few",
        "measured: python -m benchmarks linear_solvers",
    ),
    "snes_adaptive_filter": Option(
        "clamp", "filter that adaptive falls back to: clamp or abs", _MEASURED, FILTERS[1:]
    ),
    "snes_scaled_tol": Option(
        1e-7,
        "converged when ||residual||_2 <= this times the smaller of E V^(2/3) and 1000 times the "
        "norm of the forces that act", "scale-invariant -snes_atol",
        Range(0, _LARGEST_RESIDUAL),
    ),
    "snes_forcing_max": Option(
        0.1,
        "largest relative tolerance of a linear solve; 0: always -ksp_rtol",
        "Eisenstat & Walker 1996, choice 2; PETSc's -snes_ksp_ew_rtolmax", _RELATIVE
    ),
    "snes_forcing_safeguard": Option(
        0.0,
        "linear solves aim no lower than this part of Newton's tolerance (0.25 is faster)",
        "Kelley 1995, eq. 6.20", _PART
    ),
    "snes_lbfgs_max_it": Option(
        0.0,
        "L-BFGS iterations after a Newton step, at most; 640 by default in a trust region, with "
        "sparse factors 40",
        f"{_NW}, alg. 7.5", _COUNT
    ),
}  # fmt: skip


def defaults_for(globalization: str) -> Values:
    """Return the default values of `OPTIONS`, by name, for one of `GLOBALIZATIONS`."""
    values = {name: option.default for name, option in OPTIONS.items()}
    values["snes_globalization"] = globalization
    values["snes_lbfgs_max_it"] = float(DEFAULT_LBFGS_MAX_IT[globalization])
    return values


def read_choices(
    prefix: str, hessian: str | None, globalization: str | None
) -> tuple[str, str | None]:
    """Return the names of the Hessian and of the globalization.

    PETSc's options override the arguments. If only the Hessian is named, the globalization is
    `GLOBALIZATION_OF_NAMED_HESSIAN`; if neither is named, None.

    Raises
    ------
    BadInput
        For an unknown value.
    """
    database = PETSc.Options(prefix)
    choose("hessian", hessian or DEFAULT_HESSIAN, HESSIANS)
    chosen = database.getString("snes_hessian", "") or hessian
    wanted = database.getString("snes_globalization", "") or globalization
    wanted = wanted or (GLOBALIZATION_OF_NAMED_HESSIAN if chosen else None)
    chosen = choose("hessian", chosen or DEFAULT_HESSIAN, HESSIANS)
    return chosen, wanted and choose("globalization", wanted, GLOBALIZATIONS)


def read(prefix: str, given: Values) -> Values:
    """Return the values of `OPTIONS`: from PETSc's database, or as ``given`` if it has none.

    ``snes_hessian`` and ``snes_globalization`` are always as ``given``: `read_choices` reads them.

    Raises
    ------
    BadInput
        For a value that an option does not accept.
    """
    database, values = PETSc.Options(prefix), dict(given)
    for name, option in OPTIONS.items():
        if name in ("snes_hessian", "snes_globalization"):
            continue
        get = database.getString if isinstance(option.default, str) else database.getReal
        values[name] = get(name, given[name])
        if not isinstance(option.accepted, Range):
            if option.accepted:
                choose(name, str(values[name]), option.accepted)
        elif float(values[name]) not in option.accepted:
            raise bad_value(name, values[name], str(option.accepted))
    return values


#: Accepted numbers of PETSc's own options; with others, such as snes_rtol = 1, nothing is solved.
_PETSC_RANGES = {
    "snes_max_it": Range(0, whole=True),
    "snes_rtol": _RELATIVE,
    "snes_stol": _RELATIVE,
    **{
        f"{solver}ksp_{name}": accepted
        for solver in ("", "trust_", "fieldsplit_u_", "fieldsplit_p_")
        for name, accepted in {
            "rtol": _RELATIVE,
            "atol": Range(0),
            "divtol": Range(1),
            "max_it": Range(1, whole=True),
            "deflation_subdomains": Range(-1, whole=True),
        }.items()
    },
}
#: PETSc's options that would replace a part of the solver, and the part.
_REPLACED = {
    "snes_python_type": "projected Newton, which fem_snh adds to PETSc",
    **dict.fromkeys(
        ("snes_mf", "snes_mf_operator", "snes_fd", "snes_fd_color"),
        "an assembled Hessian, filtered at every quadrature point",
    ),
}


def check_petsc(prefix: str, force_scale: float) -> None:
    """Raise BadInput for PETSc options that replace the solver, or with which nothing is solved.

    Parameters
    ----------
    prefix : str
        The prefix of the options.
    force_scale : float
        E V^(2/3) [N], to which ``snes_atol`` is compared.
    """
    database = PETSc.Options(prefix)
    kind = database.getString("snes_type", PETSc.SNES.Type.PYTHON)
    if kind != PETSc.SNES.Type.PYTHON:
        accepted = f"no value: the solver is {_REPLACED['snes_python_type']}"
        raise bad_value("snes_type", kind, accepted)
    for name, part in _REPLACED.items():
        if database.hasName(name):
            raise bad_value(name, database.getString(name, ""), f"no value: the solver has {part}")
    ranges = {**_PETSC_RANGES, "snes_atol": Range(0, _LARGEST_RESIDUAL * force_scale)}
    for name, accepted_range in ranges.items():
        try:
            value = float(database.getString(name, "")) if database.hasName(name) else None
        except ValueError:  # a word of PETSc's, as "unlimited", or a mistake that PETSc reports
            continue
        if value is not None and value not in accepted_range:
            raise bad_value(name, value, str(accepted_range))


def check_minimisation(options: Values, problem: str) -> None:
    """Raise BadInput if an option requires a minimisation problem.

    Parameters
    ----------
    options : dict
        The values of `OPTIONS`.
    problem : str
        Why the problem is not a minimisation problem.
    """
    wanted = ""
    if options["snes_globalization"] == "trust_region":
        wanted = "globalization = 'trust_region'"
    elif float(options["snes_lbfgs_max_it"]) > 0:
        wanted = f"snes_lbfgs_max_it = {options['snes_lbfgs_max_it']:g}"
    if wanted:
        raise BadInput(f"{wanted}: requires a minimisation problem; {problem}")


#: Prefixes of options for computations that may follow a solve: eigenfrequencies, error estimates.
_LATER = ("modes_", "lifted_")


def unused_options(names: Iterable[str]) -> list[Note]:
    """Return a list with a note on the options that no solver has read; empty if all were read.

    ``names`` include the prefix. PETSc itself does not report misspelt options.
    """
    unused = [f"-{name.lstrip('-')}" for name in names if not option_used(name.lstrip("-"))]
    if not unused:
        return []
    text = f"no solver has the PETSc option {in_words(unused)}: it may be misspelt"
    return [Note("options", text, values={"names": unused})]


class GivenOptions:
    """The PETSc options that a program passes; they are in PETSc's database within `active`.

    Parameters
    ----------
    prefix : str
        The prefix of the options.
    options : mapping or None
        Values by name, without the prefix.

    Raises
    ------
    BadInput
        If ``options`` is not a mapping of option names, or ``prefix`` is not a str.
    """

    def __init__(self, prefix: str, options: Mapping[str, object] | None) -> None:
        _check_given(prefix, options)
        self.prefix, self.values = prefix, dict(options or {})
        names = (name.lstrip("-") for name in self.values)
        self._unused = {prefix + name for name in names if not name.startswith(_LATER)}

    @contextmanager
    def active(self) -> Iterator[None]:
        """Set the options that the user has not set, for the duration of a ``with`` block."""
        with default_options(self.prefix, self.values):
            yield
            self._unused = {name for name in self._unused if not option_used(name)}

    def notes(self) -> list[Note]:
        """Return a note on the options that no solver has read in any `active` block, or []."""
        return unused_options(sorted(self._unused))


def _check_given(prefix: object, options: object) -> None:
    """Raise BadInput unless ``prefix`` is a str and ``options`` maps option names, or is None."""
    if not isinstance(prefix, str):
        raise bad_value("petsc_options_prefix", prefix, "a text, e.g. 'press_'")
    if options is not None and not isinstance(options, Mapping):
        raise bad_value("petsc_options", options, "a mapping of options without prefix to values")
    for name in options or {}:
        if not isinstance(name, str) or not name.strip("-"):
            raise bad_value("petsc_options", name, "the name of a PETSc option, e.g. 'ksp_rtol'")
