"""The types of numpy's arrays in annotations; shapes and types of numbers are in docstrings."""

from typing import Any

import numpy.typing as npt

Array = npt.NDArray[Any]
ArrayLike = npt.ArrayLike
