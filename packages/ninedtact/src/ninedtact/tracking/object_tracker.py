"""An object followed through a stream of readings, against key frames.

Every reading is registered with the last key frame, so that errors do not add up from frame to frame. A new key frame is taken
where the object has turned or moved so far that the surfaces hardly overlap. Where nothing touches, or the surfaces do not fit, the
object is lost, and the state says why. When something touches again it is compared with the key frames: if one fits, the path goes
on, unless it fits after another turn as well; otherwise another path begins. In the same way a turn that could not be seen for a
while is unknown until no other turn fits.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import StrEnum
from math import radians

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.quantities import EstimateWarning
from ninedtact.reading import Reading
from ninedtact.tracking.other_turns import fits_at_another_turn
from ninedtact.tracking.registration import PRIOR_RAD, Registration, RegistrationResult
from ninedtact.tracking.rigid_motion import Covariance, RigidMotion, move_error, turn_error
from ninedtact.tracking.touched_surface import TouchedSurface, extract_touched_surface

_MIN_OVERLAP, _KEY_FRAME_OVERLAP = 0.35, 0.6
"""Share of the key frame that must touch in a reading; share below which the reading becomes the next key frame."""
_KEY_FRAME_TURN_RAD = radians(25)
_MAX_RMS_MM = 0.08
"""Root mean square distance of surfaces above which they are not the same object's."""
_MAX_SHARE_IN_GEL = 0.3
"""Share of an object that would have been inside the gel before from which it is another one, as no object can be there."""
_MAX_KEY_FRAMES = 40
_SEEN_TURN_RAD = 0.3
"""Standard deviation of a turn up to which it is seen."""
_FAST_TURNS_RAD = np.radians([-16, -8, 8, 16])
_NO_TURN = np.diag([0, 0, 0, 0, 0, PRIOR_RAD**2])
"""What is added to the covariance where the turn is not known."""


class TrackState(StrEnum):
    """Whether the motion of the object is known."""

    NO_CONTACT = "no contact"
    TRACKED = "tracked"
    LOST = "lost"


@dataclass(frozen=True)
class ObjectMotion:
    """Where the object is, compared with where it was when it touched first."""

    state: TrackState
    reason: str = ""
    """Why the object is lost; empty otherwise."""
    path: int = 0
    """Number of the path: it rises where another object, or the same one beyond recognition, touches."""
    motion: RigidMotion = field(default_factory=RigidMotion)
    covariance: Covariance = field(default_factory=lambda: np.full((6, 6), np.nan))
    """Of the error at `position_mm`, in mm and rad (`rigid_motion`); not a number where the object is not tracked."""
    position_mm: Float[Array, "3"] = field(default_factory=lambda: np.full(3, np.nan))
    """Where the point of the object is now that was the centre of its first contact."""
    moved_mm: Float[Array, "3"] = field(default_factory=lambda: np.full(3, np.nan))
    """By how much that point has moved since."""
    overlap: float = 0.0
    """Share of the key frame that touches now, too."""
    rms_mm: float = 0.0
    """Root mean square distance of the surfaces."""
    is_key_frame: bool = False

    @property
    def is_known(self) -> bool:
        """Whether the motion is known."""
        return self.state == TrackState.TRACKED

    @property
    def std(self) -> Float[Array, "6"]:
        """Standard deviations of position in mm along x, y, z, and of the rotation in rad about them."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True)
class _KeyFrame:
    """A surface, and the motion of the object from its first contact to it."""

    surface: TouchedSurface
    motion: RigidMotion
    covariance: Covariance
    """Of the error at the object's reference point."""


