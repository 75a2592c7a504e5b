"""What the tables of a scene hold, each with what to say where it is something else."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from fem_snh.scenes._validation import Expect, Finite

Text = Annotated[str, Field(min_length=1), Expect("a name")]
Number = Annotated[Finite, Expect("a finite number")]
Count = Annotated[int, Field(strict=True, ge=1), Expect("a whole number, 1 or more")]
Vector = Annotated[tuple[Finite, Finite, Finite], Expect("three finite numbers, [x, y, z]")]
Matrix = Annotated[tuple[Vector, Vector, Vector], Expect("a matrix, three rows of three numbers")]
Volume = Annotated[Finite, Field(gt=0), Expect("a number > 0 (times the body's volume)")]
GroupKey = Annotated[
    Annotated[str, Field(min_length=1)] | Annotated[int, Field(strict=True)],
    Expect("the name or number of a physical group"),
]
Axis = Literal["x", "y", "z"]
Components = Annotated[
    tuple[Axis, ...], Field(min_length=1, max_length=3), Expect("a list of 'x', 'y', 'z'")
]
