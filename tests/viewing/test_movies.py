"""Movies: smooth over the load, exact at the stored states; mistakes are one line."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

from mpi4py import MPI

import imageio
import numpy as np
import pytest
from picture_runs import write_run

from fem_snh.viewing import render
from fem_snh.viewing.states import InterpolatedStates

pytestmark = pytest.mark.one_debian

SECONDS = 0.2
LOADS = (0.0, 0.5, 1.0)


@pytest.fixture(scope="module")
def twisted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_run(MPI.COMM_SELF, tmp_path_factory.mktemp("twisted"), "Q1")


@pytest.mark.parametrize("field", ["J", "displacement"])
def test_stored_states_are_exact_and_others_lie_between(twisted, field):
    stored = render.stored_loads(twisted / "fields.pvd")
    files = {load: [str(file) for file in stored[load]] for load in LOADS}
    states = InterpolatedStates(files, field)
    for load, stored in zip(LOADS, states.displacement, strict=True):
        assert np.allclose(states.grid(load).point_data["displacement"], stored, atol=1e-12)
    low, high = states.values.min(axis=0), states.values.max(axis=0)
    between = np.asarray(states.grid(0.3)[field])
    assert np.all(between >= low - 1e-12) and np.all(between <= high + 1e-12)
    assert np.abs(between - states.values[0]).max() > 1e-3


@pytest.mark.parametrize("suffix", [".mp4", ".gif"])
def test_movie_has_its_frames_and_moves(twisted, tmp_path, suffix):
    reported: list[tuple[int, int]] = []
    path = tmp_path / f"a{suffix}"
    out = render.movie(twisted, path, "J", SECONDS, lambda *n: reported.append(n))
    count = round(SECONDS * render.FRAMES_PER_SECOND)
    assert reported == [(k, count) for k in range(1, count + 1)]
    images = [np.asarray(image) for image in imageio.get_reader(out)]
    assert len(images) == count
    # The first frame is the body at rest; colours and shape change from frame to frame.
    colours = [image[..., :3].astype(int) for image in images]
    changes = [np.abs(a - b).mean() for a, b in pairwise(colours)]
    assert min(changes) > 0.1
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
