"""The hand of Smith et al. 2018, Figures 7 and 8: flesh on 24 bones that close to a fist."""

from __future__ import annotations

from math import cos, radians, sin
from typing import Any, NamedTuple

import numpy as np

from fem_snh.arrays import Array, ArrayLike
from fem_snh.scenes import Scene
from fem_snh.scenes._bones import (
    BoneSegment,
    JointMotion,
    bone_between,
    capsule,
    lattice_scene,
    limb,
)

#: The unit of the tables below, a millimetre [m]. x points along the fingers, y away from the
#: thumb, z out of the back of the hand; the origin is the wrist.
MM = 1e-3


class Finger(NamedTuple):
    """A finger: where its metacarpal begins and ends, and its phalanges [mm]."""

    base: tuple[float, float, float]
    knuckle: tuple[float, float, float]
    #: Angle in the plane of the hand to the x axis [deg].
    splay: float
    #: Angle about the x axis that brings the fingers of a fist together [deg].
    lean: float
    #: Lengths of the phalanges, and radii of the flesh around them.
    lengths: tuple[float, float, float]
    radii: tuple[float, float, float]
    #: Angles of the phalanges of a fist to the plane of the hand [deg]: the fingertip presses about
    #: 2 mm into the palm.
    fist: tuple[float, float, float]


FINGERS = {
    "index": Finger(
        (22, -14, 0), (86, -27, 0), -11, 4, (42, 25, 20), (9.6, 8.6, 7.8), (85, 192, 260)
    ),
    "middle": Finger(
        (22, -3, 2), (89, -4, 2), -2, 1, (46, 29, 21), (9.8, 8.8, 8.0), (85, 193, 261)
    ),
    "ring": Finger((21, 8, 1), (83, 18, 1), 7, -3, (43, 27, 21), (9.4, 8.4, 7.6), (85, 190, 258)),
    "little": Finger(
        (19, 18, -2), (74, 38, -2), 17, -10, (34, 20, 19), (8.4, 7.4, 6.8), (85, 187, 253)
    ),
}
PHALANGES = ("proximal", "middle", "distal")
#: Radii of the phalanges' bones [mm].
PHALANX_RADII = (3.6, 3.2, 2.8)
#: Joints and tip of the thumb, open and in a fist; radii of the flesh and of the bones [mm].
THUMB = ((12, -22, -6), (45, -50, -14), (70, -68, -16), (92, -82, -18))
THUMB_IN_FIST = ((12, -22, -6), (42, -36, -37), (66, -27, -60), (75, -2, -64))
THUMB_RADII, THUMB_BONE_RADII = (13, 11.2, 9.8), (4.0, 3.8, 3.2)
#: The loads at which the fingers have closed, and at which the thumb begins to follow: earlier, it
#: would be in the fingers' way.
FINGERS_END, THUMB_BEGINS = 0.75, 0.4
#: Bones of forearm and wrist, ends and radius [mm]. The axes of the other bones end GAP before each
#: joint: about 5 mm of flesh are between two bones, so that the flesh that they crush as they turn
#: is not thinner than a cell.
FOREARM = {"radius": ((-135, -15, 0), (-9, -12, 0), 6.0), "ulna": ((-135, 15, 0), (-9, 12, 0), 5.5)}
CARPALS = {
    "radial_carpals": ((6, -12, -2), (16, -17, -3), 4.0),
    "middle_carpals": ((6, -2, 1), (16, -4, 2), 4.0),
    "ulnar_carpals": ((6, 9, 0), (15, 13, -1), 4.0),
}
METACARPAL_RADIUS, GAP = 4.0, 6.0
#: Flesh that no finger has: forearm, wrist, ball of the thumb, edge and pads of the palm.
FLESH = (
    *(((-130, y, 0), (-90, y, 0), 26) for y in (16, -16)),
    *(((-90, y, 0), (-50, 0.85 * y, 0), 22) for y in (16, -16)),
    *(((-60, 1.2 * y, 0), (-5, y, 0), 18) for y in (11, -11)),
    *(((-5, y, 0), (20, 0.8 * y, 0), 14) for y in (9, -9)),
    ((18, -18, -6), (42, -34, -9), 12),
    ((16, 22, -6), (66, 36, -5), 11),
    ((65, -24, -8), (61, 18, -8), 10.5),
)
#: Flesh around a metacarpal, below its axis: radius, heights of its ends; blend of all flesh [mm].
PALM, PALM_HEIGHTS, BLEND = 12.5, (-2, -1), 2.0
#: Load steps: a fist closes in two seconds of film. In one second, fingertips move by more than
#: half of a finger's thickness in a step, and pass through what they touch.
FRAMES = 48
#: L-BFGS iterations in the trust region, at most: more cost more than further Newton steps.
LBFGS_MAX_IT = 40
#: From the elbow's end to the tip of the middle finger [mm].
LENGTH = 341.0


