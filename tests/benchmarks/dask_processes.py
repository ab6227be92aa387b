"""A real Dask cluster on the loopback device: a scheduler and workers, each a process to be killed at will."""

from __future__ import annotations

import contextlib
import json
import os
import pathlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

from tests.waiting import await_

ROOT = pathlib.Path(__file__).parents[2]
_QUIET = ("--host", "127.0.0.1", "--no-dashboard")


class Cluster:
    """A scheduler and workers of one thread."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.folder = folder
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: list[subprocess.Popen[bytes]] = []
        self.address = ""

    @property
    def executor(self) -> str:
        """What ``--executor`` calls it."""
        return f"dask://{self.address}"

    def complete(self, workers: int) -> None:
        """Start whatever is missing."""
        file = self.folder / "scheduler.json"
        if self.scheduler is None or self.scheduler.poll() is not None:
            file.unlink(missing_ok=True)
            self.scheduler = self._start("dask_scheduler", "--port", "0", "--scheduler-file", str(file))
            await_(file.exists, "a scheduler")
            self.address = json.loads(file.read_text())["address"].removeprefix("tcp://")
            for worker in self.workers:  # those of an earlier scheduler, some of which still look for it
                worker.kill()
                worker.wait()
        self.workers = [worker for worker in self.workers if worker.poll() is None]
        while len(self.workers) < workers:
            arguments = (f"tcp://{self.address}", "--no-nanny", "--nthreads", "1")
            self.workers.append(self._start("dask_worker", *arguments, "--death-timeout", "30"))

    def worker_of(self, child: int) -> subprocess.Popen[bytes]:
        """Return the worker that started a process."""
        parent = int(pathlib.Path(f"/proc/{child}/stat").read_text().rpartition(")")[2].split()[1])
        return next(worker for worker in self.workers if worker.pid == parent)

    def stop(self) -> None:
        """End all processes."""
        for process in (*self.workers, self.scheduler):
            if process is not None:
                process.kill()
                process.wait()

    def _start(self, program: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{program}", *_QUIET, *arguments]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
        with (self.folder / f"{program}.log").open("ab") as log:
            return subprocess.Popen(command, cwd=self.folder, env=environment, stdout=log, stderr=log)


def checkpointed(results: pathlib.Path) -> list[int]:
    """Return the processes that left checkpoints: the hanging fake writes its id into them."""
    texts = [path.read_text() for path in results.rglob("*.checkpoint")]
    return [int(text) for text in texts if text]


def alive(pid: int) -> bool:
    """Say whether a process runs (a dead one whose parent has not looked yet does not)."""
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@contextlib.contextmanager
def acting(act: Callable[[], object], when: Callable[[], object]) -> Iterator[None]:
    """Act from another thread as soon as something happened, while the caller goes on."""
    with ThreadPoolExecutor(1) as pool:

        def wait_and_act() -> None:
            await_(when, "the moment to act")
            act()

        acted = pool.submit(wait_and_act)
        yield
        acted.result()
