"""A material's energy as compiled C: `Material` at a point, loops over cells, UFL forms, reports.

`codegen` differentiates the expression and writes its C, ``include`` holds the C that is the same
for every energy, `build` compiles both, and `material` calls them at points. `ufl_forms` gives the
same energy as a UFL expression.
"""
