"""Trajectories of objects over the skin: poses joined by smooth segments."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import numpy as np

from ninedtact.errors import InputError
from ninedtact.mechanics.pose import Pose


class InvalidTrajectory(InputError):
    """Raised for a trajectory without segments, or a segment that takes no time."""


@dataclass(frozen=True)
class TrajectorySegment:
    """A smooth movement to a pose within a given time."""

    to: Pose
    seconds: float

    def __post_init__(self) -> None:
        if not self.seconds > 0:
            raise InvalidTrajectory(
                f"expected a segment that takes time, got {self.seconds} s; give it a duration above zero"
            )


@dataclass(frozen=True)
class Trajectory:
    """Segments one after the other, from a first pose."""

    start: Pose
    segments: tuple[TrajectorySegment, ...]

    @property
    def duration_s(self) -> float:
        """The duration of the whole trajectory."""
        return self.ends_s[-1] if self.segments else 0.0

    @cached_property
    def ends_s(self) -> list[float]:
        """The end time of each segment."""
        return list(accumulate(segment.seconds for segment in self.segments))

    @property
    def lift_start_s(self) -> float:
        """The time at which the final lift begins: the end of the last segment that ends in the skin; zero for none."""
        pressed = [end for end, segment in zip(self.ends_s, self.segments, strict=True) if segment.to.depth_mm > 0]
        return pressed[-1] if pressed else 0.0

    def pose_at(self, at_s: float) -> Pose:
        """Return the pose at a time; before the start and after the end the object rests."""
        if at_s <= 0 or not self.segments:
            return self.start
        number = bisect_right(self.ends_s, at_s)
        if number == len(self.segments):
            return self.segments[-1].to
        segment, before = self.segments[number], self.segments[number - 1].to if number else self.start
        part = 1 - (self.ends_s[number] - at_s) / segment.seconds
        return before.interpolate(segment.to, _smoothstep(part))

    def sample_poses(self, hz: float) -> Iterator[Pose]:
        """Yield all poses at this rate, the last one included."""
        for number in range(int(np.ceil(self.duration_s * hz)) + 1):
            yield self.pose_at(number / hz)


def _smoothstep(part: float) -> float:
    """Return 3t² − 2t³, which starts and stops with zero slope."""
    return part * part * (3 - 2 * part)


HOVER_MM = 0.5
"""Height above the skin at which an object waits."""


def press_trajectory(
    at: Pose,
    drag_mm: tuple[float, float] = (0.0, 0.0),
    twist_rad: float = 0.0,
    tilt_rad: tuple[float, float] = (0.0, 0.0),
    pause_s: float = 0.4,
    speed: float = 1.0,
) -> Trajectory:
    """Return a trajectory that comes down, presses to the depth of a pose, drags, twists, tilts and lifts.

    at: pose of the press. drag_mm: (x, y). tilt_rad: about x and y. speed: 1 is about 1.5 mm/s, as a calm hand presses.
    """
    above = replace(at, depth_mm=-HOVER_MM)
    dragged = replace(at, x_mm=at.x_mm + drag_mm[0], y_mm=at.y_mm + drag_mm[1])
    twisted = replace(dragged, twist_rad=at.twist_rad + twist_rad)
    tilted = replace(twisted, tilt_x_rad=at.tilt_x_rad + tilt_rad[0], tilt_y_rad=at.tilt_y_rad + tilt_rad[1])
    stations = [(at, 1.2), (dragged, 0.9), (twisted, 0.9), (tilted, 0.9)]
    segments = [TrajectorySegment(above, pause_s)]
    for to, seconds in stations:
        if to != segments[-1].to:
            segments.append(TrajectorySegment(to, seconds / speed))
    lifted = replace(segments[-1].to, depth_mm=-HOVER_MM)
    return Trajectory(above, (*segments, TrajectorySegment(lifted, 0.8 / speed), TrajectorySegment(lifted, pause_s)))


def concatenate_trajectories(trajectories: Sequence[Trajectory], between_s: float = 0.3) -> Trajectory:
    """Return one trajectory after the other, joined above the skin; raises `InvalidTrajectory` for none."""
    if not trajectories:
        raise InvalidTrajectory("expected at least one trajectory, got none; give some")
    segments: list[TrajectorySegment] = []
    for trajectory in trajectories:
        if segments:
            segments.append(TrajectorySegment(trajectory.start, between_s))
        segments += trajectory.segments
    return Trajectory(trajectories[0].start, tuple(segments))
