"""Robustness tests of materials and solver, each case in a process of its own.

    >>> from fem_snh.studies.extremes.study import extremes
    >>> extremes("out/extremes", quick=True, jobs=2).failures
    {}

A family of cases is a module of `FAMILIES` with

    title     a few words
    about     what is tested, and what theory says, in Markdown
    cases(quick, seeds, material) -> list of `fem_snh.studies.extremes.cases.Case`
    tables(rows) -> Markdown tables of the results

and, if it has any,

    aggregate_criteria(rows) -> criteria of several cases together: {criterion: why it fails or ""}
    pictures(out) -> list of `fem_snh.studies.extremes.pictures.Picture`

Most cases are runs of scenes, which ``fem-snh run`` repeats; a case of ``pointwise`` is repeated by
``python -m fem_snh.studies.extremes.pointwise MATERIAL FOLDER``.
"""

#: In the order of the page.
FAMILIES = ("pointwise", "scramble", "crush", "loads", "drop", "press")
