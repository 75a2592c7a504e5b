"""Make the bones of a scene: read the surfaces and the motions that its tables name."""

from __future__ import annotations

from pathlib import Path

from fem_snh.errors import BadInput, unknown_name
from fem_snh.geometry.bvh import Clip, read_bvh
from fem_snh.geometry.motion_files import MotionRows, bone_motion, read_rows
from fem_snh.geometry.motions import Bone, DisplacementMotion, Motion, Noise
from fem_snh.geometry.shapes import ClosedSurface
from fem_snh.scenes._bones import BoneChoice, Function, SkeletonMotion
from fem_snh.scenes.schema import Scene
from fem_snh.tables.types import Vector


def read_bones(scene: Scene) -> list[Bone]:
    """Return the bones of a scene with their motions; read the files that they name.

    Raises
    ------
    BadInput
        One line, for a file that cannot be read or is not valid, a bone that is not in its file,
        and a name in a file that no bone has.
    """
    files = _Files(scene)
    noise, found = _noise(scene), []
    for choice in scene.bone:
        shape = choice.shape.shape() if choice.shape else None
        if choice.surface is not None:
            shape = ClosedSurface.read(choice.surface)
        motion, joint = files.motion(choice)
        origin = choice.origin or joint
        found.append(Bone(choice.name, shape, choice.group, motion, origin, noise))
    return found


def _noise(scene: Scene) -> Noise | None:
    """Return the noise of the scene's bones."""
    if scene.rig is None or scene.rig.noise is None:
        return None
    chosen = scene.rig.noise
    steps = scene.time.steps if scene.time else scene.steps
    return Noise(chosen.amplitude, chosen.seed, chosen.frames or steps, chosen.smooth)


class _Files:
    """The files of motions of a scene, each of which is read once."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._names = [choice.name for choice in scene.bone]
        self._tables: dict[Path, MotionRows] = {}
        self._clips: dict[Path, Clip] = {}

    def motion(self, choice: BoneChoice) -> tuple[Motion | Function | None, Vector | None]:
        """Return a bone's motion, or None if it does not move; of a joint also its position."""
        scene, motion = self._scene, choice.motion
        if isinstance(motion, Path):
            rows = self._table(motion)
            return bone_motion(rows, choice.name, scene.duration, choice.rigid), None
        if isinstance(motion, SkeletonMotion):
            if motion.bvh not in self._clips:
                self._clips[motion.bvh] = read_bvh(motion.bvh)
            return motion.motion(self._clips[motion.bvh], scene.duration)
        if motion is not None:
            return motion, None
        if not choice.is_moved:
            return None, None
        return DisplacementMotion(choice.scaled(scene.amplitudes).displacement), None

    def _table(self, path: Path) -> MotionRows:
        """Return the rows of a file, all of which must be of bones of the scene."""
        if path not in self._tables:
            rows = read_rows(path, with_bones=True)
            for line, name in zip(rows.lines, rows.bones, strict=False):
                if name not in self._names:
                    raise BadInput(
                        f"{path}, line {line}: {unknown_name('bone', name, self._names)}"
                    )
            self._tables[path] = rows
        return self._tables[path]
