"""Operations of torch, counted: how many, and how many bytes they read and write if each goes to memory and back."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

VIEWS = {"view", "_unsafe_view", "slice", "select", "unsqueeze", "squeeze", "expand", "permute", "transpose", "alias"}
"""They touch no memory."""
BACK = "_fft_c2r"


@dataclass
class Count:
    """Of one call."""

    kind: type
    """Of its questions."""
    answers: int
    operations: int = 0
    bytes: int = 0
    points: int = 0
    """Of all fields that were transformed there and back."""


@dataclass
class Tally:
    """Counts of all calls."""

    counts: list[Count] = field(default_factory=list)

    def of(self, way: Callable[[Sequence[Any]], list[Any]]) -> Callable[[Sequence[Any]], list[Any]]:
        """The same, counted."""

        def counted(asked: Sequence[Any]) -> list[Any]:
            count = Count(type(asked[0]), len(asked))
            with counting(count):
                told = way(asked)
            self.counts.append(count)
            return told

        return counted

    def last(self, kind: type) -> Count:
        return next(count for count in reversed(self.counts) if count.kind is kind)


def counting(count: Count) -> Any:
    """While this is entered, all that torch does is counted."""
    from torch.utils._python_dispatch import TorchDispatchMode

    class Counting(TorchDispatchMode):
        def __torch_dispatch__(self, operation: Any, types: Any, given: Any = (), named: Any = None) -> Any:
            found, name = operation(*given, **(named or {})), operation.overloadpacket.__name__
            if name not in VIEWS:
                count.operations += 1
                count.bytes += size(given) + size(found)
            if name == BACK:
                count.points += found.numel()
            return found

    return Counting()


def size(values: Any) -> int:
    """Bytes of all arrays."""
    if isinstance(values, (list, tuple)):
        return sum(size(value) for value in values)
    return values.numel() * values.element_size() if hasattr(values, "element_size") else 0
