"""Time on a stage: one clock for all devices that watch it, and the moments at which each device looks.

One motion that everything watches: the camera, the force/torque sensor, and whoever wants the truth.
"""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from threading import Lock, RLock
from time import monotonic_ns, sleep

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.frame_source import SourceEnded
from ninedtact.errors import NinedtactError
from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.indenter import Indenter
from ninedtact.simulation.trajectory import Trajectory
from ninedtact.simulation.twin import Twin


@dataclass
class SimulationClock:
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
class SampleTimer:
    """The moments of one device that runs at a fixed rate, counted from the clock's beginning."""

    clock: SimulationClock
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


KEPT_CONTACTS, KEPT_WRENCHES = 16, 1024
"""The newest steps that may be asked for again."""


class EmptyPressSimulation(NinedtactError):
    """Nothing happens on a stage."""


class SimulationStepExpired(NinedtactError):
    """A step was asked for that is too long ago."""


@dataclass(frozen=True)
class ObjectTrajectory:
    """One object and what it does."""

    indenter: Indenter
    motion: Trajectory


@dataclass
class PressSimulation:
    """A twin on which acts follow each other, round after round, solved step by step as they are asked for.

    Sources may ask from several threads; each step is solved once. In real time steps that nobody waited for are skipped,
    so that slow solving makes the motion coarser and never late. Otherwise every step is solved, and a stage gives the
    same answers every time it begins.
    """

    twin: Twin
    acts: Sequence[ObjectTrajectory]
    hz: float = 30.0
    """Steps per second of the motion, and images per second of a camera that watches it."""
    real_time: bool = True
    rounds: int | None = None
    """After so many the sources end; None: never."""
    clock: SimulationClock = field(init=False)
    contacts: dict[int, Contact] = field(default_factory=dict, init=False, repr=False)
    """The newest steps, by number, ascending; the one before all is untouched skin."""
    wrenches: dict[int, Float64[Array, "6"]] = field(default_factory=dict, init=False, repr=False)
    """About the skin's centre."""
    lock: RLock = field(default_factory=RLock, init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.acts or not self.seconds > 0 or not self.hz > 0:
            raise EmptyPressSimulation(
                f"expected acts that take time and a rate, got {len(self.acts)} at {self.hz} Hz; add some"
            )
        self.clock = SimulationClock(self.real_time)

    @cached_property
    def ends_s(self) -> list[float]:
        """When each act of a round ends."""
        return list(accumulate(act.motion.seconds for act in self.acts))

    @property
    def seconds(self) -> float:
        """Length of one round."""
        return self.ends_s[-1]

    def join(self) -> None:
        """A source was opened; the first one begins the motion."""
        with self.lock:
            if self.clock.join():
                self.contacts.clear()
                self.wrenches.clear()

    def require_time(self, at_s: float) -> None:
        """Refuse a time after the last round; raises `SourceEnded`."""
        if self.rounds is not None and at_s >= self.rounds * self.seconds:
            raise SourceEnded(f"expected a time in {self.rounds} rounds of the stage, got {at_s:.1f} s; it is over")

    def contact(self, number: int) -> Contact:
        """The skin at this step; in real time, at the nearest step that was not skipped. Raises `SimulationStepExpired`."""
        with self.lock:
            self.solve_to(number)
            if self.real_time and number >= next(iter(self.contacts)):
                number = min(self.contacts, key=lambda step: abs(step - number))
            if number not in self.contacts:
                raise self.forgotten(number, self.contacts)
            return self.twin.felt(self.contacts[number])

    def six(self, at_s: float) -> Float64[Array, "6"]:
        """The true wrench about the skin's centre at this time, straight between steps; raises `SimulationStepExpired`."""
        step = at_s * self.hz
        with self.lock:
            self.solve_to(int(step))
            self.solve_to(int(np.ceil(step)))
            known = list(self.wrenches)
            if step < known[0]:
                raise self.forgotten(int(step), self.wrenches)
            after = bisect_left(known, step)
            one, other = known[max(after - 1, 0)], known[after]
        part = (step - one) / max(other - one, 1)
        return np.asarray((1 - part) * self.wrenches[one] + part * self.wrenches[other])

    def solve_to(self, number: int) -> None:
        """Solve what is missing up to this step."""
        newest = next(reversed(self.contacts), -1)
        missing = range(newest + 1, number + 1)
        for step in missing[-1:] if self.real_time else missing:
            self.keep(step, self.stepped(newest, step))
            newest = step

    def keep(self, step: int, contact: Contact) -> None:
        """Remember a step, and forget the oldest."""
        self.contacts[step], self.wrenches[step] = contact, self.twin.felt(contact).wrench().six
        for memory, kept in ((self.contacts, KEPT_CONTACTS), (self.wrenches, KEPT_WRENCHES)):
            if len(memory) > kept:
                del memory[next(iter(memory))]

    def stepped(self, newest: int, step: int) -> Contact:
        """The skin at a step after the newest one; every act starts on untouched skin."""
        number, within_s = self.act_at(step / self.hz)
        goes_on = newest >= 0 and self.act_at(newest / self.hz)[0] == number
        last = self.contacts[newest] if goes_on else self.twin.model.untouched()
        act = self.acts[number % len(self.acts)]
        return self.twin.step(last, act.indenter, act.motion.pose(within_s))

    def act_at(self, at_s: float) -> tuple[int, float]:
        """Number of the act at this time, counted through all rounds, and the time since it began."""
        rounds, within_s = divmod(at_s, self.seconds)
        index = min(int(np.searchsorted(self.ends_s, within_s, side="right")), len(self.acts) - 1)
        return int(rounds) * len(self.acts) + index, within_s - (self.ends_s[index - 1] if index else 0.0)

    def forgotten(self, step: int, memory: dict[int, Contact] | dict[int, Array]) -> SimulationStepExpired:
        """What is said of a step too long ago."""
        return SimulationStepExpired(
            f"expected a step of the stage from {next(iter(memory))} on, got {step}, which is forgotten; open all sources "
            "together, and read them in turn"
        )
