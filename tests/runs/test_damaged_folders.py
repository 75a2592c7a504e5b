"""Damaged and edited folders of runs and studies: one line that names the file and the key."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from interrupted_runs import ALL, ALONE, cut, solve

from fem_snh.cli import main
from fem_snh.errors import BadInput

TWIST: dict[str, Any] = {"cells": 1, "steps": 2, "angle": 0.2}


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was cut off after its first step."""
    folder: Path = ALL.bcast(tmp_path_factory.mktemp("left"))
    with cut(1):
        solve("twist", ALONE, out=folder / "run", **TWIST)
    return folder / "run"


@pytest.mark.one_debian("ranks")
@pytest.mark.mpi
@pytest.mark.parametrize("kept", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_checkpoint_that_was_cut_off(left: Path, folder: Path, kept: float) -> None:
    out = folder / "out"
    if ALL.rank == 0:
        shutil.copytree(left, out)
        whole = (out / "checkpoint.npz").read_bytes()
        (out / "checkpoint.npz").write_bytes(whole[: int(kept * len(whole))])
    ALL.barrier()
    with pytest.raises(BadInput, match=r"checkpoint\.npz cannot be read \(.+\): start again"):
        solve("twist", out=out, resume=True, **TWIST)
    ALL.barrier()


# --- run.json -------------------------------------------------------------------------------------

RECORDS = {
    "list": "[]",
    "null": "null",
    "cut off": '{"scene": "twist", "st',
    "nested": "[" * 100_000,
    "no steps": '{"scene": "a", "material": {"name": "a", "nu": 0.3}}',
    "steps": {"steps": 3},
    "step": {"steps": [3]},
    "load": {"steps": [{"load": "a"}]},
}
#: These are not checked: what reads them fails.
VALUES: dict[str, Any] = {
    "volume": {"steps": [{"load": 1, "volume_ratio": []}]},
    "nu": {"material": {"name": "a", "nu": "b"}},
    "material": {"material": [1]},
    "range": {"load_range": [0]},
    "time": {"time": 1},
    "pose": {"obstacles": {"a": {"shape": {}, "pose": [1]}}},
}


@pytest.mark.parametrize("case", [*RECORDS, *VALUES])
def test_an_edited_record(
    left: Path, tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """By every command that reads it; a finished run is not believed by --resume either."""
    content = (RECORDS | VALUES)[case]
    out = tmp_path / "out"
    shutil.copytree(left, out)
    if isinstance(content, dict):
        content = json.dumps(json.loads((out / "run.json").read_text()) | content)
    (out / "run.json").write_text(str(content))
    words = ["run twist --cells 1 --steps 2 --set angle=0.2 --resume --out"]
    for command in ("view", "plot", "render", *(words if case in RECORDS else [])):
        code, line = main([*command.split(), str(out)]), capsys.readouterr().err
        if code == 0 and case in VALUES:  # the command does not read this value
            continue
        assert code == 2 and re.fullmatch(r"fem-snh: error: [^\n]*\n", line)
        assert case in VALUES or "run.json: " in line
    if case in RECORDS:
        assert main(["export", str(out), str(tmp_path / "a.obj")]) == 2
        assert re.fullmatch(r"fem-snh: error: [^\n]*run\.json[^\n]*\n", capsys.readouterr().err)


# --- names of files, texts of users ---------------------------------------------------------------


def test_texts_of_users_do_not_end_the_page_or_a_formula(left: Path, tmp_path: Path) -> None:
    from html.parser import HTMLParser

    from fem_snh.viewing import plots
    from fem_snh.viewing.page import page
    from fem_snh.viewing.stored_run import Panel

    text = r"<!--<script></script>$\frac$ & $x$"
    record = json.loads((left / "run.json").read_text()) | {"scene": text, "load_name": text}

    class Scripts(HTMLParser):
        def __init__(self) -> None:
            super().__init__()
            self.inside, self.found = False, [""]

        def handle_starttag(self, tag: str, attrs: Any) -> None:
            self.inside = tag == "script"
            if self.inside:
                self.found.append("")

        def handle_endtag(self, tag: str) -> None:
            self.inside = self.inside and tag != "script"

        def handle_data(self, data: str) -> None:
            if self.inside:
                self.found[-1] += data

    plain, marked = Scripts(), Scripts()
    panel = Panel([], "c", 1.0)
    plain.feed(page(record | {"scene": "a", "load_name": "b"}, "J", [panel], [b""]))
    marked.feed(page(record, text, [replace(panel, label=text)], [b""]))
    assert len(marked.found) == len(plain.found)
    for mark in ("<!--", "<script", "</script"):
        assert "".join(marked.found).count(mark) == "".join(plain.found).count(mark)
    (tmp_path / "run.json").write_text(json.dumps(record))
    assert plots.main([tmp_path]).stat().st_size > 1000
