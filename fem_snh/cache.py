"""The user's cache folder for records, objects and C declarations, and the time of compilation.

A record's key is a hash of everything that its content depends on, including source files of the
package, so that no record is ever out of date. Records may be deleted at any time.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import pickle
import shutil
import stat
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import lru_cache, wraps
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, TypeVar

import platformdirs

from fem_snh.errors import BadInput

#: Hexadecimal digits of the hash in a file name: 96 bits, so that two keys never share a name.
KEY_DIGITS = 24
#: Prefix of the names of `build_folder`.
_BUILD = "build-"
#: The system administrator's user id.
_ROOT = 0
#: Bytes of a signature: a line of "# " and 64 hexadecimal digits, after a line break.
_SIGNATURE = 68
#: The mode bits by which others may write.
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def folder() -> Path:
    """Return ``$FEM_SNH_CACHE``, or ``fem_snh`` in the user's cache folder (XDG_CACHE_HOME)."""
    if own := os.environ.get("FEM_SNH_CACHE"):
        return Path(own)
    return Path(platformdirs.user_cache_path("fem_snh", appauthor=False))


def key(*content: Any) -> str:
    """Return a hash of numbers, texts, and sequences and mappings of them: 24 hexadecimal digits.

    Raises
    ------
    TypeError
        If the content has no representation in JSON.
    """
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:KEY_DIGITS]


@lru_cache
def sources(*folders: str) -> str:
    """Return a hash of the .py and .h files in folders of this package, e.g. "materials"."""
    found = hashlib.sha256()
    for path in _files(folders):
        found.update(path.name.encode() + b"\0" + path.read_bytes())
    return found.hexdigest()


def _files(folders: Iterable[str]) -> list[Path]:
    root = Path(__file__).parent
    return sorted(
        path
        for folder in folders
        for path in (root / folder).rglob("*")
        if path.suffix in (".py", ".h")
    )


def own_folder() -> Path:
    """Return `folder`, created if missing, after a check that only this user can write into it.

    The program executes files of the folder.

    Raises
    ------
    BadInput
        If the folder is another user's, or others can write into it.
    OSError
        If the folder cannot be created.
    """
    path = folder()
    path.mkdir(mode=0o700, parents=True, exist_ok=True)
    state = path.stat()
    if state.st_uid not in (os.geteuid(), _ROOT):
        raise BadInput(
            f"FEM_SNH_CACHE = {path}: expected a folder of your own, as its files are executed; "
            f"this one belongs to user {state.st_uid}"
        )
    if state.st_mode & _OTHERS_WRITE:
        raise BadInput(
            f"FEM_SNH_CACHE = {path}: expected a folder that only you can write into, as its files "
            f"are executed: chmod go-w {path}"
        )
    return path


def read_signed(path: Path) -> bytes | None:
    """Return a file's content without the signature of `sign`, or None.

    None: the file is missing, incomplete or renamed, or others own it or can write to it.
    """
    try:
        with path.open("rb") as file:
            state, content = os.fstat(file.fileno()), file.read()
    except OSError:
        return None
    if state.st_uid not in (os.geteuid(), _ROOT) or state.st_mode & _OTHERS_WRITE:
        return None
    content, signature = content[:-_SIGNATURE], content[-_SIGNATURE:]
    return content if signature == _signature(path.name, content) else None


def sign(path: Path) -> None:
    """Append a digest of the file's name and content, which `read_signed` checks; set mode 644."""
    with path.open("r+b") as file:
        file.write(_signature(path.name, file.read()))
    path.chmod(0o644)


def _signature(name: str, content: bytes) -> bytes:
    """Return the digest as a last line that Python and the loader of shared libraries ignore."""
    digest = hashlib.sha256(name.encode() + b"\0" + content).hexdigest()
    return f"\n# {digest}\n".encode()


@contextmanager
def build_folder() -> Iterator[Path]:
    """Provide a temporary folder in `own_folder`, to which complete files are then moved.

    Temporary folders of killed processes are removed. Raises as `own_folder`.
    """
    parent = own_folder()
    for path in parent.glob(f"{_BUILD}*"):
        with suppress(OSError), _locked(path):
            if any(path.iterdir()):  # an empty one may be about to be locked
                shutil.rmtree(path, ignore_errors=True)
    with tempfile.TemporaryDirectory(dir=parent, prefix=_BUILD) as name, ExitStack() as lock:
        with suppress(OSError):  # a file system without locks: it is not removed there
            lock.enter_context(_locked(Path(name)))
        yield Path(name)


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Lock a folder. Raises OSError if another process has locked it."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def read(key: str) -> dict[str, Any] | None:
    """Return the record of a key; None if it is missing or cannot be read."""
    try:
        record = json.loads((folder() / f"{key}.json").read_text())
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) else None


