"""The program in processes of its own."""

from __future__ import annotations

import subprocess
from typing import Any

from fem_snh.studies.tasks import environment, program


def start_program(*words: str, ranks: int = 1) -> subprocess.CompletedProcess[str]:
    """Run the command line in processes of its own, as a user starts it."""
    options: Any = {"stdin": subprocess.DEVNULL, "capture_output": True, "text": True}
    command = [*program(ranks), *words]
    return subprocess.run(command, env=environment(), timeout=120, **options)
