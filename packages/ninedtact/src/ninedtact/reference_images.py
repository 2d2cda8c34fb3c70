"""The reference images (no contact) of an open sensor: the one in use, what replaces it, and how it follows slow changes.

LEDs warm up, lamps change and gel creeps after a long press: the image without contact changes by some parts in a thousand within
minutes, which would be read as a light touch. While nothing touches, the reference image is therefore an exponential average of the
images, in their own light but without bands and dirt. But for the gain of the whole, it stays within a bound of the image that was
taken, and it rests under contact and for some seconds after one. What the same images teach about noise and flicker is
remembered for the next reading (`stream_memory`).

After a release, an imprint and the drift of the light during the press remain. They are faint beside the press, and fade; what is
fainter than a small part of the press that has just ended is therefore not taken for a contact here, until it grows. The gel is
still settling then, and a part of the largest force of the contact is added to the stated error.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.capture.frame_source import FrameSource
from ninedtact.force.contact_detection import find_faint_contact, measure_darkening_and_limit, measure_even_noise
from ninedtact.quantities import Frame, Rectified, WrenchEstimate, diagonal_covariance
from ninedtact.reading import Reading, StreamMemory
from ninedtact.shape.calibrated_shape import CalibratedShape, DepthReader, FindReferenceFaults
from ninedtact.stream_memory import StreamLearner, learn_from_references

_LOG = logging.getLogger(__name__)
_NS_PER_S = 1e9
_EVERY_ROWS = 24
_LOGGED_STEP = 0.01
"""Change of the mean brightness after which a line is logged."""
_EVEN_NOISES = 2.5
"""Darkening in noises of the image itself up to which it is noise, such as that of a video that is compressed anew. Contacts of
0.1 N have four and more."""


@dataclass(frozen=True)
class FollowingSettings:
    """How the reference image follows slow changes of light and gel while nothing touches, so that zero stays zero for hours."""

    look_every_s: float = 0.1
    """Time between two images in which contact is looked for; those in between only add to the largest force."""
    time_constant_s: float = 10.0
    """Time constant of the average."""
    every_s: float = 1.0
    """Time between two images that enter the average; each costs a new reference image on all stages."""
    max_change: float = 0.05
    """Largest change of any pixel's brightness, relative to the reference image that was taken in the light of the mean."""
    rest_s: float = 5.0
    """Time after a contact before the reference follows again, so that it does not adopt the imprint of the contact."""
    residue: float = 0.04
    """Part of the darkening of the last press below which what remains after its release counts as its imprint."""
    max_residue: float = 0.005
    """Largest darkening that counts as an imprint, about 0.04 mm."""
    settling: float = 0.03
    """Part of the largest force of a contact that the gel still shows at its release, as one standard deviation."""
    settling_s: float = 10.0
    """Time constant with which this part decays."""


def reference_following_settings_for(source: FrameSource, follow: bool | None = None) -> FollowingSettings | None:
    """Return how the reference follows on a source, None where it does not: by default on live sources alone.

    The images of a recording may be separate in time, and the same recording should give the same readings from any image on.
    """
    return FollowingSettings() if (source.is_live if follow is None else follow) else None


