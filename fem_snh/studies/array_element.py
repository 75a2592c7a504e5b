"""An element of an array of jobs: ``python -m fem_snh.studies.array_element FILE.json INDEX``.

It runs the tasks of that element one after another, as the study would do on its own machine, and
writes into the folder of each how it ended. A task that has ended is not run again when the
scheduler starts the element a second time.
"""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

from fem_snh.studies.folder import clear_point
from fem_snh.studies.jobs import read_element
from fem_snh.studies.tasks import End, Task, TaskRunner, read_end

#: Seconds between two polls of the running task.
_POLL_INTERVAL = 0.02


def main(file: str, index: str) -> int:
    """Run the tasks; return 0."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # its children are ended as well
    out = Path(file).parents[1]
    tasks = read_element(Path(file), int(index))
    runner = TaskRunner()
    try:
        for number, task in enumerate(tasks):
            if read_end(out / task.name) is None:
                end = _run(task, out, runner, number + 1 < len(tasks))
                end.write(out / task.name)
                print(f"{task.name}: exit code {end.code}, {end.seconds:.1f} s {end.limit}")
    finally:
        runner.close()
    return 0


def _run(task: Task, out: Path, runner: TaskRunner, more: bool) -> End:
    """Run one task and return its end."""
    folder = clear_point(out, task.name)  # what an attempt that was interrupted has left
    child = runner.start(task, folder)
    try:
        while child.poll() is None:
            time.sleep(_POLL_INTERVAL)
    except BaseException:
        child.end()
        raise
    runner.keep_or_close(child, more)
    return End(child.poll() or 0, child.seconds, child.limit_reached)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
