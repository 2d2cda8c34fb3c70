"""The displacement of an object along the skin where neither depth nor load has a known scale.

The object is taken not to tilt. Two measures of each step from image to image are averaged by their errors: that of its shape
(`ObjectTracker`), which a ball and a face that leaves the view lack, and that of the middle of its dent, which every contact has
but which moves when more of the object touches.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.quantities import Traction, centred_axis_mm
from ninedtact.reading import Reading
from ninedtact.tracking.object_tracker import ObjectMotion, ObjectTracker, TrackState
from ninedtact.tracking.registration import Registration

_DENT = 0.3
"""Part of the greatest depth below which skin is not counted to the dent."""
_DENT_CENTRE_STD_MM = 0.12
"""Error of a step of the middle of the dent, on simulated sensors."""
_LEAST_STD_MM = 0.01
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


@dataclass
class UprightTracker:
    """Follows an object that does not tilt; give it every reading of a stream in turn, with tractions."""

    objects: ObjectTracker = field(default_factory=lambda: ObjectTracker(Registration(is_upright=True)))
    _moved_mm: Float[Array, "2"] = field(default_factory=lambda: np.zeros(2), init=False, repr=False)
    _variance_mm2: Float[Array, "2"] = field(default_factory=lambda: np.zeros(2), init=False, repr=False)
    _centre_mm: Float[Array, "2"] | None = field(default=None, init=False, repr=False)
    """Middle of the dent in the image before; None where nothing touched."""
    _motion: ObjectMotion | None = field(default=None, init=False, repr=False)

    def update(self, reading: Reading) -> UprightMotion:
        """Return where the object is in the next reading."""
        motion, before = self.objects.update(reading), self._motion
        if reading.image_warnings:
            return UprightMotion(TrackState.LOST, str(reading.image_warnings[0]))
        if reading.force is None:
            return UprightMotion(TrackState.LOST, "no force estimate")
        traction = reading.force.traction
        centre_mm = None if traction is None else dent_centre_mm(traction)
        if centre_mm is None:
            self._centre_mm, self._motion = None, None
            return UprightMotion(TrackState.NO_CONTACT)
        if self._centre_mm is None:
            self._moved_mm, self._variance_mm2 = np.zeros(2), np.zeros(2)
        else:
            self._add_step(centre_mm - self._centre_mm, before, motion)
        self._centre_mm, self._motion = centre_mm, motion
        std_mm = np.hypot(np.sqrt(self._variance_mm2), _RELATIVE_ERROR * float(np.linalg.norm(self._moved_mm)))
        yaw = (motion.motion.yaw_rad, float(motion.std[5])) if motion.is_known else (np.nan, _UNSEEN_RAD)
        return UprightMotion(TrackState.TRACKED, "", self._moved_mm, std_mm, *yaw)

    def _add_step(self, centre_step_mm: Float[Array, "2"], before: ObjectMotion | None, motion: ObjectMotion) -> None:
        """Add a step, the mean of both measures by their errors; the error of displacement is not that of steps added up."""
        weight, step_mm = np.full(2, _DENT_CENTRE_STD_MM**-2), centre_step_mm * _DENT_CENTRE_STD_MM**-2
        if before is not None and before.is_known and motion.is_known and before.path == motion.path:
            seen = 1 / np.maximum(motion.std[:2], _LEAST_STD_MM) ** 2
            weight, step_mm = weight + seen, step_mm + seen * (motion.moved_mm - before.moved_mm)[:2]
        self._moved_mm = self._moved_mm + step_mm / weight
        self._variance_mm2 = np.maximum(self._variance_mm2, 1 / weight)


def dent_centre_mm(traction: Traction) -> Float[Array, "2"] | None:
    """Return the middle of the dent under a contact, weighted by its depth; None without a dent."""
    if traction.height_mm is None or not traction.is_touched.any():
        return None
    depth_mm = -traction.height_mm.astype(float)
    weight = np.maximum(depth_mm - _DENT * depth_mm.max(), 0)
    if not weight.any():
        return None
    x_mm, y_mm = (centred_axis_mm(side, traction.mm_per_px).astype(float) for side in weight.shape[::-1])
    return np.array([weight.sum(axis=0) @ x_mm, weight.sum(axis=1) @ y_mm]) / weight.sum()
