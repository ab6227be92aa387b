"""Random rounds on one store: runs, kills, resumes, merges, exports and prints, with an eye on all that is left behind.

What a round does follows from the seed; when exactly a kill comes, from the machine as well.
"""

from __future__ import annotations

import contextlib
import io
import os
import pathlib
import random
import shutil
import signal
import statistics
import subprocess
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from benchmarks.__main__ import main
from benchmarks.plan import Request, Selection
from tests.crash import tiny
from tests.crash.holdings import Holdings
from tests.crash.processes import await_death, children, kill, marked, wait_until
from tests.crash.stores import (
    Files,
    assert_same_results,
    assert_unlocked,
    assert_untouched,
    done,
    files_of,
    finished,
    is_torn,
    names,
    strays,
)

FORMS: tuple[tuple[str, ...], ...] = (
    (),
    ("--all",),
    ("--write",),
    *(("--all", "--format", form) for form in ("md", "csv", "html", "latex")),
)
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
#: How often each kind of round comes, relative to the others.
WEIGHTS = {"run": 3, "run_beside": 3, "kill": 5, "merge_in": 2, "merge_out": 1, "export": 1, "show": 1}
_SECONDS_TO_END = 600.0
_FIRST_GUESS_SECONDS = 6.0


class Soak:
    """One store and what is done to it."""

    def __init__(self, folder: pathlib.Path, seed: int) -> None:
        self.folder, self.rng = folder, random.Random(seed)
        self.whole = tiny.universe()
        self.everything = {request.run: request for request in self.whole.requests()}
        self.results, self.copy = folder / "soak", folder / "copy"
        self.results.mkdir()
        self.store, self.reference = tiny.store_of(self.results), tiny.store_of(folder / "undisturbed")
        self.before: Files = {}
        """Everything finished, as it lay there after the last round."""
        self.spared: set[str] = set()
        """What a kill left behind in the moment between a row and the end of what it replaces, or half written."""
        self.interrupted: list[Selection] = []
        self.counts: Counter[str] = Counter()
        self.lasted: deque[float] = deque([_FIRST_GUESS_SECONDS], maxlen=16)
        self.mark = f"BGN_SOAK={os.getpid()}-{seed}"
        self.held: list[Holdings] = []
        self.kind = ""
        """What the last round did."""

    def prepare(self) -> None:
        """Compute everything undisturbed, to compare with."""
        self._call(*tiny.selecting(self.whole, self.folder / "undisturbed"), "--jobs", "2")
        assert done(self.reference) == self.everything.keys()

    def round(self) -> None:
        """Do something at random, and look at what it left behind."""
        self.kind = kind = self._next()
        getattr(self, f"_{kind}")()
        self.counts[kind] += 1
        self._check(killed=kind == "kill")
        if not self._missing():
            self._compare()
            self._remove_some()
        self.held.append(Holdings.now())

    def finish(self) -> None:
        """Compute what is still missing, and compare everything."""
        self._run_here(self.whole)
        self._check()
        self._compare()

    def __str__(self) -> str:
        kinds = ("kills", "resumes", "merges", "exports", "tables", "comparisons", "removed")
        said = ", ".join(f"{self.counts[name]} {name}" for name in kinds)
        return (
            f"{len(self.held)} rounds, {said}; spared {sorted(self.spared) or 'nothing'}; last, {self.kind}"
        )

    # ------------------------------------------------------------ kinds of rounds

    def _next(self) -> str:
        """Draw a kind of round that can be: what is empty cannot be passed on."""
        weights = WEIGHTS if self.before else {"run": 1, "run_beside": 1, "kill": 1}
        (kind,) = self.rng.choices([*weights], [*weights.values()])
        return kind

    def _run(self) -> None:
        self._run_here(self._some())

    def _run_here(self, chosen: Selection) -> None:
        self._note_resumption(chosen)
        self._call(*tiny.selecting(chosen, self.results), *self._jobs())
        self._expect(chosen)

    def _run_beside(self) -> None:
        """Run in a process of its own, and print meanwhile."""
        chosen, began = self._some(), time.monotonic()
        self._note_resumption(chosen)
        process = self._start(chosen)
        if self.rng.random() < 0.5:
            wait_until(process, began + self.rng.uniform(0.0, self._typical()))
            self._print(*self.rng.choice([form for form in FORMS if "--write" not in form]))
        output = process.communicate(timeout=_SECONDS_TO_END)[0]
        self.lasted.append(time.monotonic() - began)
        assert process.returncode == 0, output
        self._expect(chosen)

    def _kill(self) -> None:
        """Kill workers now and then, and at last mostly the command, one way or another."""
        chosen = self._some()
        self.interrupted.append(chosen)
        process = self._start(chosen)
        if self.rng.random() < 0.8:  # most of a command's time goes by before there is anything to lose
            self._await_work(process)
        began, longest = time.monotonic(), self._typical() / 2
        moments = sorted(self.rng.uniform(0.0, longest) for _ in range(self.rng.randint(1, 3)))
        last = self.rng.choice((None, signal.SIGKILL, *SIGNALS))
        for moment in moments:
            wait_until(process, began + moment)
            signum = last if moment == moments[-1] else None
            self.counts["kills"] += _signal(process, signum) if signum else self._kill_worker(process)
        output = process.communicate(timeout=_SECONDS_TO_END)[0]
        assert process.returncode in _statuses(last), (process.returncode, last, output)

    def _await_work(self, process: subprocess.Popen[str]) -> None:
        """Wait until a command has left something in the store, or ended."""
        before = names(self.store)
        while process.poll() is None and names(self.store) <= before:
            time.sleep(0.02)

    def _kill_worker(self, process: subprocess.Popen[str]) -> bool:
        workers = children(process.pid)
        return bool(workers) and kill(self.rng.choice(workers))

    def _merge_in(self) -> None:
        """Take over what was computed in another folder, some of which may be here already."""
        elsewhere = self.folder / "elsewhere"
        chosen = self._some(most=1)
        self._call(*tiny.selecting(chosen, elsewhere), *self._jobs())
        self._merge(elsewhere, self.results)
        self._expect(chosen)
        shutil.rmtree(elsewhere)

    def _merge_out(self) -> None:
        """Pass everything on to another folder, which has some of it already."""
        copy = tiny.store_of(self.copy)
        before = finished(copy)
        self._merge(self.results, self.copy)
        assert_untouched(before, finished(copy))
        assert done(self.store) <= done(copy)
        assert not strays(copy)

    def _merge(self, source: pathlib.Path, into: pathlib.Path) -> None:
        self._call("merge", str(source), "--into", str(into))
        self.counts["merges"] += 1

    def _export(self) -> None:
        archive = str(self.folder / "soak.tar")
        options = self.rng.choice(((), ("--without-policies",)))
        self._call("export", archive, "--results", str(self.results), *options)
        for path in (archive, str(self.results)):
            self._call("verify", path)
        self.counts["exports"] += 1

    def _show(self) -> None:
        for form in FORMS:
            self._print(*form)

    # ------------------------------------------------------------ commands

    def _call(self, *arguments: str) -> None:
        """Run a command in this process; it must succeed and say something."""
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed):
            status = main(arguments, work=tiny.WORK)
        assert status == 0, (arguments, printed.getvalue())
        assert printed.getvalue()

    def _start(self, chosen: Selection) -> subprocess.Popen[str]:
        name, value = self.mark.split("=")
        arguments = [*tiny.selecting(chosen, self.results), *self._jobs()]
        return tiny.start(arguments, env=os.environ | {name: value})

    def _print(self, *form: str) -> None:
        where = ("--results", str(self.results), "--budget", tiny.BUDGET)
        self._call("tables", *where, *form)
        self._call("status", *where)
        self.counts["tables"] += 1

    def _jobs(self) -> tuple[str, str]:
        return "--jobs", str(self.rng.randint(1, 3))

    # ------------------------------------------------------------ choices

    def _some(self, most: int = 2) -> Selection:
        """Draw what to run: what was interrupted, now and then everything, else something with something missing."""
        if self.interrupted and self.rng.random() < 0.4:
            return self.interrupted.pop(self.rng.randrange(len(self.interrupted)))
        if most > 1 and self.rng.random() < 0.05:
            return self.whole
        wanted = self.rng.choice(self._missing())
        cell = wanted.run.split("/")
        chosen = replace(
            self.whole,
            domains=self._draw(self.whole.domains, cell, most),
            agents=self._draw(self.whole.agents, cell, most),
            references=self._draw(self.whole.references, cell, most),
            seeds=self.rng.choice(((wanted.seed,), self.whole.seeds)),
        )
        left_out = self.rng.choice(("agents", "references", None))
        return chosen if left_out is None else _without(chosen, left_out, wanted)

    def _draw(self, known: Sequence[str], wanted: Iterable[str], most: int) -> tuple[str, ...]:
        drawn = {*self.rng.sample(known, self.rng.randint(1, most))} | {*wanted}
        return tuple(name for name in known if name in drawn)

    def _missing(self) -> list[Request]:
        there = done(self.store)
        return [request for run, request in self.everything.items() if run not in there]

    def _typical(self) -> float:
        """Return how long a command lasts, in seconds."""
        return statistics.median(self.lasted)

    # ------------------------------------------------------------ what must hold

    def _note_resumption(self, chosen: Selection) -> None:
        cells = [f"/.work/{domain}/{agent}/" for domain in chosen.domains for agent in chosen.agents]
        waiting = [path.as_posix() for path in self.store.root.rglob("*.checkpoint")]
        self.counts["resumes"] += any(cell in path for cell in cells for path in waiting)

    def _expect(self, chosen: Selection) -> None:
        """After a command that was not disturbed: all of it is there, and nothing is torn."""
        assert {request.run for request in chosen.requests()} <= done(self.store)
        self.spared = {name for name in self.spared if not is_torn(name)}

    def _check(self, *, killed: bool = False) -> None:
        """Nothing finished is touched, nothing is left behind, nobody outlives a command, and nobody has the lock."""
        await_death(marked(self.mark), seconds=60.0)
        assert not children(os.getpid())
        assert_unlocked(self.store)
        after = finished(self.store)
        assert_untouched(self.before, after)
        self.before = after
        left = strays(self.store)
        self.spared = left if killed else self.spared & left
        assert left == self.spared, f"left behind: {sorted(left - self.spared)}"

    def _compare(self) -> None:
        """Everything is there: bit for bit what it is without disturbances, and no file more."""
        self._print("--write")
        assert_same_results(self.store, self.reference)
        assert names(self.store) - self.spared == names(self.reference)
        self.counts["comparisons"] += 1

    def _remove_some(self) -> None:
        """Make room for more: remove some runs and rows, or everything."""
        if self.rng.random() < 0.3:
            shutil.rmtree(self.store.root)
            self.before, self.spared = {}, set()
            self.counts["removed"] += len(self.everything)
        else:
            runs = self.rng.sample(sorted(self.everything), self.rng.randint(1, len(self.everything)))
            for path in [path for run in runs for path in files_of(self.store, run)]:
                path.unlink()
                del self.before[path]
            self.counts["removed"] += len(runs)
        shutil.rmtree(self.copy, ignore_errors=True)
        self.interrupted.clear()


def _signal(process: subprocess.Popen[str], signum: signal.Signals) -> bool:
    """Send a signal; False if the process had ended before."""
    if process.poll() is not None:
        return False
    process.send_signal(signum)
    return True


def _statuses(signum: signal.Signals | None) -> set[int]:
    """Return how a command may end that was sent a signal: by it, in an orderly way, or before it came."""
    return {0, 1} if signum is None else {0, 1, -signum, 128 + signum}


def _without(chosen: Selection, kind: str, wanted: Request) -> Selection:
    """Leave out agents or references, if what is wanted is none of them."""
    needed = "agents" if wanted.kind == "runs" else "references"
    options: Mapping[str, tuple[str, ...]] = {} if kind == needed else {kind: ()}
    return replace(chosen, **options)


def repeat(work: Callable[[], object], seconds: float) -> None:
    """Do something again and again, for so long."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        work()
