"""Slurm on this machine alone: munged, slurmctld and slurmd as processes of the caller, on the loopback device."""

from __future__ import annotations

import getpass
import os
import pathlib
import shutil
import socket
import subprocess
import time
from collections.abc import Callable

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "sinfo")
PATH = os.pathsep.join([os.environ["PATH"], "/usr/sbin"])  # where Debian keeps daemons


class SlurmError(RuntimeError):
    """Slurm cannot run here; the message says why."""


def missing() -> list[str]:
    """Return the programs that are not installed."""
    return [program for program in PROGRAMS if shutil.which(program, path=PATH) is None]


class Slurm:
    """A cluster of one node, all its files in one folder."""

    def __init__(self, folder: pathlib.Path, cores: int) -> None:
        self.folder = folder
        self.daemons: list[subprocess.Popen[bytes]] = []
        folder.chmod(0o755)
        self.environment = {"SLURM_CONF": str(folder / "slurm.conf"), "PATH": PATH}
        (folder / "slurm.conf").write_text(self._configuration(cores), encoding="utf-8")

    def start(self) -> None:
        """Start the daemons; raise :class:`SlurmError` if they do not come up."""
        key = self.folder / "munge.key"
        key.write_bytes(os.urandom(64))
        key.chmod(0o400)
        files = {name: self.folder / f"munge.{name}" for name in ("socket", "pid", "log", "seed")}
        options = [f"--{name}-file={path}" for name, path in files.items() if name != "socket"]
        options += [f"--socket={files['socket']}", f"--key-file={key}"]
        # --force: a folder for tests may lie below one that everybody may write to.
        self._daemon("munged", "--foreground", "--force", *options)
        self._await(files["socket"].exists, "munged")
        self._daemon("slurmctld", "-D")
        self._daemon("slurmd", "-D", "-N", "localhost")
        self._await(lambda: self.command("sinfo", "-h", "-o", "%T") in ("idle", "mixed"), "the node")

    def command(self, *arguments: str) -> str:
        """Return what a command of Slurm prints."""
        environment = os.environ | self.environment
        return subprocess.run(arguments, env=environment, capture_output=True, text=True).stdout.strip()

    def jobs(self) -> list[str]:
        """Return the ids of running jobs."""
        return self.command("squeue", "-h", "-t", "R", "-o", "%A").split()

    def stop(self) -> None:
        """End everything."""
        for daemon in reversed(self.daemons):
            daemon.terminate()
            daemon.wait(30)

    def _daemon(self, program: str, *arguments: str) -> None:
        environment = os.environ | self.environment
        with (self.folder / f"{program}.out").open("wb") as log:
            self.daemons.append(
                subprocess.Popen([program, *arguments], env=environment, stdout=log, stderr=log)
            )

    def _await(self, happened: Callable[[], bool], what: str) -> None:
        deadline = time.monotonic() + 60
        while not happened():
            dead = [daemon for daemon in self.daemons if daemon.poll() is not None]
            if dead or time.monotonic() > deadline:
                logs = "\n".join(path.read_text()[-1000:] for path in sorted(self.folder.glob("*.out")))
                raise SlurmError(f"{what} did not come up: {logs}")
            time.sleep(0.2)

    def _configuration(self, cores: int) -> str:
        user, controller, node = getpass.getuser(), _free_port(), _free_port()
        return f"""
ClusterName=bgn
SlurmctldHost=localhost(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
CommunicationParameters=NoCtldInAddrAny,NoInAddrAny
SlurmctldPort={controller}
SlurmdPort={node}
AuthType=auth/munge
AuthInfo=socket={self.folder}/munge.socket
CredType=cred/munge
StateSaveLocation={self.folder}/state
SlurmdSpoolDir={self.folder}/spool
SlurmctldPidFile={self.folder}/slurmctld.pid
SlurmdPidFile={self.folder}/slurmd.pid
SlurmctldLogFile={self.folder}/slurmctld.log
SlurmdLogFile={self.folder}/slurmd.log
ProctrackType=proctrack/pgid
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
SchedulerType=sched/backfill
SlurmdParameters=config_overrides
ReturnToService=2
KillWait=2
NodeName=localhost NodeAddr=127.0.0.1 CPUs={cores} RealMemory=100000 State=UNKNOWN
PartitionName=main Nodes=localhost Default=YES MaxTime=INFINITE State=UP
"""


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