def write(key: str, record: dict[str, Any]) -> None:
    """Store the record of a key, so that other processes see all of it or nothing.

    A folder that cannot be written is no error: the next run computes the record again.
    """
    with suppress(OSError), build_folder() as scratch:
        written = scratch / f"{key}.json"
        written.write_text(json.dumps(record))
        os.replace(written, folder() / written.name)


def read_object(name: str) -> Any:
    """Return the object of `write_object`; None if its file is missing or damaged.

    Raises BadInput for another user's cache.
    """
    content = _stored(folder() / name)
    return None if content is None else pickle.loads(content)


def write_object(name: str, value: Any, most: int) -> None:
    """Store an object in the file ``name``, and remove old files of the same suffix.

    The ``most`` latest files remain. A folder that cannot be written is no error, as in `write`.
    """
    target = folder() / name
    with suppress(OSError):
        _replace_signed(target, lambda written: written.write_bytes(pickle.dumps(value)))
        files = sorted(folder().glob(f"*{target.suffix}"), key=lambda path: path.stat().st_mtime)
        for path in files[:-most]:
            path.unlink()


def _replace_signed(target: Path, write: Callable[[Path], object]) -> None:
    """Write a file at a temporary path, `sign` it and move it to ``target``. Raises OSError."""
    with build_folder() as made:
        written = made / target.name
        write(written)
        sign(written)
        os.replace(written, target)


def c_declarations(declarations: str) -> Any:
    """Return an FFI object that knows C declarations. Not collective.

    cffi parses C in Python, which takes longer than opening a library and all of its calls in a
    small run. So the declarations are parsed once, and the module that cffi writes is cached.

    Parameters
    ----------
    declarations : str
        C declarations of structs and functions.

    Returns
    -------
    cffi.FFI or _cffi_backend.FFI
        The first if the declarations were parsed, the second from the cache. Both have ``new``,
        ``cast``, ``buffer``, ``from_buffer``, ``NULL`` and ``dlopen``.
    """
    import cffi  # the cache of materials needs none

    name = key("declarations", declarations, cffi.__version__)
    target = folder() / f"{name}.py"
    if (source := _stored(target)) is not None:
        return _ffi(source)
    from cffi.recompiler import make_py_source  # "ABI mode, out of line"; slow to import

    ffi = cffi.FFI()
    ffi.cdef(declarations)
    # A folder that cannot be written: the next run parses them again.
    with suppress(OSError):
        module = f"declarations_{name}"
        _replace_signed(target, lambda written: make_py_source(ffi, module, str(written)))
    return ffi


def _stored(path: Path) -> bytes | None:
    """Return the content of a signed file, or None. Raises BadInput for another user's cache."""
    if not os.path.exists(path):  # also where the folder cannot be searched
        return None
    own_folder()
    return read_signed(path)


def _ffi(source: bytes) -> Any:
    """Return the FFI object of a module that cffi has written."""
    names: dict[str, Any] = {}
    exec(source, names)
    return names["ffi"]


T = TypeVar("T")


class _Clock:
    seconds, processor, is_running = 0.0, 0.0, False


_CLOCK = _Clock()


@contextmanager
def compiling() -> Iterator[None]:
    """Add the time of the context to the time of compilation; nested contexts count once."""
    if _CLOCK.is_running:
        yield
        return
    start, working, _CLOCK.is_running = perf_counter(), process_time(), True
    try:
        yield
    finally:
        _CLOCK.seconds += perf_counter() - start
        _CLOCK.processor += process_time() - working
        _CLOCK.is_running = False


class Stopwatch:
    """The time since its creation, without the time of compilation in this process."""

    def __init__(self) -> None:
        self._compiled = _CLOCK.seconds, _CLOCK.processor
        self._start = perf_counter(), process_time()

    @property
    def seconds(self) -> float:
        """Return the elapsed seconds, without compilation."""
        return perf_counter() - self._start[0] - self.jit

    @property
    def processor(self) -> float:
        """Return the processor seconds of this process, without compilation."""
        return process_time() - self._start[1] - (_CLOCK.processor - self._compiled[1])

    @property
    def jit(self) -> float:
        """Return the elapsed seconds of compilation since the stopwatch's creation."""
        return _CLOCK.seconds - self._compiled[0]


def timed(method: Callable[..., T]) -> Callable[..., T]:
    """Make a method add its time, without compilation, to its object's ``seconds["assemble"]``."""

    @wraps(method)
    def with_time(self: Any, *arguments: Any, **keywords: Any) -> T:
        watch = Stopwatch()
        try:
            return method(self, *arguments, **keywords)
        finally:
            self.seconds["assemble"] += watch.seconds

    return with_time


@contextmanager
def untimed(problem: Any) -> Iterator[None]:
    """Leave evaluations in the context, as of output, out of ``problem.seconds["assemble"]``."""
    seconds = problem.seconds["assemble"]
    try:
        yield
    finally:
        problem.seconds["assemble"] = seconds
