"""A function that is applied over and over to a state of arrays; on an NVIDIA GPU it is recorded as a CUDA graph and replayed.

A replay starts all operations of the function at once, where Python would start hundreds one by one. It works on arrays of its own,
into which problem and state are copied before the first replay; the state stays there until it is taken. A graph is recorded when a
problem of the same shapes comes for the second time, so that shapes that do not recur are never recorded.
"""

from collections import Counter, OrderedDict
from collections.abc import Callable
from typing import Any

from ninedtact.mechanics.numpy_or_torch_arrays import flatten, map_arrays

_MAX_GRAPHS = 24
"""Largest number of recorded graphs; the one that was not used for longest is dropped."""

Step = Callable[[Any, Any], Any]
"""A function from a problem and a state to the next state, which has the same structure and shapes."""


class Repetition:
    """Applies a function to a state over and over."""

    def __init__(self, step: Step, problem: Any) -> None:
        self._step, self._problem = step, problem

    def next(self, state: Any) -> Any:
        """Return the next state; the one before must not be used any more."""
        return self._step(self._problem, state)

    def take(self, state: Any) -> Any:
        """Return the state in arrays that later steps do not change."""
        return state


class _RecordedRepetition(Repetition):
    """Replays the function as a CUDA graph on arrays of its own."""

    def __init__(self, step: Step, problem: Any, state: Any) -> None:
        import torch

        super().__init__(step, map_arrays(torch.clone, problem))
        self._state = map_arrays(torch.clone, state)
        self._graph, beside = torch.cuda.CUDAGraph(), torch.cuda.Stream()  # type: ignore[no-untyped-call]
        beside.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(beside):
            step(self._problem, self._state)  # plans and handles are made before they are recorded
            # Not by `torch.cuda.graph`, which collects garbage and empties the memory's cache at every recording.
            self._graph.capture_begin(pool=_graphs.pool())
            _copy_arrays(self._state, step(self._problem, self._state))
            self._graph.capture_end()
        torch.cuda.current_stream().wait_stream(beside)

    def load(self, problem: Any, state: Any) -> None:
        """Copy a problem and a state of the recorded shapes."""
        _copy_arrays((self._problem, self._state), (problem, state))

    def next(self, state: Any) -> Any:
        self._graph.replay()
        return self._state

    def take(self, state: Any) -> Any:
        return map_arrays(lambda array: array.clone(), self._state)


class _Graphs:
    """The graphs recorded so far, by function, structure and shapes."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all graphs, and which shapes have come."""
        self.recorded: OrderedDict[Any, _RecordedRepetition] = OrderedDict()
        self.seen: Counter[Any] = Counter()
        self._pool: Any = None

    def pool(self) -> Any:
        """Return the memory that all graphs share for what does not outlast a replay."""
        import torch

        self._pool = self._pool or torch.cuda.graph_pool_handle()
        return self._pool

    def find(self, step: Step, problem: Any, state: Any) -> Repetition:
        """Return the repetition of a function, loaded with this problem and state, recorded if the shapes have come before."""
        key = step, _signature((problem, state))
        if key not in self.recorded:
            self.seen[key] += 1
            if self.seen[key] < 2:
                return Repetition(step, problem)
            self.recorded[key] = _RecordedRepetition(step, problem, state)
            if len(self.recorded) > _MAX_GRAPHS:
                self.recorded.popitem(last=False)
        self.recorded.move_to_end(key)
        self.recorded[key].load(problem, state)
        return self.recorded[key]


_graphs = _Graphs()


def repeated(step: Step, problem: Any, state: Any, recordable: bool) -> Repetition:
    """Return the repetition of a function of a problem and a state.

    recordable: whether the function can be recorded, because it never looks at values; arrays that are not on a GPU never are.
    """
    on_gpu = getattr(getattr(next(flatten(state)), "device", None), "type", "") == "cuda"
    return _graphs.find(step, problem, state) if on_gpu and recordable else Repetition(step, problem)


def forget_graphs() -> None:
    """Drop all recorded graphs and release their memory."""
    _graphs.clear()


def _signature(value: Any) -> Any:
    """Return what must be equal for a recorded graph to be replayed: plain values, and shapes, types and devices of arrays."""
    each = flatten(value)
    return tuple((tuple(one.shape), one.dtype, one.device) if hasattr(one, "ndim") else one for one in each)


def _copy_arrays(to: Any, found: Any) -> None:
    """Copy the arrays of one value into those of another."""
    for target, array in zip(flatten(to), flatten(found), strict=True):
        if hasattr(target, "copy_"):
            target.copy_(array)
