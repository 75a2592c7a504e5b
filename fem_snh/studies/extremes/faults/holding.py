"""``python -m`` this is fem-snh that waits in the middle of a step until it gets `GO`.

Whoever wants to do something to a run in that step then has the time for it, however fast it is.
"""

from __future__ import annotations

import signal
from typing import Any

from fem_snh.studies.extremes.faults import disturbed

#: To the first rank: go on.
GO = signal.SIGUSR1


def hold(snes: Any) -> None:
    """The first rank sleeps, unless it has got `GO` already; the others wait for it."""
    if snes.comm.rank == 0:
        signal.sigwaitinfo([GO])


if __name__ == "__main__":
    signal.pthread_sigmask(signal.SIG_BLOCK, [GO])  # before there are threads, which inherit it
    disturbed.run(hold)
