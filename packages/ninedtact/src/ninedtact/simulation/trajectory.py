"""Motions of an object over a twin: trajectories, which are poses joined by smooth segments, and scripted presses, quasi-static
ones down to a depth or a load, then dragged and twisted.
"""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from typing import Annotated

import numpy as np
from msgspec import Meta

from ninedtact.bounds import checks_arguments
from ninedtact.errors import InputError
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.twin import Twin


@checks_arguments
@dataclass(frozen=True)
class TrajectorySegment:
    """A smooth movement to a pose within a given time."""

    to: Pose
    seconds: Annotated[float, Meta(gt=0, le=1e6)]


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

    def pose_at(self, at_s: float) -> Pose:
        """Return the pose at a time; before the start and after the end the object rests."""
        if at_s <= 0 or not self.segments:
            return self.start
        number = bisect_right(self.ends_s, at_s)
        if number == len(self.segments):
            return self.segments[-1].to
        segment, before = self.segments[number], self.segments[number - 1].to if number else self.start
        part = 1 - (self.ends_s[number] - at_s) / segment.seconds
        return before.interpolate(segment.to, part * part * (3 - 2 * part))  # starts and stops with zero slope


HOVER_MM = 0.5
"""Height above the skin at which an object waits."""


@checks_arguments
def press_trajectory(
    at: Pose,
    drag_mm: tuple[float, float] = (0.0, 0.0),
    twist_rad: float = 0.0,
    tilt_rad: tuple[float, float] = (0.0, 0.0),
    pause_s: Annotated[float, Meta(gt=0, le=1000)] = 0.4,
    speed: Annotated[float, Meta(gt=0, le=1000)] = 1.0,
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


_BETWEEN_S = 0.3
"""Time in which an object moves above the skin from one trajectory to the next."""


def concatenate_trajectories(trajectories: Sequence[Trajectory]) -> Trajectory:
    """Return one trajectory after the other, joined above the skin; raises `InputError` for none."""
    if not trajectories:
        raise InputError(expected="at least one trajectory", got="none", remedy="give some")
    segments: list[TrajectorySegment] = []
    for trajectory in trajectories:
        if segments:
            segments.append(TrajectorySegment(trajectory.start, _BETWEEN_S))
        segments += trajectory.segments
    return Trajectory(trajectories[0].start, tuple(segments))


DOWN_MM, ALONG_MM, ROUND_RAD = 0.5, 0.3, np.radians(4.0)
"""The longest steps of depth, drag and twist. Friction depends on the path, so steps must be small."""
PRESS_SOLVER_SETTINGS = SolverSettings(tolerance=2e-3)


@checks_arguments
@dataclass(frozen=True)
class ScriptedPress:
    """A press to a depth or to a load at a position, followed by a drag and a twist at that depth or load."""

    depth_mm: Annotated[float, Meta(gt=0)] | None = None
    load_n: Annotated[float, Meta(gt=0)] | None = None
    at_mm: tuple[float, float] = (0.0, 0.0)
    """Position of the first contact, x and y."""
    drag_mm: tuple[float, float] = (0.0, 0.0)
    twist_rad: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    """Tilts about x and y, which the object has from the beginning."""
    hold_s: Annotated[float, Meta(ge=0, le=1e6)] = 0.0
    """Time for which the object is held at the end, while the gel relaxes."""

    def __post_init__(self) -> None:
        if (self.depth_mm is None) == (self.load_n is None):
            got = "both" if self.depth_mm is not None else "neither"
            raise InputError(expected="a depth or a load", got=got, remedy="give one of them")

    def poses(self) -> Iterator[Pose]:
        """Yield all poses; those of a press to a load have depth zero, which `simulate` replaces."""
        depth = self.depth_mm or 0.0
        pressed = Pose(*self.at_mm, depth, 0.0, *self.tilt_rad)
        for number in range(1, _step_count(depth, DOWN_MM) + 1):
            yield replace(pressed, depth_mm=depth * number / _step_count(depth, DOWN_MM))
        (x, y), (along_x, along_y) = self.at_mm, self.drag_mm
        dragged = Pose(x + along_x, y + along_y, depth, self.twist_rad, *self.tilt_rad)
        # Drag and twist happen at the same time, as in a press by hand.
        many = max(_step_count(float(np.hypot(*self.drag_mm)), ALONG_MM), _step_count(abs(self.twist_rad), ROUND_RAD))
        if dragged != pressed:
            yield from (pressed.interpolate(dragged, number / many) for number in range(1, many + 1))

    @checks_arguments
    def simulate(
        self, twin: Twin, indenter: Indenter, solver_settings: SolverSettings | None = PRESS_SOLVER_SETTINGS
    ) -> Contact:
        """Return the contact at the end of the press; raises `InputError` and what `Twin.press` raises.

        solver_settings: None keeps those of the twin.
        """
        self._require_within_gel(twin)
        twin = twin if solver_settings is None else replace(twin, solver_settings=solver_settings)
        press = twin.hover(indenter, Pose())
        for pose in self.poses():
            deeper = pose if self.load_n is None else replace(pose, depth_mm=press.pose.depth_mm)
            press = twin.press(press, indenter, deeper, self.load_n)
        if self.hold_s:
            press = twin.press(press, indenter, press.pose, self.load_n, after_s=self.hold_s)
        return press.corrected

    def _require_within_gel(self, twin: Twin) -> None:
        """Refuse a depth at which the object would go through the gel; raises `InputError`."""
        if self.depth_mm is not None and self.depth_mm >= twin.gel.max_depth_mm:
            raise InputError(
                expected=f"a press less deep than the gel allows, {twin.gel.max_depth_mm:g} mm",
                got=f"{self.depth_mm:g} mm",
                remedy="press less",
            )


def _step_count(distance: float, longest: float) -> int:
    """Return the number of equal steps that are no longer than the longest."""
    return max(int(np.ceil(distance / longest - 1e-9)), 1)