@checks_arguments
@dataclass
class ReferenceImages:
    """The reference images (no contact) of a sensor, each bound to a depth reader: the one in use, and what replaces it.

    Every opening begins with the given one. One that is taken ends the use of those that a recording holds; those of given moments
    are used from their moment on all the same. Between these, the one in use follows slow changes.
    """

    given: DepthReader | None = None
    """The one with which every opening begins; None takes a new one at every opening."""
    recorded: Callable[[int], DepthReader | None] | None = None
    """Returns the one that a recording holds for a stamp, the same object until it changes; None where there is no recording."""
    at_moments: Sequence[tuple[int, DepthReader]] = ()
    """Those of given moments of a recording, with the stamp from which on each is used, in order of time."""
    find_faults: FindReferenceFaults = lambda _: ()
    """Called once for every reference that is taken."""
    following: FollowingSettings | None = None
    """How the one in use follows slow changes while nothing touches; None keeps it as it was taken."""
    in_use: DepthReader | None = field(init=False)
    """Computes heights against the reference image in use; None before one was taken."""
    _scheduled: DepthReader | None = field(init=False, repr=False)
    """The one of a recording or of a moment that came into use last."""
    _is_taken: bool = field(init=False, repr=False)
    """Whether one was taken since the opening."""
    _follower: "ReferenceFollower | None" = field(init=False, repr=False)
    """Moves the one in use; None before the first reading that may move it."""
    _begins_with: StreamMemory = field(init=False, repr=False)
    """What the images of the one that was taken taught."""

    def __post_init__(self) -> None:
        self.begin()

    @property
    def memory(self) -> StreamMemory:
        """What earlier images of this opening told; of a source whose reference does not follow, its reference images alone."""
        return self._begins_with if self._follower is None else self._follower.learner.memory

    def begin(self) -> None:
        """Begin a new opening with the given one, or none, and with nothing of the opening before."""
        self._scheduled, self._is_taken = None, False
        self._use(self.given)

    def take(self, frames: Sequence[Frame], shape: CalibratedShape) -> None:
        """Use the mean of frames without contact; raises `ReferenceUnusable` and leaves the one in use."""
        self._use(shape.depth_reader(*frames, find_faults=self.find_faults))
        assert self.in_use is not None
        self._begins_with = learn_from_references(frames, shape, self.in_use)
        self._is_taken = True

    def replace_at(self, stamp_ns: int) -> bool:
        """Use what is to be used from a stamp on; return whether this is another one than before."""
        due = [reader for from_ns, reader in self.at_moments if from_ns <= stamp_ns]
        found = due[-1] if due else None
        if found is None and self.recorded is not None and not self._is_taken:
            found = self.recorded(stamp_ns)
        if found is None or found is self._scheduled:
            return False
        self._scheduled = found
        self._use(found)
        return True

    def follow(self, reading: Reading) -> Reading:
        """Let the one in use follow for the next reading; return this reading with the error of gel that is still settling."""
        if self.in_use is None or self.following is None:
            return reading
        if self._follower is None:
            learner = StreamLearner(self._begins_with)
            self._follower = ReferenceFollower(self.in_use.reference, self.following, learner)
        moved = self._follower.follow(reading)
        if moved is not None:
            self.in_use = replace(self.in_use, reference=moved)
        return (
            reading if reading.force is None else reading.with_force(self._follower.with_settling_error(reading.force))
        )

    def _use(self, reader: DepthReader | None) -> None:
        self.in_use, self._follower, self._begins_with = reader, None, StreamMemory()


