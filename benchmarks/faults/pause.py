"""fem-snh that pauses in the middle of a step until rank 0 receives the signal `RESUME`.

``python -m benchmarks.faults.pause`` takes the arguments of ``fem-snh``. A test can then act on a
run inside that step, however fast the run is.
"""

from __future__ import annotations

import signal
from typing import Any

from benchmarks.faults.intervention import run_with_intervention

#: The signal that makes rank 0 continue.
RESUME = signal.SIGUSR1


def pause(snes: Any) -> None:
    """Wait on rank 0 for `RESUME`; the other ranks wait for rank 0 in their next collective."""
    if snes.comm.rank == 0:
        signal.sigwaitinfo([RESUME])


if __name__ == "__main__":
    signal.pthread_sigmask(signal.SIG_BLOCK, [RESUME])  # before any thread: threads inherit it
    run_with_intervention(pause)
