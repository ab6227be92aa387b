"""Compile a scene's physics into its exact outcome table.

Every reachable (reading, move, hidden part) is stepped in MuJoCo from several different histories. All of
them must agree, and every measurement must keep clear of the threshold that discretises it: then the table
is exact, and whatever is trained on it was trained on the physics.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Final

import mujoco
import numpy as np

from bgn.domains import outcome_table
from bgn.domains.outcome_table import Header, Outcomes
from bgn.errors import BgnError
from bgn.physics.scene import Measurement, Scene, Snapshot
from bgn.physics.top_plate import TopPlateScene
from bgn.physics.two_bumps_1d import TwoBumps1DScene
from bgn.physics.two_bumps_2d import TwoBumps2DScene

HISTORIES: Final = 4
MARGIN: Final = 0.25
SCENES: Final[dict[str, Callable[..., Scene]]] = {
    scene.name: scene for scene in (TopPlateScene, TwoBumps1DScene, TwoBumps2DScene)
}


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
    *scene_arguments: int,
    histories: int = HISTORIES,
    jobs: int = 1,
    progress: Progress | None = None,
) -> Outcomes:
    """Compile the whole table of a scene, its hidden parts in ``jobs`` processes.

    ``progress`` wraps the iteration over the hidden parts, as ``rich.progress.track`` does.

    Raises
    ------
    CompileError
        The physics is not a table, or ``histories`` is below 1.
    """
    if histories < 1:
        raise CompileError(f"a table needs histories >= 1, not {histories}")
    scene = SCENES[name](*scene_arguments)
    hidden = scene.hidden_parts()
    columns = _columns(name, scene_arguments, hidden, histories, jobs)
    return _collect(scene, list(progress(columns, len(hidden)) if progress else columns))


Progress = Callable[[Iterable[Column], int], Iterable[Column]]


def cached(name: str, *scene_arguments: int) -> Outcomes:
    """Return the table of a scene that is not shipped, compiled once and kept in the user's cache."""
    wanted = key(SCENES[name](*scene_arguments))
    stem = cache_folder() / f"{name}-{wanted[:16]}"
    if stem.with_suffix(".json").exists():
        return outcome_table.load(stem)
    outcomes = compile_scene(name, *scene_arguments, jobs=os.cpu_count() or 1)
    outcome_table.save(outcomes, stem)
    return outcomes


def cache_folder() -> Path:
    """``$XDG_CACHE_HOME/bgn/tables``, by default below ``~/.cache``."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "bgn" / "tables"


def _columns(
    name: str, arguments: tuple[int, ...], hidden: Iterable[int], histories: int, jobs: int
) -> Iterator[Column]:
    if jobs == 1:
        scene = SCENES[name](*arguments)
        yield from (compile_hidden(scene, part, histories) for part in hidden)
        return
    with ProcessPoolExecutor(
        jobs, get_context("spawn"), initializer=_start_worker, initargs=(name, arguments)
    ) as pool:
        yield from pool.map(_work, hidden, [histories] * len(list(hidden)))


_worker: Scene | None = None


def _start_worker(name: str, arguments: tuple[int, ...]) -> None:
    global _worker  # each process of the pool builds its scene once
    _worker = SCENES[name](*arguments)


def _work(hidden: int, histories: int) -> Column:
    assert _worker is not None
    return compile_hidden(_worker, hidden, histories)


def _collect(scene: Scene, columns: list[Column]) -> Outcomes:
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
    return Outcomes(reading, pushed, header)
