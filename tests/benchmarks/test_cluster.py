"""Tasks on a real scheduler and two workers over TCP, which are killed where it matters."""

from __future__ import annotations

import contextlib
import os
import pathlib
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from types import SimpleNamespace

import pandas as pd
import pytest

pytest.importorskip("distributed", reason="clusters need Dask: the extra `cluster`")

import distributed
from distributed.scheduler import KilledWorker

from benchmarks import registry
from benchmarks.__main__ import main
from benchmarks.events import Advanced, Event, Finished, Idle, Restarted, Started
from benchmarks.executors import cluster as executor
from benchmarks.executors import sites
from benchmarks.executors.packing import split
from benchmarks.executors.remote import Outcome
from benchmarks.executors.sites import Site
from benchmarks.plan import Selection
from benchmarks.tasks import CellTask, Task, Work
from bgn.results.store import Store
from bgn.training.trainer import train_cell
from tests.benchmarks import fakes
from tests.benchmarks.dask_processes import Cluster, acting, alive, checkpointed
from tests.waiting import await_

PRESET = registry.load().defaults.preset
MEASURED = ["seconds"]


@pytest.fixture(scope="module")
def processes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    cluster = Cluster(tmp_path_factory.mktemp("dask"))
    yield cluster
    cluster.stop()


@pytest.fixture
def cluster(processes: Cluster) -> Cluster:
    processes.complete(workers=2)
    return processes


@pytest.fixture
def site(cluster: Cluster) -> Iterator[Site]:
    with sites.connect(cluster.executor, pathlib.Path("unused.toml")) as site:
        site.client.wait_for_workers(2, timeout=60)
        yield site


def tasks(results: pathlib.Path, agents: Sequence[str], seeds: Sequence[int] = (0, 1)) -> list[Task]:
    domain = ("top-plate",)
    selection = Selection(registry.load(), "smoke", "authors-code", domain, tuple(agents), (), tuple(seeds))
    return selection.tasks(selection.requests(), Store(results), "cpu")


def do(todo: Sequence[Task], site: Site, work: Work) -> list[Event]:
    with contextlib.closing(executor.run_tasks(todo, site=site, work=work)) as events:
        return list(events)


def test_every_task_starts_advances_and_finishes(tmp_path: pathlib.Path, site: Site) -> None:
    todo = tasks(tmp_path, ("ah-ch", "ah-cb", "ab-cb+bgn"))
    events = do(todo, site, fakes.BREAKING)
    for task in todo:
        own = [type(event) for event in events if event.task is task]
        assert (own[0], own[-1], set(own[1:-1])) == (Started, Finished, {Advanced})
    runs = Store(tmp_path).read("runs")
    assert len(runs) == 6
    assert set(runs["status"]) == {"ok"}
    assert not list(tmp_path.rglob(".*.partial")), (
        "the token that shows who shares the folder was left behind"
    )


def test_errors_are_rows_not_repeated_and_the_rest_goes_on(tmp_path: pathlib.Path, site: Site) -> None:
    todo = tasks(tmp_path, (fakes.DYING_AGENT, fakes.FAILING_AGENT, "ah-ch"))
    events = do(todo, site, fakes.BREAKING)
    assert not [event for event in events if isinstance(event, Restarted)]
    failures = {event.task.name: event.failure for event in events if isinstance(event, Finished)}
    assert len(failures) == 3
    assert failures["top-plate/ah-ch"] is None
    assert "the loss is NaN" in failures[f"top-plate/{fakes.FAILING_AGENT}"].error
    assert "SIGKILL" in failures[f"top-plate/{fakes.DYING_AGENT}"].error
    assert sorted(Store(tmp_path).read("runs")["status"]) == ["failed"] * 4 + ["ok"] * 2
    assert len(site.client.nthreads()) == 2, "a run that is killed does not take its worker along"


def test_without_a_shared_folder_shards_come_through_the_scheduler(
    tmp_path: pathlib.Path, site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executor, "token_path", lambda store, token: tmp_path / "elsewhere" / token)
    todo = tasks(tmp_path / "ours", ("ah-ch", fakes.FAILING_AGENT))
    events = do(todo, site, fakes.BREAKING)
    assert sum(isinstance(event, Finished) and event.failure is None for event in events) == 1
    store = Store(tmp_path / "ours")
    runs = store.read("runs").set_index("run")["status"]
    assert runs["top-plate/ah-ch/seed-1"] == "ok"
    assert runs[f"top-plate/{fakes.FAILING_AGENT}/seed-1"] == "failed"
    assert b"ah-ch" in store.policy("top-plate/ah-ch/seed-0").read_bytes()
    assert set(store.read("curves")["run"]) == {"top-plate/ah-ch/seed-0", "top-plate/ah-ch/seed-1"}


