"""Time on a stage: one clock for all devices that watch it, and the moments at which each device looks."""

from dataclasses import dataclass, field
from threading import Lock
from time import monotonic_ns, sleep


@dataclass
class Clock:
    """Began when the first device was opened, and stands again when the last is closed."""

    real_time: bool = True
    """If not, nobody waits: moments follow each other as fast as they are asked for, with the stamps of a real clock."""
    began_ns: int = field(default=0, init=False)
    watchers: int = field(default=0, init=False)
    lock: Lock = field(default_factory=Lock, init=False, repr=False)

    def join(self) -> bool:
        """One more device looks; whether it is the first, so that time begins now."""
        with self.lock:
            self.watchers += 1
            if self.watchers == 1:
                self.began_ns = monotonic_ns()
            return self.watchers == 1

    def leave(self) -> None:
        """One device fewer."""
        with self.lock:
            self.watchers -= 1


@dataclass
class Pace:
    """The moments of one device that runs at a fixed rate, counted from the clock's beginning."""

    clock: Clock
    hz: float
    number: int = field(default=-1, init=False)

    def restart(self) -> None:
        """The next moment is the first one that is not past."""
        self.number = -1

    def next(self) -> tuple[int, int]:
        """Number and stamp of the next moment; in real time those that are past are skipped, as a device would lose them."""
        self.number += 1
        if self.clock.real_time:
            self.number = max(self.number, self.present)
            sleep(max(0.0, (self.stamp_ns(self.number) - monotonic_ns()) / 1e9))
        return self.number, self.stamp_ns(self.number)

    @property
    def present(self) -> int:
        """Number of the moment that was last."""
        return int((monotonic_ns() - self.clock.began_ns) * self.hz / 1e9)

    def stamp_ns(self, number: int) -> int:
        """When a moment is."""
        return self.clock.began_ns + round(number * 1e9 / self.hz)
