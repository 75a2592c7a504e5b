"""Every demo is a page of the gallery, runs on several ranks, and its own assertions hold."""

from __future__ import annotations

import gc
import re
import runpy
import sys
from pathlib import Path

import pytest
from pages import DEMOS, ROOT

pytestmark = pytest.mark.one_debian

#: Small enough for a test; the others are as they come.
SMALLER = {
    "cylinder_stretch": ["--cells", "4"],
    "cube_twist": ["--cells", "7"],  # on 6 the filtered material does not stall
    "pull": ["--cells", "3", "--alphas", "0.5", "1"],
    "nu_sweep": ["--nus", "0.4", "0.499"],
    "modes": ["--cells", "3"],
    "cook": ["--finest", "16"],
    "gent": ["--cells", "4"],
    "scramble": ["--cells", "4"],
    "tutorial_beam": ["--cells", "4,1,1"],
    "foundation": ["--cells", "4"],
    "inflation": ["--cells", "2", "--steps", "12"],
    "biceps": ["--cells", "14"],  # its own smaller variant
    "elbow": ["--cells", "14", "--nus", "0", "0.499", "--steps", "2"],
    "squash": ["--cells", "16", "--substeps", "2", "--seconds", "0"],
    "hand": ["--cells", "40", "--steps", "4"],
    "torso": ["--cells", "30", "--steps", "4"],
}
#: What each leaves behind besides its run folders, if it is not DEMO/DEMO.png alone.
PICTURES = {
    "cylinder_stretch": ["cylinder_stretch/figure_5.png", "cylinder_stretch/figure_6.png"],
    "cube_twist": ["cube_twist/figure_9.png"],
    "accuracy": ["accuracy/mesh.png"],
    "pull": ["pull/figure_3.png"],
    "modes": ["modes/normalised/modes.png"],
    "nu_sweep": ["nu_sweep/sweep.png", "nu_sweep/sweep.csv"],
    "own_mesh": ["own_mesh/J.png"],
    "scramble": ["scramble/J.png"],
    "elbow": ["elbow/bodies.png", "elbow/sweep.png"],
}


@pytest.mark.parametrize("demo", DEMOS, ids=lambda demo: demo.stem)
def test_demo_reads_like_a_page(demo: Path) -> None:
    text = demo.read_text()
    assert text.startswith("# %% [markdown]\n# # ")
    assert len(text.splitlines()) <= 120
    assert f"python demos/{demo.name}" in text
    assert "assert " in text
    # No folder of a scene's name, into which the README and the pages run the scene.
    assert set(re.findall(r'default=Path\("out/(\w+)"\)', text)) <= {demo.stem}
    index = (ROOT / "docs" / "gallery" / "index.md").read_text()
    cards = ",".join(re.findall(r"^```\{generated\} grid (.*)$", index, re.M)).split(",")
    assert demo.stem in cards and f"\n{demo.stem}\n" in index


@pytest.mark.parametrize("demo", DEMOS, ids=lambda demo: demo.stem)
def test_pictures_of_the_page_are_committed_and_small(demo: Path) -> None:
    pictures = re.findall(r"^# !\[.+\]\((.+)\)$", demo.read_text(), re.M)
    assert pictures
    for picture in pictures:
        assert 1000 < (ROOT / "docs" / "gallery" / picture).stat().st_size < 300_000, picture


@pytest.mark.mpi(serially=False)
@pytest.mark.parametrize("demo", DEMOS, ids=lambda demo: demo.stem)
def test_demo_runs(demo, comm, folder, monkeypatch, capsys) -> None:
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", [str(demo), *SMALLER.get(demo.stem, [])])
    runpy.run_path(str(demo), run_name="__main__")
    # dolfinx's solvers are destroyed collectively: on all ranks here, not when each has time to.
    gc.collect()
    if comm.rank == 0:
        output = capsys.readouterr().out
        for picture in PICTURES.get(demo.stem, [f"{demo.stem}/{demo.stem}.png"]):
            assert (folder / "out" / picture).stat().st_size > 1000
            assert picture in output or Path(picture).name in output
