"""Motions of an object in a hand over a twin, image by image, with the true state of slip of each.

A motion is a generator: it yields the next pose and receives the press there, because a hanging object moves as its load demands.
The true state is *gross* where less than 2 % of the contact sticks and it slides at more than 0.5 mm/s, *incipient* where less than
0.7 of the contact sticks, otherwise *static*. An object at rest after it slid is therefore incipient while its load along the skin
is still all that friction bears.
"""

from collections.abc import Generator, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose, rigid_displacement_mm
from ninedtact.simulation.press import Press
from ninedtact.simulation.trajectory import HOVER_MM
from ninedtact.simulation.twin import Twin

HZ = 60.0
"""Images per second."""
INCIPIENT_BELOW_SHARE, SLIDES_BELOW_SHARE, SLIDES_ABOVE_MM_PER_S = 0.7, 0.02, 0.5
_DIRECTION = np.array([1.0, 0.3])
"""Direction of a drag."""
_PRESS_IMAGES, _REST_IMAGES = 10, 12
_TURN_RAD = np.radians(60)
_ROLL_RAD, _ROLL_RADIUS_MM = np.radians(6), 6.0
_FALL_MM_PER_S = 8.0
"""Speed at which a hanging object falls at most."""

Motion = Generator[Pose, Press, None]


@dataclass(frozen=True)
class TrueSlip:
    """What a twin knows of the slip of one image."""

    state: str
    """static, incipient, gross, or unknown without contact."""
    sticking_share: float
    speed_mm_s: float
    """Mean speed of the object over the skin, weighted by pressure."""


@dataclass(frozen=True)
class MotionStep:
    """One image of a motion."""

    press: Press
    slip: TrueSlip


def play_motion(twin: Twin, indenter: Indenter, motion: Motion) -> Iterator[MotionStep]:
    """Yield the steps of a motion over undeformed skin; raises what `Twin.press` raises."""
    last, pose = None, next(motion)
    while True:
        press = twin.press(last, indenter, pose, after_s=0.0 if last is None else 1 / HZ)
        yield MotionStep(press, true_slip(last, press))
        last = press
        try:
            pose = motion.send(press)
        except StopIteration:
            return


def true_slip(last: Press | None, press: Press, after_s: float = 1 / HZ) -> TrueSlip:
    """Return the true state: the share that sticks, and how fast the object's points move over the skin.

    after_s: time from the last press to this one, above zero.
    """
    if last is None or press.slip_share is None:
        return TrueSlip("unknown" if press.slip_share is None else "static", 1.0, 0.0)
    before, now = last.solved, press.solved
    # The skin moves with the object: both are compared on the grid, whose middle is the object's origin.
    origin = replace(before.pose, x_mm=0.0, y_mm=0.0)
    moved = replace(now.pose, x_mm=now.pose.x_mm - before.pose.x_mm, y_mm=now.pose.y_mm - before.pose.y_mm)
    carried = before.tangential_mm + rigid_displacement_mm(origin, moved, now.skin.positions_mm)
    weight = np.where(before.pressure_mpa > 0, now.pressure_mpa, 0)
    slid_mm = np.hypot(*(carried - now.tangential_mm))
    slid_mean_mm, share = float((weight * slid_mm).sum() / max(weight.sum(), 1e-12)), 1 - press.slip_share
    speed = slid_mean_mm / after_s
    if share < SLIDES_BELOW_SHARE and speed > SLIDES_ABOVE_MM_PER_S:
        return TrueSlip("gross", share, speed)
    return TrueSlip("incipient" if share < INCIPIENT_BELOW_SHARE else "static", share, speed)


