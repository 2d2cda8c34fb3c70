"""Sessions that go on in step: whoever looks is shown, then whoever steps is stepped, all at once.

Which sessions are under way together is fixed beforehand, and each goes on by itself, so it does not matter who answers first.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

from ninedtact.simulation.batched.requests import Asked, Asking, Look, told
from ninedtact.simulation.batched.room import Room


@runtime_checkable
class Session(Protocol):
    """A sequence of requests to simulated sensors, each of which waits for the response to the one before."""

    number: int

    def asking(self) -> Asking[Any]:
        """Yield requests and receive their responses."""
        ...


@dataclass
class Seat:
    """A session under way."""

    session: Session
    asking: Asking[Any] = field(init=False)
    asked: Asked | None = field(init=False)
    """None: it is over."""

    def __post_init__(self) -> None:
        self.asking = self.session.asking()
        self.asked = next(self.asking, None)

    def go_on(self, answer: Any) -> None:
        """To the next question. Noise and PNG are made here, in a thread of its own."""
        if isinstance(answer, Asked):
            self.asked = answer
            return
        try:
            self.asked = told(self.asking, answer)
        except StopIteration:
            self.asked = None


def play(sessions: Sequence[Session], room: Room, threads: int) -> Iterator[set[int]]:
    """All sessions to their ends; after each batch the numbers of those that are still under way."""
    with ThreadPoolExecutor(threads) as pool:
        seats = list(pool.map(Seat, sessions))
        while seats:
            asking = [seat for seat in seats if isinstance(seat.asked, Look)] or seats
            answers = room.answers([seat.asked for seat in asking if seat.asked is not None])
            list(pool.map(Seat.go_on, asking, answers))
            seats = [seat for seat in seats if seat.asked is not None]
            yield {seat.session.number for seat in seats}
