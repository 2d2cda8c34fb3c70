"""The displacement of an object along the skin where neither depth nor load has a known scale.

The object is taken not to tilt. Two measures of each step from image to image are averaged by their errors: that of its shape
(`ObjectTracker`), which a ball and a face that leaves the view lack, and that of the middle of its dent, which every contact has
but which moves when more of the object touches.
"""

from collections import deque
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.quantities import Traction, centred_axis_mm
from ninedtact.reading import Reading
from ninedtact.tracking.object_tracker import ObjectMotion, ObjectTracker, TrackState
from ninedtact.tracking.registration import Registration

_DENT = 0.3
"""Part of the greatest depth below which skin is not counted to the dent."""
_DENT_CENTRE_STD_MM = 0.12
"""Error of a step of the middle of the dent, on simulated sensors."""
_LEAST_LIKENESS = 0.7
"""Likeness of dents in successive images, over what is usual, below which they are not of one object: on simulated sensors, 99 % of
those of one object are above, and four fifths of those of two objects below."""
_REMEMBERED_IMAGES = 15
"""Images of which the usual likeness is the median: noise makes all of them unlike, another object one."""
_LEAST_JUMP_MM, _FASTEST_MM_PER_S = 2.0, 60.0
"""Change of a step of the dent, and of its speed, from which it is a jump: a hand, or a cut of the sequence, changed the object."""
_LEAST_STD_MM = 0.01
_UNSEEN_STD_MM = 1.0
"""Error of a displacement from the image on in which a part of the contact is out of view."""
_BORDER_PART = 0.1
"""Part of a dent at the border of the view from which it is not noise."""
_RELATIVE_ERROR = 0.1
"""Error of a displacement over its length, on simulated sensors: shear moves the middle of a dent."""
_UNSEEN_RAD = 2.0
"""Standard deviation of a turn that is not seen: any angle."""


@dataclass(frozen=True)
class UprightMotion:
    """Where an object that does not tilt is, compared with where the present contact began."""

    state: TrackState
    reason: str = ""
    """Why nothing is known; empty otherwise."""
    moved_mm: Float[Array, "2"] = field(default_factory=lambda: np.full(2, np.nan))
    """Displacement along x and y."""
    std_mm: Float[Array, "2"] = field(default_factory=lambda: np.full(2, np.nan))
    yaw_rad: float = float("nan")
    yaw_std_rad: float = float("nan")
    ends_path: bool = False
    """Whether what touches next is followed anew: nothing touches, or another object does."""


@dataclass(frozen=True)
class _Dent:
    """The deeper part of the dent under a contact, on the cells of its tractions."""

    depth_mm: Float32[Array, "rows cols"]
    centre_mm: Float[Array, "2"]
    """Its middle, weighted by depth."""
    mm_per_px: float

    @property
    def reaches_border(self) -> bool:
        """Whether a part of it may be out of view."""
        at_border = self.depth_mm.sum() - self.depth_mm[2:-2, 2:-2].sum()
        return bool(at_border > _BORDER_PART * self.depth_mm.sum())

    def likeness_to(self, before: "_Dent") -> float:
        """Return the correlation with an earlier dent that is moved onto this one: 1 for the same shape."""
        x_px, y_px = ((self.centre_mm - before.centre_mm) / self.mm_per_px).tolist()
        shift = np.array([[1, 0, x_px], [0, 1, y_px]], np.float32)
        moved = cv2.warpAffine(before.depth_mm, shift, self.depth_mm.shape[::-1])
        size = float(np.linalg.norm(moved) * np.linalg.norm(self.depth_mm))
        return float((moved * self.depth_mm).sum()) / size if size > 0 else 0.0