@dataclass(frozen=True)
class MotionSettings:
    """One object in a hand."""

    start: Pose
    """Where it comes down; its depth is that of the press."""
    speed_mm_s: float
    friction: float
    """That of the twin; a hanging object weighs 0.6 of what it bears at first."""
    direction_rad: float = 0.0
    """Direction of the drags, counted from one of 17° from x."""

    def drag(self, last: Pose, by_mm: float) -> list[Pose]:
        """Return the poses of a drag."""
        count = max(round(abs(by_mm) * HZ / self.speed_mm_s), 1)
        cos, sin = np.cos(self.direction_rad), np.sin(self.direction_rad)
        along = np.array([[cos, -sin], [sin, cos]]) @ _DIRECTION * by_mm
        end = replace(last, x_mm=last.x_mm + float(along[0]), y_mm=last.y_mm + float(along[1]))
        return _between(last, end, count)

    @property
    def pressed(self) -> list[Pose]:
        """The poses of the press."""
        start = self.start
        down = [replace(start, depth_mm=start.depth_mm * (step + 1) / _PRESS_IMAGES) for step in range(_PRESS_IMAGES)]
        return down + [start] * _REST_IMAGES

    def poses(self, kind: str) -> list[Pose]:
        """Return the poses of a motion that is known beforehand."""
        pressed, start = self.pressed, self.start
        there = pressed + self.drag(start, 2.6)
        if kind == "slide":
            return there + [there[-1]] * 10
        if kind == "reverse":
            back = there + [there[-1]] * 6
            return back + self.drag(back[-1], -2.6)
        if kind == "stick_slip":
            jerky = list(pressed)
            for _ in range(5):
                jerky += self.drag(jerky[-1], 0.6)
                jerky += [jerky[-1]] * 8
            return jerky
        if kind == "tighten":
            tighter = pressed + self.drag(start, 0.6)
            tighter += _between(tighter[-1], replace(tighter[-1], depth_mm=1.3 * start.depth_mm), 20)
            return tighter + self.drag(tighter[-1], 1.8)
        if kind == "twist":
            turned = pressed + _between(start, replace(start, twist_rad=start.twist_rad + _TURN_RAD), 60)
            return turned + [turned[-1]] * 10
        if kind == "roll":
            angles = [*np.linspace(0, 1, 20), *np.linspace(1, -1, 40)]
            return pressed + [_rolled(start, _ROLL_RAD * float(part)) for part in angles]
        assert kind == "regrasp", kind
        moved = pressed + self.drag(start, 0.4)
        above = replace(moved[-1], depth_mm=-HOVER_MM)
        again = replace(start, y_mm=start.y_mm + 0.8)
        lifted = moved + _between(moved[-1], above, 8) + _between(above, replace(again, depth_mm=-HOVER_MM), 8)
        return lifted + _between(lifted[-1], again, 10) + [again] * 10 + self.drag(again, 1.5)

    def motion(self, kind: str) -> Motion:
        """Return the motion of one of `MOTION_KINDS`."""
        return self._hang() if kind == "hang" else self._follow(kind)

    def _follow(self, kind: str) -> Motion:
        poses = self.poses(kind)
        while poses:
            yield poses.pop(0)

    def _hang(self) -> Motion:
        """Hang in a grip that weakens: the object moves along x until the skin bears its weight."""
        pressed, depth_mm = self.pressed, self.start.depth_mm
        for pose in pressed:
            press = yield pose
        weight_n = 0.6 * self.friction * float(press.load_n)
        for number in range(len(pressed), 110):
            missing_n = weight_n - float(press.wrench.force_n[0])
            # A load that is borne to 3 % holds it: smaller steps would be less than the tolerance of the twin's solver.
            step_mm = float(np.clip(0.5 * missing_n, 0.0, _FALL_MM_PER_S / HZ)) if missing_n > 0.03 * weight_n else 0.0
            weakening = float(np.clip((number - 50) / 60, 0, 0.7))
            pose = replace(press.pose, x_mm=press.pose.x_mm + step_mm, depth_mm=depth_mm * (1 - weakening))
            if pose.x_mm > self.start.x_mm + 4.0:
                return
            press = yield pose


MOTION_KINDS = "slide", "reverse", "stick_slip", "tighten", "hang", "twist", "roll", "regrasp"
"""Dragged until it slides; dragged back; dragged and stopped again and again; pressed deeper on the way; hung in a grip that
weakens as it is handed over; turned by 60°; rolled by 6° to and fro; lifted and pressed elsewhere."""


def _between(start: Pose, end: Pose, count: int) -> list[Pose]:
    return [start.interpolate(end, (number + 1) / count) for number in range(count)]


def _rolled(start: Pose, angle_rad: float) -> Pose:
    """Return the pose after the object was rolled about an axis along y at some height above the skin."""
    up_mm, along_mm = _ROLL_RADIUS_MM * (1 - np.cos(angle_rad)), _ROLL_RADIUS_MM * (angle_rad - np.sin(angle_rad))
    x_mm, depth_mm = start.x_mm + float(along_mm), start.depth_mm - float(up_mm)
    return replace(start, x_mm=x_mm, depth_mm=depth_mm, tilt_y_rad=start.tilt_y_rad + angle_rad)
