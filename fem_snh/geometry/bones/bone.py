"""A bone: what it is made of, and how it moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy.typing as npt

from fem_snh.errors import BadInput
from fem_snh.geometry.bones.motions import IDENTITY, AffineMotion, FunctionMotion
from fem_snh.geometry.bones.noise import Noise
from fem_snh.geometry.shapes.shape import Array, Shape


@dataclass(frozen=True)
class Bone:
    """A solid in the flesh, whose nodes follow its motion.

    Parameters
    ----------
    name : str
        Its name, by which ties between bones are decided.
    shape : Shape, optional
        The solid, at its reference position.
    group : str or int, optional
        A physical group of volumes, instead of a shape.
    motion : AffineMotion or callable, optional
        Its motion, or a function of the load that returns the (3, 4) matrix [A | c] of its map
        x = A X + c; without one it does not move.
    origin : (3,) tuple, optional
        A reference point [length], about which moments are given; default: the centre of the
        bounding box of the bone's nodes.
    noise : Noise, optional
        Random maps that are added to its motion.

    Raises
    ------
    BadInput
        Unless exactly one of ``shape`` and ``group`` is given.
    """

    name: str
    shape: Shape | None = None
    group: str | int | None = None
    motion: AffineMotion | Callable[[float], npt.ArrayLike] | None = None
    origin: tuple[float, float, float] | None = None
    noise: Noise | None = None

    def __post_init__(self) -> None:
        if (self.shape is None) == (self.group is None):
            found = "none" if self.shape is None else "both"
            raise BadInput(f"bone '{self.name}': expected a shape or a group; found {found}")

    def affine(self, load: float) -> Array:
        """Return the (3, 4) matrix [A | c] of x = A X + c [length] at a load, without noise."""
        if self.motion is None:
            return IDENTITY
        if callable(self.motion):
            return FunctionMotion(self.name, self.motion).affine(load)
        return self.motion.affine(load)
