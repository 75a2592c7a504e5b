"""Measurements that anyone can repeat: each prints JSON, one line per row.

assembly      the filtered Jacobian against FFCx's exact one; --elements Q1 --cells N --material M
              (all: every material against stable_neo_hookean)
twist         Newton and linear iterations on the paper's twist; --cells N --hessians clamp,adaptive
              --nu X --steps N
stretch       the paper's stretch, its materials; --elements Q1 --materials M,M --cells N --steps N
references    published numbers beside ours; --only cook,torsion --write docs/results/references.md
ranks         the same runs on 1 and 2 ranks; --cells N
eigensolvers  accuracy and cost of the 3x3 eigensolvers; --samples N --points N --seed N
filters       clamp, abs, adaptive from rough starts; --elements M,M --cases C,C --nus X,X --seeds N
policies      every policy on hard loads, in one step; --cases C,C --nus X,X --cells N,N
              --hessians H,H --corrections N,N --seeds N --noise X
              --tolerance X --most N --factors true
orders        errors of a manufactured solution; --elements M,M --nus X,X --cells N,N --swell X
quadrature    elements by quadrature degree: modes, errors, cost; --elements M,M --nus X,X --cells N
taylor_hood   Taylor-Hood elements' linear iterations by nu; --elements M,M --nus X,X --tolerance X
growth        linear iterations against mesh and nu, by solver; --cells N,N --nus X,X --solvers S,S
              --element M --tolerance X
traffic       the parts of a Newton step, beside the memory's speed; --cells N --nu X --repeat N
solve         the stretch by the paper's recipe, FEniCSx's tutorial and ours; --cells N,N --ways W,W
              --nu X --steps N --ranks N --timeout S --memory GiB
bound         mixed elements by the bound of their local lambda; --elements M,M --bounds X,X

twist, stretch, policies, growth and traffic use the ranks they are started on:
    mpirun -n 2 python -m benchmarks twist
"""

from __future__ import annotations

import inspect
import json
from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Any

from fem_snh.errors import choose, unknown_name

NAMES = (
    "assembly",
    "bound",
    "eigensolvers",
    "filters",
    "growth",
    "orders",
    "policies",
    "quadrature",
    "ranks",
    "references",
    "taylor_hood",
    "solve",
    "stretch",
    "traffic",
    "twist",
)

Row = dict[str, Any]


def main(name: str, options: dict[str, Any]) -> int:
    """Run one measurement and print its rows on rank 0; 0 if every row that has "ok" is ok.

    Raises BadInput for an unknown measurement or option.
    """
    module = import_module(f"{__name__}.{choose('bench', name, NAMES)}")
    rows: Callable[..., Iterator[Row]] = module.rows
    for key in options:
        if key not in (known := inspect.signature(rows).parameters):
            raise unknown_name(f"option of bench {name}", key, known)
    from mpi4py import MPI

    good = True
    for row in rows(**options):
        good &= bool(row.get("ok", True))
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps({"bench": name} | row), flush=True)
    return 0 if good else 1


def words(text: str) -> list[str]:
    """A comma list as a list."""
    return [word for word in str(text).split(",") if word]