@dataclass
class ReferenceFollower:
    """Follows the skin of one session from the reference image that was taken."""

    taken: Rectified
    settings: FollowingSettings = FollowingSettings()
    learner: StreamLearner = field(default_factory=StreamLearner)
    """Learns noise and flicker."""
    _mean: Float32[Array, "rows cols"] = field(init=False, repr=False)
    _followed_ns: int | None = field(default=None, init=False)
    """Stamp of the last image that entered the average."""
    _looked_ns: int | None = field(default=None, init=False)
    """Stamp of the last image in which contact was looked for."""
    _in_contact: bool = field(default=False, init=False)
    """Whether that image showed contact."""
    _touched_ns: int | None = field(default=None, init=False)
    """Stamp of the last image with contact."""
    _largest_force: Float64[Array, "6"] = field(init=False)
    """Largest magnitude of each component of the wrench in the last contact, or what has not decayed since a stronger one."""
    _unassigned_force: Float64[Array, "6"] = field(init=False)
    """The same of the images since the last look without contact, which belong to a contact if the next look finds one."""
    _peak: float = field(default=0.0, init=False)
    """Largest darkening of the last contact."""
    _residue: float = field(default=0.0, init=False)
    """Smallest darkening seen since the last contact was released."""
    _logged: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self._mean = self.taken.grey.copy()
        self._largest_force, self._unassigned_force = np.zeros(6), np.zeros(6)

    @property
    def drift(self) -> float:
        """Relative change of the mean brightness since the reference image was taken."""
        return float(self._mean.mean() / max(float(self.taken.grey.mean()), 1.0)) - 1

    def follow(self, reading: Reading) -> Rectified | None:
        """Take notice of a reading and its force; return the new reference image where it has moved, None where it has not."""
        now_ns = reading.stamp_ns
        self._add_force(reading.force)
        self.learner.learn_light(reading)
        if self._seconds_since(self._looked_ns, now_ns) < self.settings.look_every_s:
            return None
        self._looked_ns = now_ns
        if reading.image_warnings:
            return None
        self._look(reading)
        if self._seconds_since(self._touched_ns, now_ns) < self.settings.rest_s:
            return None
        elapsed_s = self._seconds_since(self._followed_ns, now_ns)
        if elapsed_s < self.settings.every_s:
            return None
        share = 1 - np.exp(-min(elapsed_s, self.settings.every_s) / self.settings.time_constant_s)
        self._followed_ns = now_ns
        mean = self._mean + np.float32(share) * (reading.light.restore(reading.rectified.grey) - self._mean)
        light = float(np.median(mean[::_EVERY_ROWS] / np.maximum(self.taken.grey[::_EVERY_ROWS], 1)))
        low, high = (self.taken.grey * np.float32(light * (1 + sign * self.settings.max_change)) for sign in (-1, 1))
        self._mean = np.clip(mean, low, high)
        if abs(self.drift - self._logged) >= _LOGGED_STEP:
            self._logged = self.drift
            _LOG.info("the reference image has followed the light by %+.1f %% since it was taken", 100 * self.drift)
        return replace(self.taken, grey=self._mean, stamp_ns=now_ns)

    def with_settling_error(self, estimate: WrenchEstimate) -> WrenchEstimate:
        """Return an estimate without contact with the error of gel that is still settling; others as they are."""
        if estimate.touching or self._touched_ns is None:
            return estimate
        std = self.settings.settling * self._unsettled_part(estimate.wrench.stamp_ns) * self._largest_force
        return replace(estimate, covariance=estimate.covariance + diagonal_covariance(std))

    def _add_force(self, estimate: WrenchEstimate | None) -> None:
        """Take the wrench of an estimate into the largest one of the contact."""
        if estimate is None or not estimate.touching:
            return
        magnitude = np.abs(estimate.wrench.six)
        if self._in_contact:
            self._largest_force = np.maximum(self._largest_force, magnitude)
        else:
            self._unassigned_force = np.maximum(self._unassigned_force, magnitude)

    def _look(self, reading: Reading) -> None:
        """Look for contact; at the beginning of one, the force since the last look becomes part of it."""
        is_touched = self._is_touched(reading)
        self.learner.remember(reading)
        if is_touched and not self._in_contact:
            remaining = self._unsettled_part(reading.stamp_ns) * self._largest_force
            self._largest_force = np.maximum(remaining, self._unassigned_force)
        if is_touched:
            self._touched_ns = reading.stamp_ns
        elif self._seconds_since(self._touched_ns, reading.stamp_ns) >= self.settings.rest_s:
            self.learner.learn_noise(reading)
        self._in_contact, self._unassigned_force = is_touched, np.zeros(6)

    def _unsettled_part(self, now_ns: int) -> float:
        """Return the part of the settling error that has not decayed since the last contact."""
        since_s = max(self._seconds_since(self._touched_ns, now_ns), 0.0)
        return float(np.exp(-since_s / self.settings.settling_s))

    def _is_touched(self, reading: Reading) -> bool:
        """Return whether something touches, as opposed to the imprint of the last contact."""
        darkening, limit = measure_darkening_and_limit(reading)
        is_even = darkening <= max(limit, _EVEN_NOISES * measure_even_noise(reading))
        if is_even and find_faint_contact(reading) is None:
            self._peak = 0.0
            return False
        imprint = min(self.settings.residue * self._peak, self.settings.max_residue)
        if darkening < imprint and darkening < self._residue + limit:
            self._residue = min(self._residue, darkening)
            return False
        self._peak, self._residue = max(self._peak, darkening), np.inf
        return True

    @staticmethod
    def _seconds_since(then_ns: int | None, now_ns: int) -> float:
        return np.inf if then_ns is None else (now_ns - then_ns) / _NS_PER_S
