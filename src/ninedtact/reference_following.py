"""A reference image that follows slow changes of light and gel while nothing touches, so that zero stays zero for hours.

LEDs warm up, lamps change and gel creeps after a long press: the image without contact changes by some parts in a thousand within
minutes, which would be read as a light touch. While nothing touches, the reference image is therefore an exponential average of the
images. It stays within a bound of the image that was taken, and it rests under contact and for some seconds after one.

After a release, an imprint and the drift of the light during the press remain. They are faint beside the press, and fade; what is
fainter than a small part of the press that has just ended is therefore not taken for a contact here, until it grows. The gel is
still settling then, and a part of the last force is added to the stated error.
"""

import logging
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray as Array

from ninedtact.force.contact_detection import measure_darkening
from ninedtact.quantities import Rectified, WrenchEstimate
from ninedtact.reading import Reading

_LOG = logging.getLogger(__name__)
_NS_PER_S = 1e9
_LOGGED_STEP = 0.01
"""Change of the mean brightness after which a line is logged."""


@dataclass(frozen=True)
class FollowingSettings:
    """How the reference image follows."""

    time_constant_s: float = 10.0
    """Time constant of the average."""
    every_s: float = 1.0
    """Time between two images that enter the average; each costs a new reference image on all stages."""
    max_change: float = 0.05
    """Largest change of any pixel's brightness, relative to the reference image that was taken."""
    rest_s: float = 5.0
    """Time after a contact before the reference follows again, so that it does not adopt the imprint of the contact."""
    residue: float = 0.04
    """Part of the darkening of the last press below which what remains after its release counts as its imprint."""
    max_residue: float = 0.005
    """Largest darkening that counts as an imprint, about 0.04 mm."""
    settling: float = 0.03
    """Part of the last force that the gel still shows at the moment of release, as one standard deviation."""
    settling_s: float = 10.0
    """Time constant with which this part decays."""


@dataclass
class ReferenceFollower:
    """Follows the skin of one session from the reference image that was taken."""

    taken: Rectified
    settings: FollowingSettings = FollowingSettings()
    _mean: Float32[Array, "rows cols"] = field(init=False, repr=False)
    _followed_ns: int | None = field(default=None, init=False)
    """Stamp of the last image that entered the average."""
    _touched_ns: int | None = field(default=None, init=False)
    """Stamp of the last image with contact."""
    _last_force: Float64[Array, "6"] = field(init=False)
    """Magnitude of the wrench at the last image with contact."""
    _peak: float = field(default=0.0, init=False)
    """Largest darkening of the last contact."""
    _residue: float = field(default=0.0, init=False)
    """Smallest darkening seen since the last contact was released."""
    _logged: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        self._mean = self.taken.grey.copy()
        self._last_force = np.zeros(6)

    @property
    def drift(self) -> float:
        """Relative change of the mean brightness since the reference image was taken."""
        return float(self._mean.mean() / max(float(self.taken.grey.mean()), 1.0)) - 1

    def follow(self, reading: Reading) -> Rectified | None:
        """Take notice of a reading; return the new reference image where it has moved, None where it has not."""
        now_ns = reading.stamp_ns
        if not reading.image_warnings and self._is_touched(reading):
            self._touched_ns = now_ns
            if reading.wrench is not None:
                self._last_force = np.abs(reading.wrench.six)
            return None
        if reading.image_warnings or self._seconds_since(self._touched_ns, now_ns) < self.settings.rest_s:
            return None
        elapsed_s = self._seconds_since(self._followed_ns, now_ns)
        if elapsed_s < self.settings.every_s:
            return None
        share = 1 - np.exp(-min(elapsed_s, self.settings.every_s) / self.settings.time_constant_s)
        self._followed_ns = now_ns
        mean = self._mean + np.float32(share) * (reading.rectified.grey - self._mean)
        low, high = (self.taken.grey * np.float32(1 + sign * self.settings.max_change) for sign in (-1, 1))
        self._mean = np.clip(mean, low, high)
        self._log_drift()
        return replace(self.taken, grey=self._mean, stamp_ns=now_ns)

    def with_settling_error(self, estimate: WrenchEstimate) -> WrenchEstimate:
        """Return an estimate without contact with the error of gel that is still settling; others as they are."""
        if estimate.touching or self._touched_ns is None:
            return estimate
        since_s = self._seconds_since(self._touched_ns, estimate.wrench.stamp_ns)
        part = self.settings.settling * np.exp(-max(since_s, 0.0) / self.settings.settling_s)
        return replace(estimate, covariance=estimate.covariance + np.diag((part * self._last_force) ** 2))

    def _is_touched(self, reading: Reading) -> bool:
        """Return whether something touches, as opposed to the imprint of the last contact."""
        darkening, limit = measure_darkening(reading)
        if darkening <= limit:
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

    def _log_drift(self) -> None:
        drift = self.drift
        if abs(drift - self._logged) >= _LOGGED_STEP:
            self._logged = drift
            _LOG.info("the reference image has followed the light by %+.1f %% since it was taken", 100 * drift)