@dataclass
class ObjectTracker:
    """Follows one object; give it every reading of a stream in turn.

    >>> tracker = ninedtact.tracking.ObjectTracker()
    >>> with ninedtact.open("my_sensor", source="sim", force="none") as sensor:
    ...     motions = [tracker.update(reading) for reading, _ in zip(sensor, range(100))]
    """

    register: Registration = Registration()
    path: int = field(default=0, init=False)
    _origin_mm: Float[Array, "3"] = field(default_factory=lambda: np.zeros(3), init=False, repr=False)
    _key_frames: list[_KeyFrame] = field(default_factory=list, init=False, repr=False)
    _current: _KeyFrame | None = field(default=None, init=False, repr=False)
    """The key frame in use; None before the first contact and while the object is lost."""
    _relative: list[RigidMotion] = field(default_factory=list, init=False, repr=False)
    """The last two motions since the key frame in use; one where the turn is not seen."""
    _turn_was_lost: bool = field(default=False, init=False, repr=False)
    """Whether the turn since the key frame in use was out of sight."""

    def update(self, reading: Reading) -> ObjectMotion:
        """Return where the object is in the next reading of the stream."""
        if reading.image_warnings:
            return self._lose(TrackState.LOST, str(reading.image_warnings[0]))
        if not reading.is_touching:
            return self._lose(TrackState.NO_CONTACT)
        surface = extract_touched_surface(reading.height, reading.contact)
        if surface is None:
            return self._lose(TrackState.LOST, "too little of the object touches")
        unseen = EstimateWarning.PART_UNSEEN in reading.warnings
        return self._follow(surface, "the contact leaves the view" if unseen else "")

    def _follow(self, surface: TouchedSurface, doubt: str) -> ObjectMotion:
        if self._current is None:
            return self._recognise(surface)
        found = self._find_motion(self._current, surface)
        reason = _reason_to_reject(found)
        if found is None or reason:
            return self._lose(TrackState.LOST, doubt or reason)
        found = self._with_doubt_of_turn(self._current, found, surface)
        # Noise turned the object while its turn was not seen: the next guess does not repeat that step.
        before = [] if self._turn_was_lost else self._relative[-1:]
        self._relative = [*before, found.motion]
        return self._accept(self._current, found, surface)

    def _find_motion(self, key: _KeyFrame, surface: TouchedSurface) -> RegistrationResult | None:
        """Return the motion since a key frame; where the turn gets out of sight, from turns near by, too: it may have been fast."""
        guess = self._predict_motion()
        found = self.register(key.surface, surface, guess)
        if found is None or found.std[5] < _SEEN_TURN_RAD or self._turn_was_lost:
            return found
        centre_mm = guess(key.surface.centre_mm)
        turned = (guess.perturbed(centre_mm, np.array([0, 0, 0, 0, 0, angle])) for angle in _FAST_TURNS_RAD)
        others = [self.register(key.surface, surface, one) for one in turned]
        seen = [one for one in others if one is not None and one.std[5] < _SEEN_TURN_RAD and one.rms_mm < found.rms_mm]
        return min(seen, key=lambda one: one.rms_mm, default=found)

    def _with_doubt_of_turn(
        self, key: _KeyFrame, found: RegistrationResult, surface: TouchedSurface
    ) -> RegistrationResult:
        """Return the result, with an unknown turn where it is seen again but may be another one."""
        if found.std[5] > _SEEN_TURN_RAD:
            self._turn_was_lost = True
            return found
        self._turn_was_lost = self._turn_was_lost and fits_at_another_turn(self.register, key.surface, surface, found)
        return replace(found, covariance=found.covariance + _NO_TURN) if self._turn_was_lost else found

    def _predict_motion(self) -> RigidMotion:
        """Return the motion since the key frame if the last step is repeated."""
        if len(self._relative) < 2:
            return self._relative[-1] if self._relative else RigidMotion()
        before, last = self._relative
        return last.after(before.inverse).after(last)

    def _accept(self, key: _KeyFrame, found: RegistrationResult, surface: TouchedSurface) -> ObjectMotion:
        motion = found.motion.after(key.motion)
        position_mm = motion(self._origin_mm)
        covariance = turn_error(key.covariance, found.motion.rotation) + move_error(
            found.covariance, found.centre_mm, position_mm
        )
        turned_rad = float(np.linalg.norm(found.motion.rotation_vector_rad))
        is_key = found.overlap < _KEY_FRAME_OVERLAP or turned_rad > _KEY_FRAME_TURN_RAD
        if is_key:
            self._use(_KeyFrame(surface, motion, covariance))
        return ObjectMotion(
            TrackState.TRACKED,
            "",
            self.path,
            motion,
            covariance,
            position_mm,
            position_mm - self._origin_mm,
            found.overlap,
            found.rms_mm,
            is_key,
        )

    def _use(self, key: _KeyFrame) -> None:
        self._current = key
        if self._relative:  # They are counted from this key frame from now on.
            from_last = self._relative[-1].inverse
            self._relative = [one.after(from_last) for one in self._relative]
        self._turn_was_lost = False
        # The first key frame is kept, because errors are smallest against it.
        self._key_frames = [*self._key_frames[:1], *self._key_frames[1:][-(_MAX_KEY_FRAMES - 2) :], key]

    def _recognise(self, surface: TouchedSurface) -> ObjectMotion:
        """Return the motion of an object that touches again, from the key frame that fits best; else the first of a new path."""
        fits = list(self._fits_to_key_frames(surface))
        if fits:
            key, found = min(fits, key=lambda fit: fit[1].rms_mm / fit[1].overlap)
            is_seen = found.std[5] < _SEEN_TURN_RAD
            if not is_seen or not fits_at_another_turn(self.register, key.surface, surface, found):
                self._current, self._relative, self._turn_was_lost = key, [found.motion], not is_seen
                return self._accept(key, found, surface)
        return self._begin_path(surface)

    def _fits_to_key_frames(self, surface: TouchedSurface) -> Iterator[tuple[_KeyFrame, RegistrationResult]]:
        """Yield the key frames that a surface fits, with its motion since each."""
        for key in self._key_frames:
            shift = surface.centre_mm - key.surface.centre_mm
            found = self.register(key.surface, surface, RigidMotion(translation_mm=shift))
            if found is not None and not _reason_to_reject(found):
                yield key, found

    def _begin_path(self, surface: TouchedSurface) -> ObjectMotion:
        self.path += 1
        self._origin_mm, self._key_frames = surface.centre_mm, []
        self._use(_KeyFrame(surface, RigidMotion(), np.zeros((6, 6))))
        return ObjectMotion(
            TrackState.TRACKED,
            path=self.path,
            covariance=np.zeros((6, 6)),
            position_mm=self._origin_mm,
            moved_mm=np.zeros(3),
            overlap=1.0,
            is_key_frame=True,
        )

    def _lose(self, state: TrackState, reason: str = "") -> ObjectMotion:
        self._current, self._relative = None, []
        return ObjectMotion(state, reason, self.path)


def _reason_to_reject(found: RegistrationResult | None) -> str:
    """Return why two surfaces are not those of one object at rest in between; empty where they are."""
    if found is None or found.overlap < _MIN_OVERLAP:
        return "too little of the surface touches that touched before"
    if found.rms_mm > _MAX_RMS_MM:
        return "the surface has another shape than before"
    if found.share_in_gel > _MAX_SHARE_IN_GEL:
        return "another object touches: this one would have been inside the gel before"
    return ""
