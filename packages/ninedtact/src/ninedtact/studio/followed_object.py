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
from ninedtact.simulation.object_motions import true_slip
from ninedtact.simulation.press import Press
from ninedtact.tracking import ContactTracker, ObjectMotion, RigidMotion, SlipEstimate, SlipState, TrackedContacts

SEEN_TURN_RAD = np.radians(45)
"""Standard deviation of a turn below which it is shown; a ball has 115°."""
_STEP_MM = 0.05
"""Distance of the points of a path."""
_MOST_POINTS = 300
"""Number of points from which every other one is left out."""
_SEEN_STD_MM = 0.2
"""Standard deviation of a position up to which a path is that of the object's shape, and else that of its contacts."""
_ANOTHER = "new path: another object, or one that was not recognised"
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
    """None where nothing touches, or where the image cannot be used."""
    true: ObjectPath | None = None
    """That of the simulation; None for a sensor that is no twin."""
    true_slip: SlipState = SlipState.UNKNOWN
    doubt: str = ""
    """Why position or turn is not sure; empty where they are."""


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
    _found: TrackedContacts | None = field(default=None, init=False, repr=False)
    """What the tracker found in the last image that could be used."""
    _last: FollowedObject = field(default=FollowedObject(), init=False, repr=False)
    """What was known of the object then."""
    _begin_mm: Float[Array, "2"] | None = field(default=None, init=False, repr=False)
    """What the object's shape gives as displacement where the path begins; None while its shape does not show it."""
    _begin_rad: float = field(default=0.0, init=False, repr=False)
    """What the tracker gave as turn when the object touched first."""
    _first_press: Press | None = field(default=None, init=False, repr=False)
    """How the twin was pressed then."""
    _press: Press | None = field(default=None, init=False, repr=False)
    """How it was pressed in the last image that could be used."""
    _path: int = field(default=0, init=False, repr=False)
    """The path of the tracker that is followed; another object begins another one."""

    def add(self, reading: Reading) -> Reading:
        """Follow the object into the next reading, and return it with the torque that the object's turn shows; called in the
        sensor thread."""
        if not self.is_wanted:
            self._tracker, self._found, self._last, self._recent = None, None, FollowedObject(), (FollowedObject(),)
            self._press = self._first_press = None
            return reading
        self._tracker = self._tracker or ContactTracker()
        found = self._tracker.update(reading)
        if reading.image_warnings:  # the path goes on with the next image
            now = FollowedObject(reading.stamp_ns, found.slip, doubt=found.motion.reason)
        else:
            now = self._last = self._continue(found, self.press_at(reading.stamp_ns))
            self._found = found
        self._recent = (*self._recent[1 - _KEPT :], now)
        return found.reading

    def at(self, stamp_ns: int) -> FollowedObject:
        """Return what was found in the reading of this stamp, or in the newest one."""
        recent = self._recent
        return next((one for one in recent if one.stamp_ns == stamp_ns), recent[-1])

    def _continue(self, found: TrackedContacts, press: Press | None) -> FollowedObject:
        motion, last = found.motion, self._last
        path_before, self._path = self._path, motion.path if motion.is_known else self._path
        is_another = self._path != path_before
        was_unusable = self._recent[-1].stamp_ns != last.stamp_ns
        is_late = press is not None and self._first_press is None  # the simulation had not kept the first press
        if is_another or is_late or (was_unusable and not (self._begin_mm is not None and _shows_place(motion))):
            last = FollowedObject()
        seen = self._extend_seen(found, press, last.seen)
        true = None if seen is None or press is None else self._extend_true(press, seen, last.true)
        since_s = (found.reading.stamp_ns - self._last.stamp_ns) / 1e9
        slip, self._press = _true_slip(self._press, press, since_s), press
        begins_anew = is_another and self._last.seen is not None
        lost = f"object lost: {motion.reason}" if motion.reason else ""
        doubt = lost or (_ANOTHER if begins_anew else last.doubt if last.doubt == _ANOTHER else "")
        return FollowedObject(found.reading.stamp_ns, found.slip, seen, true, slip, "" if seen is None else doubt)

    def _extend_seen(self, found: TrackedContacts, press: Press | None, before: ObjectPath | None) -> ObjectPath | None:
        if not found.contacts:
            return None
        motion, sticking_share = found.motion, found.slip.sticking_share
        is_turn_seen = motion.is_known and bool(motion.std[5] < SEEN_TURN_RAD)
        yaw_rad = motion.motion.yaw_rad if is_turn_seen else np.nan
        if before is None:
            self._first_press, self._begin_rad = press, yaw_rad
            self._begin_mm = motion.moved_mm[:2] if _shows_place(motion) else None
            place_mm = motion.position_mm[:2] if motion.is_known else found.contacts[0].centre_mm
            return ObjectPath(place_mm[None], yaw_rad - yaw_rad, float(motion.std[5]), sticking_share)
        turn_rad = (yaw_rad - self._begin_rad + np.pi) % (2 * np.pi) - np.pi
        return before.then(self._place_mm(found, before), turn_rad, float(motion.std[5]), sticking_share)

    def _place_mm(self, found: TrackedContacts, before: ObjectPath) -> Float[Array, "2"]:
        """Return where the object is now: by its shape where that shows it, otherwise as far on as its contacts have moved."""
        start_mm, moved_mm = before.places_mm[0], found.motion.moved_mm[:2]
        is_shown = _shows_place(found.motion)
        if is_shown and self._begin_mm is not None:
            return np.asarray(start_mm + moved_mm - self._begin_mm)
        last_mm = found.displacement_mm if self._found is None else self._found.displacement_mm
        place_mm = before.places_mm[-1] + found.displacement_mm - last_mm
        self._begin_mm = moved_mm - (place_mm - start_mm) if is_shown else self._begin_mm
        return np.asarray(place_mm)

    def _extend_true(self, press: Press, seen: ObjectPath, before: ObjectPath | None) -> ObjectPath | None:
        first, slip_share = self._first_press, press.slip_share
        if first is None or press.indenter is not first.indenter:
            return None
        motion = _pose_of(press).after(_pose_of(first).inverse)
        start_mm = np.append(seen.places_mm[0], -float(first.pose.depth_mm))
        place_mm, sticking_share = motion(start_mm)[:2], np.nan if slip_share is None else 1 - slip_share
        return (before or ObjectPath(seen.places_mm[:1], 0.0)).then(place_mm, motion.yaw_rad, 0.0, sticking_share)


def _shows_place(motion: ObjectMotion) -> bool:
    return motion.is_known and float(motion.std[:2].max()) < _SEEN_STD_MM


def _true_slip(before: Press | None, press: Press | None, since_s: float) -> SlipState:
    if press is None or before is None or press.indenter is not before.indenter or since_s <= 0:
        return SlipState.UNKNOWN
    return SlipState(true_slip(before, press, since_s).state)


def _pose_of(press: Press) -> RigidMotion:
    """Return the motion from the object's frame to that of the sensor."""
    return RigidMotion(np.asarray(press.pose.rotation), np.asarray(press.pose.origin_mm))
