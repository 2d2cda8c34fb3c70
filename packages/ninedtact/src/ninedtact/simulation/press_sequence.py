"""The clock of a twin that objects press one after the other, which its simulated sources share (`Twin.press` presses them).

`PressSequence` solves its steps when a source needs them: the camera, the force/torque sensor and the ground truth of one
simulation agree with each other. `SampleTimer` gives the moments at which a source samples.
"""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from threading import Lock, RLock
from time import monotonic_ns, sleep
from typing import Annotated

import numpy as np
from jaxtyping import Float64
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.capture.frame_source import SourceEnded
from ninedtact.errors import SimulationError
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Indenter
from ninedtact.simulation.hand_moved_object import SimulatedHand
from ninedtact.simulation.press import Press
from ninedtact.simulation.trajectory import Trajectory
from ninedtact.simulation.twin import Twin


@dataclass
class SimulationClock:
    """The common clock of simulated sources; it starts when the first is opened and stops when the last is closed."""

    real_time: bool = True
    """Whether sources wait in real time. If false, samples follow each other as fast as they are read, with the stamps of a real
    clock."""
    start_ns: int = field(default=0, init=False)
    sources: int = field(default=0, init=False)
    lock: Lock = field(default_factory=Lock, init=False, repr=False)

    def join(self) -> bool:
        """Add an open source, and return whether it is the first, so that time starts now."""
        with self.lock:
            self.sources += 1
            if self.sources == 1:
                self.start_ns = monotonic_ns()
            return self.sources == 1

    def leave(self) -> None:
        """Remove a source that was closed."""
        with self.lock:
            self.sources -= 1


@dataclass
class SampleTimer:
    """The sampling times of one source with a fixed rate, counted from the start of the clock."""

    clock: SimulationClock
    hz: float
    number: int = field(default=-1, init=False)

    def restart(self) -> None:
        """Continue with the first sample that is not past."""
        self.number = -1

    def next(self) -> tuple[int, int]:
        """Wait for the next sample and return its number and stamp; in real time, samples that are past are skipped."""
        self.number += 1
        if self.clock.real_time:
            self.number = max(self.number, self.current_number)
            sleep(max(0.0, (self.stamp_ns(self.number) - monotonic_ns()) / 1e9))
        return self.number, self.stamp_ns(self.number)

    @property
    def current_number(self) -> int:
        """The number of the newest sample that is due."""
        return int((monotonic_ns() - self.clock.start_ns) * self.hz / 1e9)

    def stamp_ns(self, number: int) -> int:
        """Return the time of a sample in ns."""
        return self.clock.start_ns + round(number * 1e9 / self.hz)


KEPT_PRESSES, KEPT_WRENCHES = 48, 1024
"""Number of the newest steps that are stored."""


@checks_arguments
@dataclass(frozen=True)
class ObjectTrajectory:
    """An object and the trajectory that it follows."""

    indenter: Indenter
    trajectory: Trajectory


