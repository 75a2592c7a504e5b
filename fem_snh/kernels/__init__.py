"""A material's energy as compiled C: `Material` at a point, loops over cells, UFL forms, reports.

`codegen` differentiates the energy's expression and writes C functions, ``include`` holds the C
code that is the same for every energy, `build` compiles both, and `material` calls the compiled
functions at points. `ufl_forms` gives the same energy as a UFL expression.
"""
