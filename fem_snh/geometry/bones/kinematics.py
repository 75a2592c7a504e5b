"""Forward kinematics: the pose of a joint from those of the joints on which it hangs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def global_pose(
    number: int, parents: Sequence[int], local_pose: Callable[[int], tuple[Array, Array]]
) -> tuple[Array, Array]:
    """Return rotations (m, 3, 3) and translations (m, 3) of a joint at m instants.

    The pose x -> R x + d of a joint is its local one, then its parent's, up to the root.

    Parameters
    ----------
    number : int
        The joint's number.
    parents : sequence of int
        The number of each joint's parent; -1 of a root.
    local_pose : callable
        Rotations (m, 3, 3) and translations (m, 3) of a joint in the frame of its parent.
    """
    R, d = local_pose(number)
    while (number := parents[number]) >= 0:
        turned, origin = local_pose(number)
        R, d = turned @ R, np.einsum("mij,mj->mi", turned, d) + origin
    return R, d