@dataclass
class UprightTracker:
    """Follows an object that does not tilt; give it every reading of a stream in turn, with tractions."""

    objects: ObjectTracker = field(default_factory=lambda: ObjectTracker(Registration(is_upright=True)))
    _moved_mm: Float[Array, "2"] = field(default_factory=lambda: np.zeros(2), init=False, repr=False)
    _variance_mm2: Float[Array, "2"] = field(default_factory=lambda: np.zeros(2), init=False, repr=False)
    _dent: _Dent | None = field(default=None, init=False, repr=False)
    """The dent in the image before; None where nothing touched."""
    _step_mm: Float[Array, "2"] = field(default_factory=lambda: np.zeros(2), init=False, repr=False)
    """The last step of its middle."""
    _likenesses: deque[float] = field(default_factory=lambda: deque(maxlen=_REMEMBERED_IMAGES), init=False, repr=False)
    _stamp_ns: int = field(default=0, init=False, repr=False)
    _motion: ObjectMotion | None = field(default=None, init=False, repr=False)

    def update(self, reading: Reading) -> UprightMotion:
        """Return where the object is in the next reading."""
        motion = self.objects.update(reading)
        if reading.image_warnings:
            return UprightMotion(TrackState.LOST, str(reading.image_warnings[0]))
        if reading.force is None:
            return UprightMotion(TrackState.LOST, "no force estimate")
        traction = reading.force.traction
        dent = None if traction is None else _find_dent(traction)
        if dent is None:
            return self._end_path(TrackState.NO_CONTACT)
        after_s, self._stamp_ns = (reading.stamp_ns - self._stamp_ns) / 1e9, reading.stamp_ns
        if self._dent is not None and (reason := self._reason_to_begin_anew(self._dent, dent, after_s)):
            return self._end_path(TrackState.LOST, reason)
        return self._follow(dent, motion)

    def _end_path(self, state: TrackState, reason: str = "") -> UprightMotion:
        self._dent, self._motion = None, None
        return UprightMotion(state, reason, ends_path=True)

    def _follow(self, dent: _Dent, motion: ObjectMotion) -> UprightMotion:
        """Return the displacement to this dent: from the one before, or the first of a path."""
        if self._dent is None:
            self._moved_mm, self._variance_mm2, self._step_mm = np.zeros(2), np.zeros(2), np.zeros(2)
        else:
            self._step_mm = dent.centre_mm - self._dent.centre_mm
            self._add_step(self._step_mm, self._motion, motion)
        if dent.reaches_border:
            self._variance_mm2 = np.maximum(self._variance_mm2, _UNSEEN_STD_MM**2)
        self._dent, self._motion = dent, motion
        std_mm = np.hypot(np.sqrt(self._variance_mm2), _RELATIVE_ERROR * float(np.linalg.norm(self._moved_mm)))
        yaw = (motion.motion.yaw_rad, float(motion.std[5])) if motion.is_known else (np.nan, _UNSEEN_RAD)
        return UprightMotion(TrackState.TRACKED, "", self._moved_mm, std_mm, *yaw)

    def _reason_to_begin_anew(self, last: _Dent, dent: _Dent, after_s: float) -> str:
        """Return why two successive dents are not of one object; empty where they may be."""
        likeness, usual = dent.likeness_to(last), float(np.median(self._likenesses or [1.0]))
        self._likenesses.append(likeness)
        if likeness < _LEAST_LIKENESS * usual:
            return "the contact is unlike that of the image before"
        change_mm = float(np.linalg.norm(dent.centre_mm - last.centre_mm - self._step_mm))
        return "the contact jumps" if change_mm > max(_LEAST_JUMP_MM, _FASTEST_MM_PER_S * after_s) else ""

    def _add_step(self, centre_step_mm: Float[Array, "2"], before: ObjectMotion | None, motion: ObjectMotion) -> None:
        """Add a step, the mean of both measures by their errors; the error of displacement is not that of steps added up."""
        weight, step_mm = np.full(2, _DENT_CENTRE_STD_MM**-2), centre_step_mm * _DENT_CENTRE_STD_MM**-2
        if before is not None and before.is_known and motion.is_known and before.path == motion.path:
            seen = 1 / np.maximum(motion.std[:2], _LEAST_STD_MM) ** 2
            weight, step_mm = weight + seen, step_mm + seen * (motion.moved_mm - before.moved_mm)[:2]
        self._moved_mm = self._moved_mm + step_mm / weight
        self._variance_mm2 = np.maximum(self._variance_mm2, 1 / weight)


def _find_dent(traction: Traction) -> _Dent | None:
    """Return the dent under a contact; None where there is none."""
    if traction.height_mm is None or not traction.is_touched.any():
        return None
    depth_mm = -traction.height_mm.astype(np.float32)
    weight = np.maximum(depth_mm - np.float32(_DENT) * depth_mm.max(), 0)
    if not weight.any():
        return None
    x_mm, y_mm = (centred_axis_mm(side, traction.mm_per_px).astype(float) for side in weight.shape[::-1])
    centre_mm = np.array([weight.sum(axis=0) @ x_mm, weight.sum(axis=1) @ y_mm]) / float(weight.sum())
    return _Dent(weight, centre_mm, traction.mm_per_px)
