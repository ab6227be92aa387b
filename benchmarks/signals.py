"""Ends a command in an orderly way when a signal asks for it: Ctrl-C, SIGTERM or SIGHUP."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Iterator
from types import FrameType
from typing import ClassVar

#: Signals that ask a command to end.
ASKING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Stopped(BaseException):
    """A signal asked the command to end; no failure, so not an ``Exception``."""

    def __init__(self, signum: int) -> None:
        super().__init__(signum)
        self.signal = signal.Signals(signum)

    @property
    def exit_status(self) -> int:
        """128 and the signal's number, as shells have it: 130 (SIGINT), 143 (SIGTERM), 129 (SIGHUP)."""
        return 128 + self.signal


@contextlib.contextmanager
def stoppable() -> Iterator[None]:
    """Raise :class:`Stopped` in the main thread when a signal asks to end.

    What is ignored stays ignored: ``nohup`` means it. In another thread nothing changes, for there it cannot.
    """
    here = threading.current_thread() is threading.main_thread()
    found = {one: signal.getsignal(one) for one in ASKING if here}
    before = {one: handler for one, handler in found.items() if handler not in (None, signal.SIG_IGN)}
    for one in before:
        signal.signal(one, _raise)
    try:
        yield
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


class _Held:
    """Signals that came while they were held back; Python handles all of them in the main thread."""

    depth = 0
    signals: ClassVar[list[int]] = []


@contextlib.contextmanager
def held_back() -> Iterator[None]:
    """Let these signals wait, for this thread and for processes started in it.

    The kernel gives a signal that one thread blocks to any other that does not, and Python handles it in the main
    thread all the same: hence the handler waits too.
    """
    main = threading.current_thread() is threading.main_thread()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ASKING)
    _Held.depth += main
    try:
        yield
    finally:
        _Held.depth -= main
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if main and _Held.depth == 0 and _Held.signals:
            first, *_ = _Held.signals
            _Held.signals.clear()
            raise Stopped(first)


def _raise(signum: int, frame: FrameType | None) -> None:
    if _Held.depth:
        _Held.signals.append(signum)
        return
    raise Stopped(signum)
