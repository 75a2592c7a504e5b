"""Robustness tests of materials and solver, each case in a process of its own.

    >>> from fem_snh.studies.extremes.study import extremes
    >>> extremes("out/extremes", quick=True, jobs=2).failures
    {}

A family of cases is a module of `FAMILIES` with

    LABEL, BY   the rows of its table: a regular expression that finds the first column in a case's
                name, and the columns of the table whose values share a row
    PICTURES    {file: (caption, [(folders, load, label)])}: bodies side by side, each in the first
                folder that a pattern matches
    cases(quick, seeds, material) -> list of `fem_snh.studies.extremes.cases.Case`

and, if it has any,

    aggregate_criteria(rows) -> criteria of several cases together: {criterion: why it fails or ""}

The runs of the last families have tight solves beside them (``tight.py``): nothing that they call
converged is contradicted by more than 1 %.

What is tested, and what theory says, is in ``about/FAMILY.md``. Most cases are runs of scenes,
which ``fem-snh run`` repeats; a case of ``pointwise`` is repeated by
``python -m fem_snh.studies.extremes.pointwise MATERIAL FOLDER``.
"""

#: In the order of the page.
FAMILIES = (
    "pointwise", "scramble", "crush", "loads", "drop", "press",
    "contrast", "aspect", "supports", "rigid", "small_force",
)  # fmt: skip
