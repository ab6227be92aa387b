"""Compile a scene's physics into its exact outcome table.

Every reachable (reading, move, hidden part) is stepped in MuJoCo from several different histories. All of
them must agree, and every measurement must keep clear of the threshold that discretises it: then the table
is exact, and whatever is trained on it was trained on the physics.
"""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Final

import mujoco
import numpy as np

from bgn.domains import outcome_table
from bgn.domains.outcome_table import Header, OutcomeTable
from bgn.errors import BgnError
from bgn.physics.scene import Measurement, Scene, Snapshot
from bgn.physics.tasks import task_of

HISTORIES: Final = 4
MARGIN: Final = 0.25


class CompileError(BgnError, ValueError):
    """The physics of a scene is not a table: an outcome depends on the history, or nearly does."""


@dataclass(frozen=True)
class Column:
    """The compiled outcomes of one hidden part, by (reading, move)."""

    outcomes: dict[tuple[int, int], tuple[int, int]]
    """(next reading, pushed)"""
    histories: int
    margin: float


def key(scene: Scene) -> str:
    """Return the content hash a table of this scene is stored under."""
    content = {"xml": scene.xml, "parameters": scene.parameters(), "mujoco": mujoco.__version__}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def compile_hidden(scene: Scene, hidden: int, histories: int = HISTORIES) -> Column:
    """Compile all reachable outcomes of one hidden part, each from at least ``histories`` histories.

    Raises
    ------
    CompileError
        Two histories disagree, a measurement is too close to its threshold, or a reading has fewer histories.
    """
    found: dict[tuple[int, int], tuple[int, int]] = {}
    kept: dict[int, int] = defaultdict(int)
    queue: deque[Snapshot] = deque()

    def keep(measurement: Measurement) -> None:
        if kept[measurement.reading] < histories:
            kept[measurement.reading] += 1
            queue.append(scene.save())

    for cell in scene.starts(hidden):
        keep(scene.reset(hidden, cell))
    margin = np.inf
    while queue:
        snapshot = queue.popleft()
        for action in range(scene.actions):
            scene.restore(snapshot)
            before, after = snapshot.measurement, scene.act(action)
            # A push ends the episode: where the finger goes then is of no consequence.
            result = (before.reading if after.pushed else after.reading, after.pushed)
            if found.setdefault((before.reading, action), result) != result:
                raise CompileError(
                    f"{scene.name}: action {action} in reading {before.reading} with hidden part {hidden} "
                    f"gives {result} or {found[before.reading, action]}, depending on the history"
                )
            margin = min(margin, after.margin)
            if after is not before and not after.pushed:
                keep(after)
    if margin < MARGIN:
        raise CompileError(f"{scene.name}: hidden part {hidden} has a margin of {margin:.3f}, below {MARGIN}")
    fewest = min(kept.values())
    if fewest < histories:
        raise CompileError(f"{scene.name}: hidden part {hidden} has a reading with only {fewest} histories")
    return Column(found, fewest, float(margin))


def compile_scene(
    name: str,
    histories: int = HISTORIES,
    jobs: int = 1,
    progress: Progress | None = None,
) -> OutcomeTable:
    """Compile the whole table of a scene, its hidden parts in ``jobs`` processes.

    ``progress`` wraps the iteration over the hidden parts, as ``rich.progress.track`` does.

    Raises
    ------
    CompileError
        The physics is not a table, or ``histories`` is below 1.
    """
    if histories < 1:
        raise CompileError(f"a table needs histories >= 1, not {histories}")
    scene = task_of(name).scene()
    hidden = scene.hidden_parts()
    columns = _columns(name, hidden, histories, jobs)
    return _collect(scene, list(progress(columns, len(hidden)) if progress else columns))


Progress = Callable[[Iterable[Column], int], Iterable[Column]]


def _columns(name: str, hidden: Iterable[int], histories: int, jobs: int) -> Iterator[Column]:
    if jobs == 1:
        scene = task_of(name).scene()
        yield from (compile_hidden(scene, part, histories) for part in hidden)
        return
    with ProcessPoolExecutor(jobs, get_context("spawn"), initializer=_start_worker, initargs=(name,)) as pool:
        yield from pool.map(_work, hidden, [histories] * len(list(hidden)))


_worker: Scene | None = None


def _start_worker(name: str) -> None:
    global _worker  # each process of the pool builds its scene once
    _worker = task_of(name).scene()


def _work(hidden: int, histories: int) -> Column:
    assert _worker is not None
    return compile_hidden(_worker, hidden, histories)


def _collect(scene: Scene, columns: list[Column]) -> OutcomeTable:
    readings = 1 + max(reading for column in columns for reading, _ in column.outcomes)
    readings = -(-readings // scene.bins) * scene.bins
    shape = (readings, scene.actions, len(columns))
    reading, pushed = np.full(shape, -1, dtype=np.int16), np.zeros(shape, dtype=np.int8)
    for h, column in enumerate(columns):
        for (before, action), (after, push) in column.outcomes.items():
            reading[before, action, h] = after
            pushed[before, action, h] = push
    header = Header(
        domain=scene.name,
        key=key(scene),
        mujoco=mujoco.__version__,
        pairs=int((reading >= 0).sum()),
        histories=min(column.histories for column in columns),
        margin=round(min(column.margin for column in columns), 4),
        digest=outcome_table.digest(reading, pushed),
    )
    return OutcomeTable(reading, pushed, header)
