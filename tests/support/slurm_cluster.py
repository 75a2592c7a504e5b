"""A real Slurm on this machine, with its own munge, and points whose runs are counted."""

from __future__ import annotations

import os
import secrets
import shutil
import socket
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

#: The programs that the tests start; Debian's packages are slurmctld, slurmd, slurm-client, munge.
PROGRAMS = ("slurmctld", "slurmd", "sbatch", "squeue", "scontrol", "scancel", "munged")
#: Processors that the node claims to have.
PROCESSORS = 8
#: Seconds after which a condition that does not hold is a failure.
_PATIENCE = 240.0

CONFIGURATION = """\
ClusterName=test
SlurmctldHost={host}(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
SlurmctldPort={port}
SlurmdPort={slurmd_port}
AuthType=auth/munge
AuthInfo=socket={folder}/munge.sock,cred_expire=3
CredType=cred/munge
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
SlurmctldLogFile={folder}/slurmctld.log
SlurmdLogFile={folder}/slurmd.log
SlurmdParameters=config_overrides
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
MpiDefault=none
ReturnToService=2
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU
SchedulerParameters=sched_interval=1,batch_sched_delay=0,sched_min_interval=0,bf_interval=1
KillWait=2
MinJobAge=2
MaxArraySize=20
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
NodeName={host} NodeAddr=127.0.0.1 CPUs={processors} RealMemory=16000 State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=60 State=UP
"""


def missing() -> str:
    """Return why there can be no Slurm here, or ""."""
    os.environ["PATH"] += os.pathsep + "/usr/sbin"
    programs = [program for program in PROGRAMS if not shutil.which(program)]
    if programs:
        return f"Slurm is not installed: no {', '.join(programs)}"
    return "" if os.geteuid() == 0 else "slurmd starts jobs as root only"


def _free_ports(number: int) -> list[int]:
    sockets = [socket.create_server(("127.0.0.1", 0)) for _ in range(number)]
    ports = [one.getsockname()[1] for one in sockets]
    for one in sockets:
        one.close()
    return ports


class Cluster:
    """slurmctld, slurmd and munged in a folder; a context."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        for name in ("state", "spool"):
            (folder / name).mkdir()
        key = folder / "munge.key"
        key.write_bytes(secrets.token_bytes(1024))
        key.chmod(0o400)
        port, slurmd_port = _free_ports(2)
        self.host = socket.gethostname().partition(".")[0]
        text = CONFIGURATION.format(
            host=self.host, user="root", port=port, slurmd_port=slurmd_port, folder=folder,
            processors=PROCESSORS,
        )  # fmt: skip
        (folder / "slurm.conf").write_text(text)
        self.variables = {"SLURM_CONF": str(folder / "slurm.conf")}

    def __enter__(self) -> Cluster:
        options = {
            "key-file": "munge.key", "socket": "munge.sock", "pid-file": "munged.pid",
            "log-file": "munged.log", "seed-file": "munge.seed",
        }  # fmt: skip
        words = [f"--{key}={self.folder / file}" for key, file in options.items()]
        self._start("munged", "--foreground", "--force", *words)
        wait_for((self.folder / "munge.sock").exists)
        self.start_controller()
        self._start("slurmd", "-D")
        wait_for(lambda: "idle" in self.run("sinfo", "--noheader", "--format=%T"))
        return self

    def __exit__(self, *_: object) -> None:
        self.run("scancel", "--user=root")
        for process in reversed(self.processes.values()):
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _start(self, program: str, *options: str) -> None:
        with (self.folder / f"{program}.out").open("ab") as out:
            self.processes[program] = subprocess.Popen(
                [program, *options], env=os.environ | self.variables, stdout=out, stderr=out,
                stdin=subprocess.DEVNULL, start_new_session=True,
            )  # fmt: skip

    def start_controller(self) -> None:
        self._start("slurmctld", "-D")
        wait_for(lambda: "UP" in self.run("scontrol", "ping"))

    def kill_controller(self) -> None:
        """End slurmctld without a chance to save its state."""
        process = self.processes.pop("slurmctld")
        process.kill()
        process.wait()

    def resume(self) -> None:
        """Put the node into service again, which a controller may find down when it starts.

        Slurm waits for two minutes before it starts an element again; here it does not.
        """
        if "idle" not in self.run("sinfo", "--noheader", "--format=%T"):
            self.run("scontrol", "update", f"nodename={self.host}", "state=resume")
        words = "--noheader", "--array", "--states=PENDING", "--format=%i %r"
        for line in self.run("squeue", *words).splitlines():
            if line.endswith("BeginTime"):
                self.run("scontrol", "update", f"jobid={line.split()[0]}", "StartTime=now")

    def run(self, *command: str) -> str:
        """Return what a command of Slurm prints."""
        done = subprocess.run(
            command, env=os.environ | self.variables, capture_output=True, text=True
        )
        return done.stdout

    def running(self) -> list[str]:
        """Return the numbers of the elements that run."""
        words = "--noheader", "--array", "--states=RUNNING", "--format=%A %i"
        return [line.split()[1] for line in self.run("squeue", *words).splitlines()]


def wait_for(condition: Callable[[], Any], interval: float = 0.05) -> None:
    """Wait until a condition holds, which is evaluated at an interval [s]."""
    deadline = time.monotonic() + _PATIENCE
    while not condition():
        assert time.monotonic() < deadline, condition
        time.sleep(interval)


#: A scene that in a job appends its number to a file, waits and ends with the square of the number.
COUNTED = """
import os
import time
from pathlib import Path

from fem_snh import scenes

def counted(number: int = 0):
    if "SLURM_JOB_ID" not in os.environ:
        return scenes.load("twist")
    with open({runs!r}, "a") as file:
        file.write(f"p{{number}}\\n")
    time.sleep(0.5)
    while Path({hold!r}).exists():
        time.sleep(0.05)
    raise ValueError(f"its square is {{number**2}}")
"""


def counted_scene(folder: Path, runs: Path, hold: Path) -> str:
    """Return a scene whose runs are counted in a file; they fail, without a solve.

    They do not end while the file ``hold`` exists.
    """
    file = folder / "counted.py"
    file.write_text(COUNTED.format(runs=str(runs), hold=str(hold)))
    return f"{file}:counted"
