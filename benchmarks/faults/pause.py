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
#: Seconds between two checks for a signal that another thread has received.
_INTERVAL = 0.05

_received: list[int] = []


def pause(snes: Any) -> None:
    """Wait on rank 0 for `RESUME`; the other ranks wait for rank 0 in their next collective."""
    if snes.comm.rank == 0:
        while not _received and signal.sigtimedwait([RESUME], _INTERVAL) is None:
            pass


if __name__ == "__main__":
    # A thread of MPI, which has no mask, may receive the signal before this thread waits for it.
    signal.signal(RESUME, lambda number, frame: _received.append(number))
    signal.pthread_sigmask(signal.SIG_BLOCK, [RESUME])
    run_with_intervention(pause)
