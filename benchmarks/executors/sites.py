"""Where a Dask cluster comes from: a scheduler that is there already, or jobs of a batch system."""

from __future__ import annotations

import contextlib
import logging
import pathlib
import re
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from benchmarks.registry import explain
from bgn.errors import BgnError

if TYPE_CHECKING:
    import distributed
    from dask_jobqueue.core import JobQueueCluster

LOCAL = "local"
"""Name of the executor that needs no cluster."""

BATCH_SYSTEMS = {"slurm": "SLURMCluster", "pbs": "PBSCluster", "lsf": "LSFCluster"}
"""Names of batch systems and their classes in dask-jobqueue."""

_SECONDS_TO_CONNECT = 10
_ADDRESS = re.compile(r"dask://(?P<address>[^/\s]+:\d+)")


class ClusterError(BgnError, RuntimeError):
    """There is no cluster as it was asked for; the message says what is missing."""


class SchedulerLostError(BgnError, RuntimeError):
    """The cluster's scheduler went away in the middle of the work."""


class Jobs(BaseModel):
    """What is asked of a batch system, from a TOML file."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    jobs: int = Field(ge=1)
    """How many jobs to submit."""
    cells_per_job: int = Field(ge=1)
    """Cells side by side in a job, each on one core."""
    memory: str
    """Memory of a job, such as ``8 GB``."""
    walltime: str
    """Longest time of a job, as the batch system writes it."""
    queue: str | None = None
    """Queue or partition."""
    account: str | None = None
    """Account or project that pays."""
    interface: str | None = None
    """Network interface that connects this machine with the workers, such as ``ib0``."""
    python: str = sys.executable
    """Python on the workers, with this project and its extra ``cluster`` installed."""
    prologue: list[str] = []
    """Lines of shell to run first in a job."""
    directives: list[str] = []
    """More options for the head of the job script, as the batch system writes them."""
    scratch: str | None = None
    """Fast folder of the worker's own."""
    logs: str | None = None
    """Folder for what jobs print."""


@dataclass(frozen=True)
class Site:
    """A connected cluster."""

    client: distributed.Client
    address: str
    expected: int = 0
    """Cells side by side once all jobs run; 0 if the workers are somebody else's."""
    cluster: JobQueueCluster | None = None
    jobs: int = 0

    def workers(self, wanted: int) -> int:
        """Return how many tasks can run side by side, and replace jobs that ended, if so many are wanted.

        Raises
        ------
        ClusterError
            No job runs, and none can be submitted.
        """
        try:
            running = int(sum(self.client.nthreads().values()))
        except OSError:  # the scheduler is gone, which the futures tell as well
            return 0
        if self.cluster is not None and running < min(self.expected, wanted):
            try:
                _submit(self.cluster, self.jobs)
            except ClusterError:
                if not running:
                    raise
        return max(running, self.expected)


def check_name(executor: str) -> None:
    """Refuse what names no executor.

    Raises
    ------
    ClusterError
        The message lists what there is.
    """
    if executor not in (LOCAL, *BATCH_SYSTEMS) and not _ADDRESS.fullmatch(executor):
        known = ", ".join([LOCAL, "dask://HOST:PORT", *BATCH_SYSTEMS])
        raise ClusterError(f"--executor {executor}: not one of {known}")


@contextlib.contextmanager
def connect(executor: str, settings: pathlib.Path) -> Iterator[Site]:
    """Connect to a running scheduler, or start one here whose workers are jobs of a batch system.

    Raises
    ------
    ClusterError
        No such executor, nobody answers, jobs cannot be submitted, the settings are wrong, or Dask is not installed.
    """
    check_name(executor)
    # What it has to say of a lost connection is said in a line, without its traceback.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    address = _ADDRESS.fullmatch(executor)
    with _existing(address["address"]) if address else _submitted(executor, load(settings)) as site:
        yield site


def load(path: pathlib.Path) -> Jobs:
    """Read the settings of a batch system.

    Raises
    ------
    ClusterError
        The file is missing, is not TOML, or a key or value is wrong.
    """
    try:
        return Jobs.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise ClusterError(
            f"{path}: cannot read the cluster's settings: {error.strerror}; docs/cluster.md has an example"
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise ClusterError(f"{path}: not valid TOML: {error}") from error
    except ValidationError as error:
        raise ClusterError(f"{path}: {explain(error)}") from error


@contextlib.contextmanager
def _existing(address: str) -> Iterator[Site]:
    distributed = _require("distributed")
    try:
        client = distributed.Client(f"tcp://{address}", timeout=_SECONDS_TO_CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise ClusterError(
            f"no Dask scheduler answers at {address} ({error}); start one there with `dask scheduler`"
        ) from error
    with client:
        yield Site(client, address)


@contextlib.contextmanager
def _submitted(system: str, settings: Jobs) -> Iterator[Site]:
    distributed = _require("distributed")
    with start(system, settings) as cluster, distributed.Client(cluster, set_as_default=False) as client:
        _submit(cluster, settings.jobs)
        expected = settings.jobs * settings.cells_per_job
        yield Site(client, cluster.scheduler_address, expected, cluster, settings.jobs)


def start(system: str, settings: Jobs) -> JobQueueCluster:
    """Start a scheduler in this process; jobs that are its workers can then be submitted."""
    cluster_class = getattr(_require("dask_jobqueue"), BATCH_SYSTEMS[system])
    options: dict[str, Any] = {
        "cores": settings.cells_per_job,
        "processes": 1,
        "memory": settings.memory,
        "walltime": settings.walltime,
        "queue": settings.queue,
        "interface": settings.interface,
        "python": settings.python,
        "job_script_prologue": settings.prologue,
        "job_extra_directives": settings.directives,
        "local_directory": settings.scratch,
        "log_directory": settings.logs,
        "job_name": "bgn",
        "scheduler_options": {"dashboard_address": ":0"},
        ("project" if system == "lsf" else "account"): settings.account,
    }
    cluster: JobQueueCluster = cluster_class(**options)
    return cluster


def _submit(cluster: JobQueueCluster, jobs: int) -> None:
    """Submit jobs until there are so many, running or waiting."""
    # As `cluster.scale` does, which submits in the background and keeps errors to itself.
    while len(cluster.worker_spec) < jobs:
        cluster.worker_spec.update(cluster.new_worker_spec())
    try:
        cluster.sync(cluster._correct_state)
    except (OSError, RuntimeError) as error:
        for name, job in list(cluster.workers.items()):
            if job.job_id is None:
                job.status = _require("distributed").Status.failed
                del cluster.workers[name]
        reason = str(error).rpartition("stderr:\n")[2].strip().replace("\n", "; ")
        raise ClusterError(f"cannot submit jobs to the batch system: {reason}") from error


def _require(module: str) -> Any:
    """Import what only clusters need."""
    try:
        return __import__(module)
    except ImportError as error:
        raise ClusterError(
            f"{error.name} is not installed; install the extra: pip install -e .[cluster]"
        ) from error
