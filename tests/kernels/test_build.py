"""The cache of compiled kernels: its key, concurrent use, error messages."""

from __future__ import annotations

import os
import re
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from fem_snh import cache
from fem_snh.errors import BadInput
from fem_snh.kernels import build

SOURCE = "int answer(void) { return 42; }\n"
NOBODY = 65534  # Debian's user id of nobody


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


def test_functions_linked_with_several_libraries_are_compiled_once(cache_folder):
    answer = "int answer(void);\n"
    double = f"{answer}int double_answer(void) {{ return 2 * answer(); }}\n"
    half = f"{answer}int half_answer(void) {{ return answer() / 2; }}\n"
    paths = [
        build.library(double, [build.object_file(SOURCE)]),
        build.library(half, [build.object_file(SOURCE)]),
        build.library(half, [build.object_file(f"{SOURCE}\n")]),
    ]
    assert len({*paths}) == 3 and len([*cache_folder.glob("*.o")]) == 2
    assert build.load(paths[0], "int double_answer(void);")[1].double_answer() == 84
    assert build.load(paths[1], "int half_answer(void);")[1].half_answer() == 21


def test_object_files_are_linked_with_each_other(cache_folder, monkeypatch):
    double = "int answer(void);\nint double_answer(void) { return 2 * answer(); }\n"
    objects = [build.object_file(SOURCE), build.object_file(double)]
    path = build.linked(objects)
    assert build.load(path, "int double_answer(void);")[1].double_answer() == 84
    assert build.linked([build.object_file(SOURCE + "\n"), objects[1]]) != path
    monkeypatch.setattr(build.subprocess, "run", None)  # the compiler is not called again
    assert build.linked(objects) == path


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


def test_no_flag_breaks_nan_and_infinity():
    assert not {"-ffast-math", "-Ofast", "-ffinite-math-only", "-funsafe-math-optimizations"} & set(
        build.FLAGS
    )
    source = "double same(double x) { return x != x; }\n"
    _, lib = build.load(build.library(source), "double same(double x);")
    assert lib.same(float("nan")) == 1


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


def test_a_missing_compiler_is_bad_input(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert "install gcc" in one_line(build.library, SOURCE)
    monkeypatch.setenv("CC", "no-such-cc")
    assert "no-such-cc" in one_line(build.library, SOURCE)


def test_a_command_that_is_no_compiler_is_bad_input(monkeypatch, tmp_path):
    monkeypatch.setenv("CC", str(script(tmp_path / "broken", "exit 1")))
    assert re.search(r"^CC = .*broken: expected a C compiler", one_line(build.library, SOURCE))
    monkeypatch.setenv("CC", str(script(tmp_path / "idle", "exit 0")))
    assert re.search(r"^CC = .*idle: could not compile a kernel", one_line(build.library, SOURCE))


def test_a_compiler_error_is_bad_input_and_names_its_log(cache_folder):
    message = one_line(build.library, "no C at all\n")
    log = Path(message.rpartition(" ")[2])
    assert log.parent == cache_folder
    assert "error" in log.read_text()
    assert [p.suffix for p in cache_folder.iterdir()] == [".log"]


def test_a_cache_that_cannot_be_written_is_bad_input(monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setenv("FEM_SNH_CACHE", str(tmp_path / "file" / "cache"))
    message = one_line(build.library, SOURCE)
    assert str(tmp_path / "file" / "cache") in message
    assert "FEM_SNH_CACHE" in message


@pytest.fixture
def ordinary_user():
    """A user other than root, who may read and write everything."""
    if os.geteuid():
        yield
        return
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


@pytest.mark.parametrize("mode", [0o500, 0o000])
def test_a_cache_without_permission_is_bad_input(monkeypatch, ordinary_user, mode):
    with tempfile.TemporaryDirectory(dir="/tmp") as parent:  # tmp_path is closed to other users
        folder = Path(parent, "cache")
        folder.mkdir(mode=mode)
        monkeypatch.setenv("FEM_SNH_CACHE", str(folder))
        assert str(folder) in one_line(build.library, SOURCE)


def test_a_library_that_cannot_be_opened_is_bad_input():
    path = build.library(SOURCE)
    path.write_bytes(b"cut off")
    assert str(path) in one_line(build.load, path, "int answer(void);")


def test_cache_folder_follows_the_environment(monkeypatch, tmp_path):
    monkeypatch.delenv("FEM_SNH_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.folder() == tmp_path / "fem_snh"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache.folder() == tmp_path / ".cache" / "fem_snh"


@pytest.mark.parametrize("content", ["", "ffi = (", None])
def test_declarations_are_read_from_the_cache_or_parsed_again(cache_folder, content):
    path = build.library(SOURCE)
    declarations = f"int answer(void); /* {content} */"
    build.load(path, declarations)
    (stored,) = cache_folder.glob("*.py")
    if content is not None:
        stored.write_text(content)
    build.load.cache_clear()
    ffi, lib = build.load(path, declarations)
    assert lib.answer() == 42 and ffi.new("int[2]", [1, 2])[1] == 2
    assert "answer" in stored.read_text()
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


def test_another_library_under_the_name_is_compiled_again() -> None:
    path, other = build.library(SOURCE), build.library(f"{SOURCE}\nint other(void) {{ return 1; }}")
    whole = path.read_bytes()
    path.write_bytes(other.read_bytes())
    assert build.library(SOURCE) == path and path.read_bytes() == whole


def test_a_library_with_another_byte_is_compiled_again() -> None:
    path = build.library(SOURCE)
    whole = path.read_bytes()
    path.write_bytes(whole[:500] + bytes([whole[500] ^ 1]) + whole[501:])
    assert build.library(SOURCE) == path and path.read_bytes() == whole


@pytest.mark.parametrize("content", ["1 / 0", "raise SystemExit", "\0", "ffi = 1"])
def test_declarations_that_were_edited_are_not_executed(cache_folder: Path, content: str) -> None:
    path = build.library(SOURCE)
    declarations = f"int answer(void); /* {content!r} */"
    build.load(path, declarations)
    (stored,) = cache_folder.glob("*.py")
    written = stored.read_bytes()
    stored.write_text(content)
    build.load.cache_clear()
    assert build.load(path, declarations)[1].answer() == 42
    assert stored.read_bytes() == written


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


def test_a_library_that_others_can_write_is_compiled_again() -> None:
    path = build.library(SOURCE)
    path.chmod(0o664)
    assert build.stored(path.name) is None
    build.library(SOURCE)
    assert stat.S_IMODE(path.stat().st_mode) == 0o644


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can make a folder of another user")
def test_the_cache_of_another_user_is_refused(cache_folder: Path) -> None:
    build.library(SOURCE)
    os.chown(cache_folder, NOBODY, NOBODY)
    message = one_line(build.library, SOURCE)
    assert "expected a folder of your own" in message and f"belongs to user {NOBODY}" in message


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


def test_a_killed_compilation_leaves_nothing_for_long(
    cache_folder: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    real = build.compiler()
    killer = f'case "$1" in --version) exec {real} "$@";; esac\nkill -9 $PPID'
    monkeypatch.setenv("CC", str(script(tmp_path / "killer", killer)))
    code = f"from fem_snh.kernels import build; build.library({SOURCE!r})"
    assert subprocess.run([sys.executable, "-c", code]).returncode == -9
    assert len(list(cache_folder.glob("build-*"))) == 1
    monkeypatch.delenv("CC")
    build.library(SOURCE)
    assert not list(cache_folder.glob("build-*"))
