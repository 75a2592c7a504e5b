"""The cache of compiled kernels: its key, concurrent use, error messages."""

from __future__ import annotations

import stat
import subprocess
import sys
from pathlib import Path

import pytest

from fem_snh import cache
from fem_snh.errors import BadInput
from fem_snh.kernels import build

SOURCE = "int answer(void) { return 42; }\n"


@pytest.fixture(autouse=True)
def cache_folder(monkeypatch, tmp_path) -> Path:
    """An empty cache for each test."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("FEM_SNH_CACHE", str(folder))
    monkeypatch.delenv("CC", raising=False)
    return folder


def script(path: Path, text: str) -> Path:
    """An executable shell script."""
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def one_line(function, *arguments) -> str:
    """The message of the BadInput that the call raises, checked to be one line."""
    with pytest.raises(BadInput) as caught:
        function(*arguments)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_source_is_compiled_once_and_kept_beside_its_library(cache_folder, monkeypatch):
    path = build.library(SOURCE)
    _, lib = build.load(path, "int answer(void);")
    assert lib.answer() == 42
    others = set(cache_folder.iterdir()) - {path, path.with_suffix(".c")}
    assert {p.suffix for p in others} <= {".py"}  # the declarations that `load` has parsed
    assert path.with_suffix(".c").read_text() == SOURCE
    before = path.stat().st_mtime_ns
    monkeypatch.setattr(build.subprocess, "run", None)  # the compiler is not called again
    assert build.library(SOURCE) == path
    assert path.stat().st_mtime_ns == before


def test_key_holds_source_flags_compiler_and_processor(monkeypatch, tmp_path):
    paths = {build.library(SOURCE), build.library(SOURCE + "/* another */\n")}
    monkeypatch.setattr(build, "FLAGS", [*build.FLAGS, "-DOTHER"])
    paths.add(build.library(SOURCE))
    real = build.compiler()
    monkeypatch.setenv("CC", str(script(tmp_path / "mycc", f'exec {real} "$@"')))
    paths.add(build.library(SOURCE))
    monkeypatch.setenv("CC", f"{real} -DMORE")
    paths.add(build.library(SOURCE))
    monkeypatch.setattr(build, "_environment", lambda command: "another processor")
    paths.add(build.library(SOURCE))
    assert len(paths) == 6
    assert all(p.exists() for p in paths)


def test_concurrent_processes_share_the_cache(cache_folder):
    """Four processes start on an empty cache; each gets a complete library."""
    code = (
        "from fem_snh.kernels import build\n"
        "source = ''.join(f'int f{i}(int x) {{ return x + {i}; }}\\n' for i in range(300))\n"
        "print(build.load(build.library(source), 'int f299(int);')[1].f299(1))"
    )
    start = [sys.executable, "-c", code]
    running = [
        subprocess.Popen(start, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(4)
    ]
    ended = [(*p.communicate(timeout=120), p.returncode) for p in running]
    assert {code for *_, code in ended} == {0}, ended
    assert {out for out, *_ in ended} == {"300\n"}
    assert sorted(p.suffix for p in cache_folder.iterdir()) == [".c", ".py", ".so"]


def test_a_compiler_error_is_bad_input_and_names_its_log(cache_folder):
    message = one_line(build.library, "no C at all\n")
    log = Path(message.rpartition(" ")[2])
    assert log.parent == cache_folder
    assert "error" in log.read_text()
    assert [p.suffix for p in cache_folder.iterdir()] == [".log"]


@pytest.mark.parametrize(
    "content", [None, "", "ffi = (", "1 / 0", "raise SystemExit", "\0", "ffi = 1"]
)
def test_declarations_are_read_from_the_cache_or_parsed_again(cache_folder, content):
    """Those that were edited are not executed."""
    path = build.library(SOURCE)
    declarations = f"int answer(void); /* {content!r} */"
    build.load(path, declarations)
    (stored,) = cache_folder.glob("*.py")
    written = stored.read_bytes()
    if content is not None:
        stored.write_text(content)
    build.load.cache_clear()
    ffi, lib = build.load(path, declarations)
    assert lib.answer() == 42 and ffi.new("int[2]", [1, 2])[1] == 2
    assert stored.read_bytes() == written
    assert type(ffi).__module__ == ("_cffi_backend" if content is None else "cffi.api")


# --- damaged and insecure caches ------------------------------------------------------------------


@pytest.mark.parametrize("kept", [0.0, 0.3, 0.9, 0.999])
def test_a_library_that_was_cut_off_is_compiled_again(kept: float) -> None:
    """To open it would end the process by SIGBUS."""
    path = build.library(SOURCE)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    assert build.stored(path.name) is None
    code = (
        f"from fem_snh.kernels import build; path = build.library({SOURCE!r}); "
        "print(build.load(path, 'int answer(void);')[1].answer())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "42\n"), done.stderr
    assert path.read_bytes() == whole


@pytest.mark.parametrize("mode", [0o775, 0o777, 0o702])
def test_a_cache_that_others_can_write_is_refused(cache_folder: Path, mode: int) -> None:
    path = build.library(SOURCE)
    assert stat.S_IMODE(cache_folder.stat().st_mode) == 0o700
    cache_folder.chmod(mode)
    for function, argument in ((build.library, SOURCE), (build.stored, path.name)):
        message = one_line(function, argument)
        assert message.startswith(f"FEM_SNH_CACHE = {cache_folder}: expected a folder that only")
        assert message.endswith(f"chmod go-w {cache_folder}")
    cache_folder.chmod(0o755)
    assert build.library(SOURCE) == path


def test_what_an_interrupted_compilation_leaves_is_removed(cache_folder: Path) -> None:
    """And not the folder of one that goes on."""
    build.library(SOURCE)
    left = cache_folder / "build-left"
    left.mkdir()
    (left / "kernel.c").write_text(SOURCE)
    with cache.build_folder() as running:
        (running / "kernel.c").write_text(SOURCE)
        build.library(SOURCE + "/* another */\n")
        assert running.exists() and not left.exists()
    assert not list(cache_folder.glob("build-*"))
