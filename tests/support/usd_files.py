"""What a USD file holds, read by usd-core in a process of its own.

Its libraries disturb gmsh, which other tests of the same process use.
"""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

_READ = """
import sys
import numpy as np
from pxr import Usd, UsdGeom

stage = Usd.Stage.Open(sys.argv[1])
mesh = UsdGeom.Mesh(stage.GetDefaultPrim())
found = {"start": stage.GetStartTimeCode(), "end": stage.GetEndTimeCode()}
found["times"] = times = mesh.GetPointsAttr().GetTimeSamples()
found["counts"] = mesh.GetFaceVertexCountsAttr().Get()
found["faces"] = mesh.GetFaceVertexIndicesAttr().Get()
points = [mesh.GetPointsAttr().Get(t) for t in times]
found["points"], found["extents"] = points, [mesh.GetExtentAttr().Get(t) for t in times]
found["computed_extents"] = [mesh.ComputeExtent(x) for x in points]
for primvar in UsdGeom.PrimvarsAPI(mesh).GetPrimvarsWithValues():
    assert primvar.GetInterpolation() == "vertex", primvar.GetPrimvarName()
    found[primvar.GetPrimvarName()] = [primvar.Get(t) for t in times]
np.savez(sys.argv[2], **found)
"""


def needs_usd() -> None:
    """Skip the test if usd-core is not installed."""
    if find_spec("pxr") is None:
        pytest.skip("usd-core is not installed")


def read_usd(path: Path) -> Any:
    """Return the arrays of a mesh over time by name, those of its primvars included."""
    out = path.with_suffix(".npz")
    subprocess.run([sys.executable, "-c", _READ, str(path), str(out)], check=True)
    return np.load(out)
