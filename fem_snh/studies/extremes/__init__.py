"""What the material and the solver survive: cases that must hold, one process each.

    >>> from fem_snh.studies.extremes.study import extremes
    >>> extremes("out/extremes", quick=True, jobs=2).failures
    {}

A family of cases is a module (`FAMILIES`) with (demands and pictures only if it has any)

    title    a few words
    about    what is asked, and what theory says, in Markdown
    cases(quick, seeds) -> list of `fem_snh.studies.extremes.cases.Case`
    tables(rows) -> Markdown of what came out
    demands(rows) -> what is asked of several together, in words: why it does not hold, or ""
    pictures(out) -> pictures to draw, `fem_snh.studies.extremes.pictures.Picture`

A case runs alone with ``fem-snh run``, or, where it is no run of a scene, with
``python -m fem_snh.studies.extremes FAMILY CASE FOLDER``.
"""

#: In the order of the page.
FAMILIES = ("pointwise", "scramble", "crush", "loads", "faults")
