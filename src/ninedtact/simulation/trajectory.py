"""Where an object goes over the skin: waypoints joined by smooth moves."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import numpy as np

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.pose import Pose


class InvalidTrajectory(NinedtactError):
    """A motion that no hand can make."""


@dataclass(frozen=True)
class TrajectorySegment:
    """Go to a pose within this time."""

    to: Pose
    seconds: float

    def __post_init__(self) -> None:
        if not self.seconds > 0:
            raise InvalidTrajectory(f"expected a move to take time, got {self.seconds} s; give it some")


@dataclass(frozen=True)
class Trajectory:
    """Moves one after the other, from a first pose."""

    start: Pose
    moves: tuple[TrajectorySegment, ...]

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return self.ends_s[-1] if self.moves else 0.0

    @cached_property
    def ends_s(self) -> list[float]:
        """When each move ends."""
        return list(accumulate(move.seconds for move in self.moves))

    @property
    def lifted_s(self) -> float:
        """When the object is about to be lifted for good: the end of the last move that ends in the skin; zero for none."""
        pressed = [end for end, move in zip(self.ends_s, self.moves, strict=True) if move.to.depth_mm > 0]
        return pressed[-1] if pressed else 0.0

    def pose(self, at_s: float) -> Pose:
        """Where the object is at this time; it stays at its ends before and after."""
        if at_s <= 0 or not self.moves:
            return self.start
        number = bisect_right(self.ends_s, at_s)
        if number == len(self.moves):
            return self.moves[-1].to
        move, before = self.moves[number], self.moves[number - 1].to if number else self.start
        part = 1 - (self.ends_s[number] - at_s) / move.seconds
        return before.towards(move.to, _smoothstep(part))

    def poses(self, hz: float) -> Iterator[Pose]:
        """All poses at this rate, the last one included."""
        for number in range(int(np.ceil(self.seconds * hz)) + 1):
            yield self.pose(number / hz)


def _smoothstep(part: float) -> float:
    """Start and stop gently."""
    return part * part * (3 - 2 * part)


HOVER_MM = 0.5
"""How far above the skin an object waits."""


def press_trajectory(
    at: Pose,
    drag_mm: tuple[float, float] = (0.0, 0.0),
    twist_rad: float = 0.0,
    tilt_rad: tuple[float, float] = (0.0, 0.0),
    pause_s: float = 0.4,
    speed: float = 1.0,
) -> Trajectory:
    """Come down, press to the pose's depth, drag, twist, tilt, and lift.

    at: where to press. speed: 1 is a calm hand, about 1.5 mm/s.
    """
    above = replace(at, depth_mm=-HOVER_MM)
    dragged = replace(at, x_mm=at.x_mm + drag_mm[0], y_mm=at.y_mm + drag_mm[1])
    twisted = replace(dragged, twist_rad=at.twist_rad + twist_rad)
    tilted = replace(twisted, tilt_x_rad=at.tilt_x_rad + tilt_rad[0], tilt_y_rad=at.tilt_y_rad + tilt_rad[1])
    stations = [(at, 1.2), (dragged, 0.9), (twisted, 0.9), (tilted, 0.9)]
    moves = [TrajectorySegment(above, pause_s)]
    for to, seconds in stations:
        if to != moves[-1].to:
            moves.append(TrajectorySegment(to, seconds / speed))
    lifted = replace(moves[-1].to, depth_mm=-HOVER_MM)
    return Trajectory(above, (*moves, TrajectorySegment(lifted, 0.8 / speed), TrajectorySegment(lifted, pause_s)))


def concatenate_trajectories(motions: Sequence[Trajectory], between_s: float = 0.3) -> Trajectory:
    """One motion after the other, the way from one to the next made above the skin; raises `InvalidTrajectory` for none."""
    if not motions:
        raise InvalidTrajectory("expected at least one motion, got none; give some")
    moves: list[TrajectorySegment] = []
    for motion in motions:
        if moves:
            moves.append(TrajectorySegment(motion.start, between_s))
        moves += motion.moves
    return Trajectory(motions[0].start, tuple(moves))