@checks_arguments
@dataclass
class PressSequence:
    """A twin on which trajectories follow each other, round after round, solved step by step when a step is needed.

    Sources may read from several threads; each step is solved once. In real time, steps that no source waited for are skipped,
    so that a slow solver makes the motion coarser but never late. Otherwise every step is solved, and the simulation repeats
    itself exactly each time it starts. While `hand` holds an object, that object is pressed instead of those of the trajectories.
    """

    twin: Twin
    trajectories: Sequence[ObjectTrajectory]
    hz: Annotated[float, Meta(gt=0, le=1e6)] = 30.0
    """Steps per second of the motion, and images per second of the simulated camera."""
    real_time: bool = True
    rounds: Annotated[int, Meta(ge=1)] | None = None
    """Number of rounds after which the sources end; None: they never end."""
    hand: SimulatedHand = field(default_factory=SimulatedHand)
    """The object that a person moves instead; empty at the beginning."""
    clock: SimulationClock = field(init=False)
    presses: dict[int, Press] = field(default_factory=dict, init=False, repr=False)
    """The newest steps by number, ascending. The step before the first is undeformed skin."""
    wrenches: dict[int, Float64[Array, "6"]] = field(default_factory=dict, init=False, repr=False)
    """True wrenches of the newest steps about the centre of the skin, by number."""
    lock: RLock = field(default_factory=RLock, init=False, repr=False)
    _last_grasp: int = field(default=0, init=False)
    """The object in the hand that was pressed at the newest step, by its number; zero for one of the trajectories."""

    def __post_init__(self) -> None:
        if not self.trajectories or not self.round_s > 0:
            raise SimulationError(
                expected="trajectories that take time", got=f"{len(self.trajectories)}", remedy="add a trajectory"
            )
        self.clock = SimulationClock(self.real_time)

    @cached_property
    def ends_s(self) -> list[float]:
        """The end time of each trajectory of a round."""
        return list(accumulate(item.trajectory.duration_s for item in self.trajectories))

    @property
    def round_s(self) -> float:
        """The duration of one round."""
        return self.ends_s[-1]

    def join(self) -> None:
        """Add a source that was opened; the first one starts the motion."""
        with self.lock:
            if self.clock.join():
                self.presses.clear()
                self.wrenches.clear()

    def require_time(self, at_s: float) -> None:
        """Refuse a time after the last round; raises `SourceEnded`."""
        if self.rounds is not None and at_s >= self.rounds * self.round_s:
            raise SourceEnded(
                expected=f"a time within the {self.rounds} rounds of the simulation",
                got=f"{at_s:.1f} s",
                remedy="it has ended",
            )

    def contact(self, number: int) -> Contact:
        """Return the contact at a step, as it is rendered and measured; raises what `press` raises."""
        return self.press(number).corrected

    def press(self, number: int) -> Press:
        """Return the press at a step.

        In real time it is that at the nearest step that is stored, which is later than asked for after a long wait. Raises
        `SimulationError` where every step is solved.
        """
        with self.lock:
            self._solve_to(number)
            if self.real_time:
                number = self._nearest(number)
            if number not in self.presses:
                raise self._step_expired(number, next(iter(self.presses)))
            return self.presses[number]

    def press_at(self, stamp_ns: int) -> Press | None:
        """Return the press that the camera saw at a time; None where that step is no longer stored."""
        number = round((stamp_ns - self.clock.start_ns) * self.hz / 1e9)
        with self.lock:
            if not self.presses or not next(iter(self.presses)) <= number <= next(reversed(self.presses)):
                return None
            return self.presses[self._nearest(number)]

    def _nearest(self, number: int) -> int:
        return min(self.presses, key=lambda step: abs(step - number))

    def wrench_six_at(self, at_s: float) -> Float64[Array, "6"]:
        """Return the true wrench (N, N·m) about the centre of the skin at a time, interpolated linearly between steps.

        While an object is held in the hand in real time, it is that of the last step: where the hand will be at the next one is
        not known yet. Raises `SimulationError`.
        """
        step = at_s * self.hz
        with self.lock:
            self._solve_to(int(step))
            if not (self.real_time and self.hand.held_object is not None):
                self._solve_to(int(np.ceil(step)))
            known = list(self.wrenches)
            is_first_solved = self.real_time and len(known) < KEPT_WRENCHES  # no step before was ever solved
            if step < known[0] and not is_first_solved:
                raise self._step_expired(int(step), known[0])
            step = min(step, known[-1])
            after = bisect_left(known, step)
            one, other = known[max(after - 1, 0)], known[after]
        part = (step - one) / max(other - one, 1)
        return np.asarray((1 - part) * self.wrenches[one] + part * self.wrenches[other])

    def _solve_to(self, number: int) -> None:
        """Solve the missing steps up to this one; in real time only this one."""
        newest = next(reversed(self.presses), -1)
        missing = range(newest + 1, number + 1)
        for step in missing[-1:] if self.real_time else missing:
            press = self._solve_step(newest, step)
            self.presses[step], self.wrenches[step], newest = press, press.wrench.six, step
            if len(self.presses) > KEPT_PRESSES:
                del self.presses[next(iter(self.presses))]
            if len(self.wrenches) > KEPT_WRENCHES:
                del self.wrenches[next(iter(self.wrenches))]

    def _solve_step(self, newest: int, step: int) -> Press:
        """Return the press at a step after the newest one; every object starts on undeformed skin."""
        grasp, held = self.hand.grasp
        before, self._last_grasp = self._last_grasp, 0 if held is None else grasp
        if held is not None:
            continues = newest >= 0 and before == grasp
            last = self.presses[newest] if continues else self.hand.hover(self.twin, held)
            return self.hand.step(self.twin, last, held, (step - newest) / self.hz if continues else 0.0)
        number, within_s = self.trajectory_at(step / self.hz)
        continues = newest >= 0 and before == 0 and self.trajectory_at(newest / self.hz)[0] == number
        item = self.trajectories[number % len(self.trajectories)]
        after_s = (step - newest) / self.hz if continues else 0.0
        return self.twin.press(
            self.presses[newest] if continues else None,
            item.indenter,
            item.trajectory.pose_at(within_s),
            after_s=after_s,
        )

    def trajectory_at(self, at_s: float) -> tuple[int, float]:
        """Return the number of the trajectory at a time, counted through all rounds, and the time since it began."""
        rounds, within_s = divmod(at_s, self.round_s)
        index = min(int(np.searchsorted(self.ends_s, within_s, side="right")), len(self.trajectories) - 1)
        return int(rounds) * len(self.trajectories) + index, within_s - (self.ends_s[index - 1] if index else 0.0)

    def _step_expired(self, step: int, oldest: int) -> SimulationError:
        return SimulationError(
            expected=f"a step of the simulation from {oldest} on",
            got=f"{step}, which is no longer stored",
            remedy="open all sources together, and read them in turn",
        )