def hand(cells: int = 119, noise: float = 0.05, seed: int = 1, contact: bool = True) -> Scene:
    """A hand and forearm whose 24 bones close to a fist.

    Parameters
    ----------
    cells : int
        Cells from the elbow to the fingertips: 119 give 39,000 in all, 60 give 6,000.
    noise : float
        Noise of the bones' affine maps, relative to the length of the bone.
    seed : int
        Seed of the noise.
    contact : bool
        Whether the surface has self-contact.
    """
    keys = {"name": "hand", "element": "Q1", "steps": FRAMES, "load_name": "fist"}
    petsc = {"snes_lbfgs_max_it": LBFGS_MAX_IT}
    cell = LENGTH * MM / cells
    return Scene(**lattice_scene(flesh(), cell, rig(), noise, seed, contact, petsc=petsc, **keys))


def rig() -> list[BoneSegment]:
    """Return the bones of the hand [m]."""
    wrist = JointMotion((0.0, 0.0, 0.0))
    still = (FOREARM | CARPALS).items()
    bones = [BoneSegment(n, wrist, _m(a), _m(b), r * MM) for n, (a, b, r) in still]
    for name, finger in FINGERS.items():
        ends = _m(finger.base), _m(finger.knuckle)
        metacarpal = f"{name}_metacarpal"
        bones.append(bone_between(metacarpal, wrist, *ends, METACARPAL_RADIUS * MM, GAP * MM))
        lean = radians(finger.lean)
        directions = [
            (cos(a), sin(a) * sin(lean), -sin(a) * cos(lean)) for a in map(radians, finger.fist)
        ]
        names = [f"{name}_{phalanx}" for phalanx in PHALANGES]
        sections = [(radius * MM, GAP * MM) for radius in PHALANX_RADII]
        bones += limb(wrist, names, phalanges(finger), directions, sections, end=FINGERS_END)
    names = [f"thumb_{bone}" for bone in ("metacarpal", "proximal", "distal")]
    sections = [(radius * MM, GAP * MM) for radius in THUMB_BONE_RADII]
    fist = np.diff(THUMB_IN_FIST, axis=0)
    return bones + limb(wrist, names, _m(THUMB), fist, sections, THUMB_BEGINS)


def flesh() -> dict[str, Any]:
    """Return the table of the body's shape: a smooth union of capsules [m]."""
    shapes = [capsule(_m(a), _m(b), r * MM) for a, b, r in FLESH]
    for finger in FINGERS.values():
        ends = zip((finger.base, finger.knuckle), PALM_HEIGHTS, strict=True)
        a, b = (_m((x, y, z + height)) for (x, y, z), height in ends)
        shapes += [capsule(a, b, PALM * MM), *_around(phalanges(finger), finger.radii)]
    shapes += _around(_m(THUMB), THUMB_RADII)
    return {"smooth_union": {"shapes": shapes, "blend": BLEND * MM}}


def phalanges(finger: Finger) -> Array:
    """Return the positions of a finger's joints and tip (4, 3) [m]."""
    angle = radians(finger.splay)
    along = np.cumsum([0, *finger.lengths])[:, None] * (cos(angle), sin(angle), 0.0)
    return _m(finger.knuckle + along)


def _around(points: Array, radii: tuple[float, float, float]) -> list[dict[str, Any]]:
    """Return capsules around the segments of a finger, the last of which ends at the tip."""
    last = points[-1] - points[-2]
    ends = [*points[1:-1], points[-1] - radii[-1] * MM * last / np.linalg.norm(last)]
    return [capsule(a, b, r * MM) for a, b, r in zip(points, ends, radii, strict=False)]


def _m(x: ArrayLike) -> Array:
    """Convert points from mm to m."""
    return MM * np.asarray(x, dtype=float)
