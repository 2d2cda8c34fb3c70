"""The path and turn of the object that touches a sensor of the page, and its slip; on a twin the true ones beside them.

Both begin where the object touched first. They are computed only while a browser is connected, because tracking takes time of the
sensor thread.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.reading import Reading
from ninedtact.simulation.press import Press
from ninedtact.tracking import ContactTracker, RigidMotion, SlipEstimate, TrackedContacts

SEEN_TURN_RAD = np.radians(45)
"""Standard deviation of a turn below which it is shown; a ball has 115°."""
_STEP_MM = 0.05
"""Distance of the points of a path."""
_MOST_POINTS = 300
"""Number of points from which every other one is left out."""
_KEPT = 8
"""Newest readings of which the result is kept, because the page shows one that is a little older."""


@dataclass(frozen=True)
class ObjectPath:
    """Where one point of the object went along the skin, and how far the object has turned about z."""

    places_mm: Float[Array, "n 2"]
    turn_rad: float
    """Not a number where it cannot be seen."""
    turn_std_rad: float = 0.0
    sticking_share: float = float("nan")

    @property
    def moved_mm(self) -> Float[Array, "2"]:
        """By how much the point has moved along x and y."""
        return self.places_mm[-1] - self.places_mm[0]

    def then(self, place_mm: Float[Array, "2"], turn_rad: float, std_rad: float, sticking_share: float) -> "ObjectPath":
        """Return the path with its end moved to another place."""
        kept = self.places_mm
        is_far = len(kept) < 2 or np.linalg.norm(kept[-1] - kept[-2]) >= _STEP_MM
        places_mm = np.vstack([kept if is_far else kept[:-1], place_mm])
        if len(places_mm) > _MOST_POINTS:
            places_mm = np.vstack([places_mm[:-1:2], place_mm])
        return ObjectPath(places_mm, turn_rad, std_rad, sticking_share)


@dataclass(frozen=True)
class FollowedObject:
    """What is known of the object in one reading."""

    stamp_ns: int = 0
    slip: SlipEstimate = SlipEstimate()
    seen: ObjectPath | None = None
    """None where nothing touches."""
    true: ObjectPath | None = None
    """That of the simulation; None for a sensor that is no twin."""


@dataclass
class ObjectFollower:
    """Follows the object through the readings of a sensor while somebody is interested."""

    press_at: Callable[[int], Press | None] = lambda stamp_ns: None
    """Returns what pressed the twin at a time; None where that is not known."""
    is_wanted: bool = False
    """Whether a browser is connected; set by the thread of the page."""
    _tracker: ContactTracker | None = field(default=None, init=False, repr=False)
    """None while nobody is interested: what was followed before says nothing about later readings."""
    _recent: tuple[FollowedObject, ...] = field(default=(FollowedObject(),), init=False, repr=False)
    _begin_mm: Float[Array, "2"] = field(default_factory=lambda: np.zeros(2), init=False, repr=False)
    _begin_rad: float = field(default=0.0, init=False, repr=False)
    """What the tracker gave as displacement and turn when the object touched first."""
    _first_press: Press | None = field(default=None, init=False, repr=False)
    """How the twin was pressed then."""
    _path: int = field(default=0, init=False, repr=False)
    """The path of the tracker that is followed; another object begins another one."""

    def add(self, reading: Reading) -> None:
        """Follow the object into the next reading; called in the sensor thread."""
        if not self.is_wanted:
            self._tracker, self._recent = None, (FollowedObject(),)
            return
        self._tracker = self._tracker or ContactTracker()
        found, press = self._tracker.update(reading), self.press_at(reading.stamp_ns)
        is_another = self._is_another_object(found)
        seen = self._extend_seen(found, press, None if is_another else self._recent[-1].seen)
        true = None if seen is None or press is None else self._extend_true(press, seen)
        self._recent = (*self._recent[1 - _KEPT :], FollowedObject(reading.stamp_ns, found.slip, seen, true))

    def at(self, stamp_ns: int) -> FollowedObject:
        """Return what was found in the reading of this stamp, or in the newest one."""
        recent = self._recent
        return next((one for one in recent if one.stamp_ns == stamp_ns), recent[-1])

    def _is_another_object(self, found: TrackedContacts) -> bool:
        """Return whether another object touches than the one whose path is kept."""
        before, self._path = self._path, found.motion.path if found.motion.is_known else self._path
        return self._path != before

    def _extend_seen(self, found: TrackedContacts, press: Press | None, before: ObjectPath | None) -> ObjectPath | None:
        if not found.contacts:
            return None
        motion, sticking_share = found.motion, found.slip.sticking_share
        is_turn_seen = motion.is_known and bool(motion.std[5] < SEEN_TURN_RAD)
        yaw_rad = motion.motion.yaw_rad if is_turn_seen else np.nan
        if before is None:
            self._first_press, self._begin_mm, self._begin_rad = press, found.displacement_mm, yaw_rad
            place_mm = motion.position_mm[:2] if motion.is_known else found.contacts[0].centre_mm
            return ObjectPath(place_mm[None], yaw_rad - yaw_rad, float(motion.std[5]), sticking_share)
        place_mm = before.places_mm[0] + found.displacement_mm - self._begin_mm
        turn_rad = (yaw_rad - self._begin_rad + np.pi) % (2 * np.pi) - np.pi
        return before.then(place_mm, turn_rad, float(motion.std[5]), sticking_share)

    def _extend_true(self, press: Press, seen: ObjectPath) -> ObjectPath | None:
        first, slip_share = self._first_press, press.slip_share
        before = None if len(seen.places_mm) == 1 else self._recent[-1].true
        if first is None or press.indenter is not first.indenter:
            return None
        motion = _pose_of(press).after(_pose_of(first).inverse)
        start_mm = np.append(seen.places_mm[0], -float(first.pose.depth_mm))
        place_mm, sticking_share = motion(start_mm)[:2], np.nan if slip_share is None else 1 - slip_share
        if before is None:
            before = ObjectPath(seen.places_mm[:1], 0.0)
        return before.then(place_mm, motion.yaw_rad, 0.0, sticking_share)


def _pose_of(press: Press) -> RigidMotion:
    """Return the motion from the object's frame to that of the sensor."""
    return RigidMotion(np.asarray(press.pose.rotation), np.asarray(press.pose.origin_mm))
