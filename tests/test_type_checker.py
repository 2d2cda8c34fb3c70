"""The types and shapes of every call are checked while the tests run."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from jaxtyping import Float
from numpy import ndarray as Array

from type_checker import begin_test, check_calls, checked

check = check_calls(typechecker=checked)


@check
def halve(points: Float[Array, "n 2"], weight: float = 0.5, *, whole: bool = False) -> Float[Array, " n"]:
    """Give the first column, weighted, or all rows but one."""
    return weight * (points[1:, 0] if whole else points[:, 0])


@check
def plain(number: int) -> int:
    """Give half a number, which is another type."""
    return number if number % 2 else number / 2  # type: ignore[return-value]


@check
@dataclass(frozen=True)
class Pair:
    """Two columns of the same length."""

    one: Float[Array, " n"]
    other: Float[Array, " n"]

    @property
    @check
    def length(self) -> str:
        """Give a number, which is another type."""
        return len(self.one)  # type: ignore[return-value]

    @classmethod
    @check
    def twice(cls, one: Float[Array, " n"]) -> "Pair":
        """Give a pair of the same column."""
        return cls(one, one)


COLUMN, POINTS = np.zeros(3), np.zeros((3, 2))


def test_calls_as_annotated_pass() -> None:
    assert halve(POINTS, 1).shape == (3,) and plain(3) == 3
    assert Pair.twice(COLUMN).one is COLUMN


@pytest.mark.parametrize(
    "call",
    [
        lambda: halve(COLUMN),  # a missing axis
        lambda: halve(POINTS[:, :1]),  # an axis of another length
        lambda: halve(POINTS.astype(int)),
        lambda: halve(POINTS, "0.5"),
        lambda: halve(POINTS, whole=True),  # an answer with another length of the same axis
        lambda: plain(2.0),
        lambda: plain(2),
        lambda: Pair(COLUMN, COLUMN[:2]),
        lambda: Pair.twice(POINTS),
        lambda: Pair.twice(COLUMN).length,
    ],
)
def test_other_calls_are_refused(call: Callable[[], object]) -> None:
    with pytest.raises(Exception, match=r"violat|Type-check"):
        call()


def test_ever_fewer_calls_in_a_test_are_checked() -> None:
    def refused() -> bool:
        try:
            plain(2)
        except Exception:
            return True
        return False

    assert [number for number in range(1, 101) if refused()] == [1, 2, 4, 8, 16, 32, 64]
    begin_test()
    assert refused()
