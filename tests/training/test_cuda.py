"""Streams, captures and errors of a GPU, against a pretended ``torch.cuda``."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from itertools import count

import pytest
import torch

from bgn.training import cuda
from bgn.training.cell import DeviceLostError
from bgn.training.cuda import Graph, is_cuda_error, lost_devices, own_stream
from bgn.training.update_runner import UpdateRunner
from tests.training._stacks import learner

GPU = torch.device("cuda")


class FakeStream:
    """One of 32, handed out in turn, as torch does it."""

    def __init__(self, number: int) -> None:
        self.cuda_stream = number
        self.waits = 0

    def synchronize(self) -> None:
        self.waits += 1


class FakeCuda:
    """What the project uses of ``torch.cuda``; a graph replays what was called while it was captured."""

    def __init__(self) -> None:
        self.numbers = count()
        self.current = threading.local()
        self.capturing: FakeGraph | None = None
        self.captures: list[tuple[int, str]] = []
        self.most_at_once = 0
        self.failing = False

    def make_stream(self, device: torch.device | None = None) -> FakeStream:
        return FakeStream(next(self.numbers) % 32)

    def current_stream(self) -> FakeStream:
        stream: FakeStream = self.current.stream
        return stream

    @contextlib.contextmanager
    def stream(self, stream: FakeStream) -> Iterator[None]:
        before = getattr(self.current, "stream", None)
        self.current.stream = stream
        yield
        self.current.stream = before

    @contextlib.contextmanager
    def graph(self, graph: FakeGraph, *, stream: FakeStream, capture_error_mode: str) -> Iterator[None]:
        assert self.capturing is None, "two captures at once"
        self.capturing = graph
        self.captures.append((stream.cuda_stream, capture_error_mode))
        try:
            if self.failing:
                raise RuntimeError("CUDA error: operation not permitted when stream is capturing")
            yield
        finally:
            self.capturing = None


class FakeGraph:
    def __init__(self) -> None:
        self.replays = self.resets = 0

    def replay(self) -> None:
        self.replays += 1

    def reset(self) -> None:
        assert cuda._CAPTURING.locked()
        self.resets += 1


@pytest.fixture
def fake(monkeypatch: pytest.MonkeyPatch) -> FakeCuda:
    pretended = FakeCuda()
    monkeypatch.setattr(torch.cuda, "Stream", pretended.make_stream)
    for name in ("stream", "current_stream", "graph"):
        monkeypatch.setattr(torch.cuda, name, getattr(pretended, name))
    monkeypatch.setattr(torch.cuda, "CUDAGraph", FakeGraph)
    monkeypatch.setattr(cuda, "_OWNERS", {})
    monkeypatch.setattr(cuda, "_OWN", threading.local())
    return pretended


def in_threads(work: list, together: bool = True) -> None:
    """Run each in a thread; together: none ends before all have begun."""
    barrier = threading.Barrier(len(work) if together else 1)

    def run(one) -> None:
        one()
        barrier.wait(10)

    threads = [threading.Thread(target=run, args=(one,)) for one in work]
    for thread in threads:
        thread.start()
        if not together:
            thread.join()
    for thread in threads:
        thread.join()


def test_a_thread_has_one_stream_for_life(fake: FakeCuda) -> None:
    seen: dict[int, set[int]] = {}

    def cells(worker: int) -> None:
        for _ in range(40):  # cells, one after another
            with own_stream(GPU):
                seen.setdefault(worker, set()).add(torch.cuda.current_stream().cuda_stream)

    in_threads([lambda worker=worker: cells(worker) for worker in range(cuda.MAX_CELLS)])
    assert all(len(streams) == 1 for streams in seen.values())
    assert len(set.union(*seen.values())) == cuda.MAX_CELLS == 31


def test_streams_of_dead_threads_are_taken_again_and_those_of_living_ones_never(fake: FakeCuda) -> None:
    with own_stream(GPU):
        mine = torch.cuda.current_stream().cuda_stream
    taken: list[int] = []

    def one() -> None:
        with own_stream(GPU):
            taken.append(torch.cuda.current_stream().cuda_stream)

    in_threads([one] * 100, together=False)
    assert len(taken) == 100
    assert mine not in taken


def test_more_threads_than_streams_are_refused(fake: FakeCuda) -> None:
    refused: list[str] = []

    def one() -> None:
        try:
            with own_stream(GPU):
                pass
        except RuntimeError as error:
            refused.append(str(error))

    in_threads([one] * 34)
    assert len(refused) == 2
    assert "at most 31 cells" in refused[0]


def test_no_stream_is_taken_on_a_cpu(fake: FakeCuda) -> None:
    with own_stream(torch.device("cpu")):
        pass
    assert next(fake.numbers) == 0


class OnAGpu:
    """A learner that says it is on a GPU, and computes on the CPU."""

    def __init__(self, inner) -> None:
        self.inner = inner
        self.updates = 0

    def __getattr__(self, name: str):
        return getattr(self.inner, name)

    def update(self, variates, scheduled) -> None:
        self.updates += 1
        self.inner.update(variates, scheduled)


def runner_on_a_gpu() -> tuple[UpdateRunner, OnAGpu]:
    stack = OnAGpu(learner("ab-cb", "top-plate", (1, 2), lanes=2, rollout=2))
    return UpdateRunner(stack, 10, capture=True), stack


def test_an_update_is_captured_once_on_the_threads_stream_and_then_replayed(fake: FakeCuda) -> None:
    runner, stack = runner_on_a_gpu()
    with own_stream(GPU):
        for i in range(5):
            runner.update(i)
        graph = runner._graph._graph
        assert fake.captures == [(torch.cuda.current_stream().cuda_stream, "thread_local")]
        assert stack.updates == cuda.WARM_UP + 1
        assert graph.replays == 5  # type: ignore[attr-defined]
        runner.close()
        assert graph.resets == 1  # type: ignore[attr-defined]
        assert torch.cuda.current_stream().waits == 1  # type: ignore[attr-defined]
        runner.close()  # nothing is left to free
        assert graph.resets == 1  # type: ignore[attr-defined]


def test_capturing_leaves_the_state_as_it_was(fake: FakeCuda) -> None:
    runner, stack = runner_on_a_gpu()
    before = {name: tensor.clone() for name, tensor in stack.state().items()}
    with own_stream(GPU):
        runner.update(0)  # the pretended replay does nothing
    for name, tensor in stack.state().items():
        assert torch.equal(tensor, before[name]) or tensor.isnan().any(), name


def test_captures_take_turns(fake: FakeCuda) -> None:
    graphs = []

    def cell() -> None:
        with own_stream(GPU):
            graphs.append(Graph(lambda: threading.Event().wait(0.001), restore=lambda: None))

    in_threads([cell] * 8)  # the pretended capture asserts that it is alone
    assert len(graphs) == len(fake.captures) == 8
    assert len({stream for stream, _ in fake.captures}) == 8


def test_a_failed_capture_loses_the_device(fake: FakeCuda) -> None:
    runner, _ = runner_on_a_gpu()
    fake.failing = True
    with own_stream(GPU), pytest.raises(DeviceLostError, match="cannot capture an update: CUDA error"):
        runner.update(0)
    assert not cuda._CAPTURING.locked()


def test_errors_of_cuda_are_told_from_others() -> None:
    assert is_cuda_error(RuntimeError("CUDA error: an illegal memory access was encountered"))
    assert is_cuda_error(torch.AcceleratorError("unspecified launch failure"))
    assert is_cuda_error(RuntimeError("CUBLAS_STATUS_EXECUTION_FAILED when calling cublasSgemm"))
    assert not is_cuda_error(RuntimeError("expected a tensor of 3 dimensions"))
    assert not is_cuda_error(ValueError("--device CUDA"))
    outer = ValueError("a wrapped one")
    outer.__cause__ = RuntimeError("CUDA error: device-side assert triggered")
    assert is_cuda_error(outer)


@pytest.mark.parametrize(("device", "expected"), [("cuda", DeviceLostError), ("cpu", RuntimeError)])
def test_only_errors_of_a_gpu_lose_it(device: str, expected: type[Exception]) -> None:
    with pytest.raises(RuntimeError) as caught, lost_devices(torch.device(device)):
        raise RuntimeError("CUDA error: out of memory")
    assert type(caught.value) is expected  # type: ignore[unreachable]
    with pytest.raises(FloatingPointError), lost_devices(GPU):
        raise FloatingPointError("the loss is NaN")


def test_replays_wait_for_captures(fake: FakeCuda) -> None:
    """What was captured first goes on when the capture that came between is over, and not before."""
    order: list[str] = []
    capturing, replayed = threading.Event(), threading.Event()

    def slow_call() -> None:
        if not capturing.is_set():
            capturing.set()
            assert not replayed.wait(0.2), "replayed during a capture"
            order.append("captured")

    def replay(graph: Graph) -> None:
        capturing.wait(10)
        graph.replay()
        order.append("replayed")
        replayed.set()

    with own_stream(GPU):
        first = Graph(lambda: None, restore=lambda: None)

    def capture() -> None:
        with own_stream(GPU):
            Graph(slow_call, restore=lambda: None)

    in_threads([lambda: replay(first), capture])
    assert order == ["captured", "replayed"]


def test_replays_go_on_after_a_capture_that_failed(fake: FakeCuda) -> None:
    with own_stream(GPU):
        graph = Graph(lambda: None, restore=lambda: None)
        fake.failing = True
        with pytest.raises(DeviceLostError):
            Graph(lambda: None, restore=lambda: None)
        graph.replay()
