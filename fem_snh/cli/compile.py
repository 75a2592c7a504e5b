"""The command ``compile``: compile the kernels of materials on elements ahead of their first run.

Solutions of a small problem on each element compile the loops over its cells and the libraries that
do not depend on the material; the functions of each material at a point are then compiled, and
linked to the loops. A run finds the results in the cache (`fem_snh.cache`).
"""

from __future__ import annotations

import fem_snh
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.cli import start_petsc
from fem_snh.cli.options import Parser
from fem_snh.errors import choose
from fem_snh.kernels.material import material, supports
from fem_snh.materials.parameters import variants
from fem_snh.materials.registry import function, names

#: Poisson's ratios of the solutions: elements of mean dilatation have cell pressures at the second.
_SOLVED = (0.49, 0.4999)
#: Poisson's ratios that differ in their generated code: 0.5 is incompressible, and a material with
#: variants (stable_neo_hookean) has another one below 0.4.
_RATIOS, _OTHER_VARIANT = (0.49, 0.5), 0.3


def compile_parser() -> Parser:
    """Return the parser of ``fem-snh compile``."""
    return Parser(
        "compile",
        "Compile the kernels of solids before a run needs them.",
        """
        names NAME  materials; default: all
        --elements E,E  elements; default: all
        """,
        names={"nargs": "*", "default": names()},
        elements={"default": ",".join(ELEMENTS)},
    )


def compile(argv: list[str]) -> int:
    """Compile the kernels of materials on the elements that support them; return 0. Collective.

    Ranks share the materials.
    """
    args = compile_parser().parse(argv)
    elements = [choose("element", each.strip(), ELEMENTS) for each in args.elements.split(",")]
    functions = {name: function(name) for name in args.names}
    start_petsc()
    from mpi4py import MPI

    from fem_snh.assembly.cell_loops import compile_cell_loops  # imports dolfinx

    tables = {}
    for element in elements:
        for nu in _SOLVED:
            run = fem_snh.run("twist", element=element, nu=nu, cells=2, progress=False)
            found = run.problem.elastic.parts[0].loops.tables
            tables[element, found.volume] = found
    for name in args.names[MPI.COMM_WORLD.rank :: MPI.COMM_WORLD.size]:
        for nu in (*_RATIOS, *([_OTHER_VARIANT] if variants(functions[name]) else [])):
            made = material(name, 1.0, nu)
            for each in tables.values():
                if supports(made, each.volume):
                    compile_cell_loops(made, each)
    if MPI.COMM_WORLD.rank == 0:
        print(f"compiled on {', '.join(elements)}: {', '.join(args.names)}")
    return 0
