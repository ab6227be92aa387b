"""What the cells that share one GPU must take turns at, and what they must never share.

Every worker thread owns one stream for life. Torch hands out 32 streams in turn and then the same ones again, so
that a thread which asked for a new one per cell would in time run, or capture, on a stream that another cell is
running on: one cell's work would become part of another's graph, silently.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import torch

from bgn.training.cell import DeviceLostError

#: Different streams that torch has of one priority.
TORCH_STREAMS = 32
#: Most cells side by side: a stream each, one being left to whatever else takes one.
MAX_CELLS = TORCH_STREAMS - 1
#: Updates run before a graph is captured, so that every library has set itself up.
WARM_UP = 3

#: Held while a graph is captured, and while one is taken apart.
_CAPTURING = threading.Lock()
_TAKING = threading.Lock()
_OWNERS: dict[int, threading.Thread] = {}
_OWN = threading.local()
#: What the messages of errors of CUDA and its libraries have in them.
_MARKS = ("CUDA", "CUBLAS", "cuBLAS", "CUDNN", "cuDNN")


@contextmanager
def own_stream(device: torch.device) -> Iterator[None]:
    """On a GPU, do this thread's work on the thread's own stream, so that cells in other threads run beside it."""
    if device.type != "cuda":
        yield
        return
    if not hasattr(_OWN, "stream"):
        _OWN.stream = _take_stream(device)
    with torch.cuda.stream(_OWN.stream):
        yield


def _take_stream(device: torch.device) -> Any:
    """Return a stream that no living thread owns.

    Raises
    ------
    RuntimeError
        All are taken.
    """
    with _TAKING:
        for _ in range(TORCH_STREAMS):
            stream = torch.cuda.Stream(device)  # type: ignore[no-untyped-call]
            owner = _OWNERS.get(stream.cuda_stream)
            if owner is None or not owner.is_alive():
                _OWNERS[stream.cuda_stream] = threading.current_thread()
                return stream
    raise RuntimeError(
        f"all {TORCH_STREAMS} streams of torch are taken; at most {MAX_CELLS} cells run at once"
    )


class _Precedence:
    """Lets captures go before replays.

    A capture is thousands of calls of Python. Beside threads that replay, which take the interpreter and fill the
    device, it lasts seconds; while they pause, a fraction of one.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._wanted = 0

    @contextmanager
    def capturing(self) -> Iterator[None]:
        """Capture in here, one thread at a time."""
        with self._changed:
            self._wanted += 1
        try:
            with _CAPTURING:
                yield
        finally:
            with self._changed:
                self._wanted -= 1
                self._changed.notify_all()

    def give_way(self) -> None:
        """Wait while any thread captures or is about to."""
        if self._wanted:
            with self._changed:
                self._changed.wait_for(lambda: not self._wanted)


_PRECEDENCE = _Precedence()


class Graph:
    """A call captured once, and replayed without its host work.

    ``call`` must never wait for the device, and what it reads and writes must keep its place.
    """

    def __init__(self, call: Callable[[], None], restore: Callable[[], None]) -> None:
        """Capture ``call`` on the current stream; ``restore`` undoes what warming up did."""
        stream = torch.cuda.current_stream()
        self._graph = torch.cuda.CUDAGraph()
        try:
            with _PRECEDENCE.capturing():
                for _ in range(WARM_UP):
                    call()
                # Thread-local: what cells in other threads do meanwhile must not spoil the capture.
                with torch.cuda.graph(self._graph, stream=stream, capture_error_mode="thread_local"):
                    call()
                restore()
        except Exception as error:  # whatever it was, torch's allocator goes on believing that it captures
            raise DeviceLostError(f"cannot capture an update: {error}") from error

    def replay(self) -> None:
        """Launch all of it, once no thread captures."""
        _PRECEDENCE.give_way()
        self._graph.replay()

    def close(self) -> None:
        """Give its memory back, once the device is done with it and while nothing is being captured."""
        with _CAPTURING:
            torch.cuda.current_stream().synchronize()
            self._graph.reset()


@contextmanager
def lost_devices(device: torch.device) -> Iterator[None]:
    """Raise :class:`DeviceLostError` instead of errors of CUDA, after which a process is of no use."""
    try:
        yield
    except DeviceLostError:
        raise
    except Exception as error:
        if device.type == "cuda" and is_cuda_error(error):
            raise DeviceLostError(f"{type(error).__name__}: {error}") from error
        raise


def is_cuda_error(error: BaseException | None) -> bool:
    """Say whether an error, or what it came from, is one of the device and not of this program."""
    while error is not None:
        if isinstance(error, torch.AcceleratorError):
            return True
        if isinstance(error, RuntimeError) and any(mark in str(error) for mark in _MARKS):
            return True
        error = error.__cause__ or error.__context__
    return False
