"""Write the parts of the reference pages that are made from the program.

    python docs/reference/make.py

A part stands between two comments, ``<!-- generated NAME -->`` and ``<!-- end of NAME -->``, with a
NAME of `WRITERS`; `FILES` are tables beside the pages. With ``--check`` nothing is written: the
exit code is 1 if a page is out of date.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "_ext"))

from generated import builtin, fields, petsc, scene  # noqa: E402  # of docs/_ext

WRITERS: dict[str, Callable[[], str]] = {
    "fields": fields.markdown,
    "materials": builtin.materials,
    "petsc-options": petsc.markdown,
    "scene": scene.markdown,
    "scenes": builtin.scenes,
}
FILES = {"materials/keys.csv": builtin.material_keys}
_PART = re.compile(r"(<!-- generated ([\w-]+) -->\n)(.*?)(<!-- end of \2 -->\n)", re.DOTALL)


def filled(page: str) -> str:
    """Return a page with its parts as the program has them now."""
    return _PART.sub(lambda m: f"{m[1]}\n{WRITERS[m[2]]().strip()}\n\n{m[4]}", page)


def main() -> int:
    """Write the pages, or check them; return the exit code."""
    pages = {path: path.read_text(encoding="utf-8") for path in sorted(HERE.glob("*.md"))}
    old = {path: new for path, text in pages.items() if (new := filled(text)) != text}
    for name, write in FILES.items():
        path, text = HERE / name, write()
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            old[path] = text
    for path, text in old.items():
        print(path.name)
        if "--check" not in sys.argv:
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
    return int("--check" in sys.argv and bool(old))


if __name__ == "__main__":
    sys.exit(main())
