"""The program in processes of its own."""

from __future__ import annotations

import subprocess

from fem_snh.studies.processes import environment, program


def start_program(*words: str, ranks: int = 1) -> subprocess.CompletedProcess[str]:
    """Run the command line in processes of its own, as a user starts it."""
    return subprocess.run(
        [*program(ranks), *words],
        env=environment(),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=120,
    )