def test_workers_with_other_sources_compute_nothing(
    tmp_path: pathlib.Path, site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(executor, "sources", lambda: "edited since")
    (finished,) = (
        e for e in do(tasks(tmp_path, ("ah-ch",)), site, fakes.BREAKING) if isinstance(e, Finished)
    )
    assert "another version of bgn" in finished.failure.error
    assert set(Store(tmp_path).read("runs")["status"]) == {"failed"}


def test_closing_stops_the_work_and_keeps_checkpoints(tmp_path: pathlib.Path, site: Site) -> None:
    todo = tasks(tmp_path, ("ah-ch",))
    with contextlib.closing(executor.run_tasks(todo, site=site, work=fakes.HANGING)) as events:
        assert isinstance(next(events), Started)
        assert isinstance(next(events), Advanced)
    (child,) = checkpointed(tmp_path)
    await_(lambda: not alive(child), "an end of the training process")
    assert Store(tmp_path).read("runs").empty  # nothing failed: it was stopped
    assert isinstance(
        do(todo, site, fakes.HANGING)[-1], Finished
    )  # the fake ends where there is a checkpoint
    assert set(Store(tmp_path).read("runs")["status"]) == {"ok"}


def test_a_cell_over_two_workers_trains_as_one_stack(tmp_path: pathlib.Path, site: Site) -> None:
    (cell,) = tasks(tmp_path, ("ab-cb",))
    assert isinstance(cell, CellTask)
    parts = split([cell], 2)
    assert [part.seeds for part in parts if isinstance(part, CellTask)] == [(0,), (1,)]
    do(parts, site, Work())
    curves = Store(tmp_path).read("curves")
    for stacked, run in zip(train_cell(cell.spec, cell.seeds), cell.runs, strict=True):
        ours = curves[curves["run"] == run].sort_values("env_steps").reset_index(drop=True)
        columns = [name for name in stacked.curve if name not in MEASURED]
        pd.testing.assert_frame_equal(
            ours[columns], stacked.curve[columns], check_dtype=False, check_exact=True
        )
    assert Store(tmp_path).read("runs").set_index("run").loc[cell.runs[1], "stack_seeds"].tolist() == [1]


def test_a_lost_worker_is_replaced_by_another(tmp_path: pathlib.Path, cluster: Cluster, site: Site) -> None:
    todo = tasks(tmp_path, ("ah-ch",))
    events = []
    for event in executor.run_tasks(todo, site=site, work=fakes.HANGING):
        events.append(event)
        if isinstance(event, Advanced) and len(cluster.workers) == 2:
            (child,) = checkpointed(tmp_path)
            lost = cluster.worker_of(child)
            lost.kill()
            lost.wait()
            cluster.workers.remove(lost)
    assert [type(event) for event in events if not isinstance(event, Advanced)] == [
        Started,
        Restarted,
        Finished,
    ]
    assert set(Store(tmp_path).read("runs")["status"]) == {"ok"}
    await_(lambda: not alive(child), "an end of the process whose worker was lost")


def retire(site: Site, worker: subprocess.Popen[bytes]) -> None:
    """Ask a worker to go as soon as nobody needs it, as a scheduler does that wants fewer of them."""
    (address,) = (one for one, pid in site.client.run(os.getpid).items() if pid == worker.pid)
    site.client.retire_workers([address], close_workers=False, remove=False)


def terminate(site: Site, worker: subprocess.Popen[bytes]) -> None:
    """Ask a worker to go as a batch system does when its time is up."""
    worker.terminate()


def losses(site: Site) -> int:
    """Return how many lost workers the scheduler holds against what it has; it gives up at the fourth."""
    return site.client.run_on_scheduler(
        lambda dask_scheduler: sum(task.suspicious for task in dask_scheduler.tasks.values())
    )


@pytest.mark.parametrize(("ask_to_go", "allowed"), [(retire, 0), (terminate, 1)])
def test_a_worker_that_is_asked_to_go_hands_its_cell_on(
    ask_to_go: Callable[[Site, subprocess.Popen[bytes]], None],
    allowed: int,
    tmp_path: pathlib.Path,
    cluster: Cluster,
    site: Site,
) -> None:
    deadline = time.monotonic() + 30
    children: list[int] = []
    told: list[Event] = []
    with contextlib.ExitStack() as at_last:
        running = executor.run_tasks(tasks(tmp_path, ("ah-ch",)), site=site, work=fakes.HANGING, tick=0.1)
        for event in at_last.enter_context(contextlib.closing(running)):
            assert time.monotonic() < deadline, "nobody took the cell over"
            if isinstance(event, Advanced) and not children:
                children = checkpointed(tmp_path)
                leaving = cluster.worker_of(*children)
                at_last.callback(leaving.wait)
                at_last.callback(leaving.kill)  # first, then it is waited for
                ask_to_go(site, leaving)
            if isinstance(event, Restarted):
                assert losses(site) <= allowed
            if not isinstance(event, Advanced | Idle):
                told.append(event)
        await_(lambda: not alive(*children), "an end of the process whose cell was handed on")
    # The fake comes to an end only where it finds a checkpoint.
    assert [type(event) for event in told] == [Started, Restarted, Finished]
    assert isinstance(told[-1], Finished)
    assert told[-1].failure is None
    assert set(Store(tmp_path).read("runs")["status"]) == {"ok"}


def test_a_lost_scheduler_ends_the_command_and_the_next_one_goes_on(
    tmp_path: pathlib.Path, cluster: Cluster, capsys: pytest.CaptureFixture[str]
) -> None:
    command = [
        "run",
        "--results",
        str(tmp_path),
        "--budget",
        "smoke",
        "--domain",
        "hallway",
        "--agent",
        "ah-ch",
    ]
    command += ["--seeds", "0"]
    busy = []

    def kill_scheduler() -> None:
        busy.append(cluster.worker_of(*checkpointed(tmp_path)))
        cluster.scheduler.kill()

    with acting(kill_scheduler, when=lambda: checkpointed(tmp_path)):
        assert main([*command, "--executor", cluster.executor], work=fakes.HANGING) == 1
    assert f"the Dask scheduler at {cluster.address} is gone" in capsys.readouterr().err
    store = Store(tmp_path / "smoke" / PRESET)
    assert store.read("runs").empty
    (child,) = checkpointed(tmp_path)
    await_(lambda: not alive(child), "an end of the training process")
    busy[0].wait(30)  # a worker that lost its scheduler ends by itself

    cluster.complete(workers=2)
    assert main([*command, "--executor", cluster.executor], work=fakes.HANGING) == 0
    assert len(store.read("runs")) == 1
    assert not list(tmp_path.rglob("*.checkpoint"))
    printed = capsys.readouterr().out
    assert "Raw returns (paper, Table 6)" in printed


class DyingWorkers:
    """A client whose scheduler loses every worker that takes a task, some of them after some progress."""

    status = "running"

    def __init__(self, progress: list[int]) -> None:
        self.progress = progress
        self.submitted = 0

    def subscribe_topic(self, topic: str, handler: object) -> None:
        self.handler = handler

    def unsubscribe_topic(self, topic: str) -> None:
        pass

    def cancel(self, futures: list[object]) -> None:
        pass

    def nthreads(self) -> dict[str, int]:
        return {"tcp://10.0.0.1:1": 1}

    def submit(self, function: object, order: object, *, key: str, pure: bool) -> object:
        number = self.submitted
        self.submitted += 1
        last = SimpleNamespace(address="tcp://10.0.0.1:1")
        lost = KilledWorker(key, last, 3) if number < len(self.progress) else None
        if lost:
            self.handler((0.0, {"number": 0, "progress": [self.progress[number], 3200, 1.0, 0.0, "train"]}))
        return _Future(key, lost)


class _Future(distributed.Future):
    def __init__(self, key: str, error: BaseException | None) -> None:
        self.key, self.error = key, error

    def __del__(self) -> None:
        pass

    def add_done_callback(self, callback):
        callback(self)

    def cancelled(self) -> bool:
        return False

    def exception(self) -> BaseException | None:  # type: ignore[override]
        return self.error

    def result(self) -> Outcome:  # type: ignore[override]
        return Outcome(None)


def test_a_task_that_gets_further_may_lose_any_number_of_workers(tmp_path: pathlib.Path) -> None:
    client = DyingWorkers([80, 160, 800])
    events = do(tasks(tmp_path, ("ah-ch",)), Site(client, "10.0.0.2:8786"), fakes.BREAKING)
    assert client.submitted == 4
    assert isinstance(events[-1], Finished)
    assert events[-1].failure is None


def test_a_task_that_kills_its_workers_fails(tmp_path: pathlib.Path) -> None:
    client = DyingWorkers([80, 80, 80])
    events = do(tasks(tmp_path, ("ah-ch",)), Site(client, "10.0.0.2:8786"), fakes.BREAKING)
    assert client.submitted == 2
    assert isinstance(events[-1], Finished)
    assert "out of memory, perhaps (last: tcp://10.0.0.1:1)" in events[-1].failure.error
    assert set(Store(tmp_path).read("runs")["status"]) == {"failed"}
