"""Whether an object fits the skin as well after another turn: a gear by one tooth, a cross by a quarter.

While an object is followed from image to image, its turn is known whatever its symmetry. After its turn was out of sight, it is
known only if no other one fits.
"""

import numpy as np

from ninedtact.tracking.registration import LEAST_DISTANCE_MM, Registration, RegistrationResult
from ninedtact.tracking.rigid_motion import RigidMotion
from ninedtact.tracking.touched_surface import TouchedSurface

_ANGLES_RAD = np.radians(np.arange(10, 351, 5))
_FAR_MM = 0.1
"""Distance from which points count as not fitting; a larger one counts no more."""
_TRIED = 3
"""Number of the best turns from which the surface is registered."""
_OTHER_RAD = np.radians(8)
"""Difference of two turns from which they are not the same one."""
_WORSE = 1.5
"""Ratio of the distance of the surfaces to that at the turn that was found, above which another turn fits worse."""
_LESS = 0.9
"""Ratio of the overlaps below which it does, too."""


def fits_at_another_turn(
    register: Registration, earlier: TouchedSurface, later: TouchedSurface, found: RegistrationResult
) -> bool:
    """Return whether a turn about z other than the one that was found lays the surfaces onto each other as well."""
    turned = [found.motion.perturbed(found.centre_mm, np.array([0, 0, 0, 0, 0, angle])) for angle in _ANGLES_RAD]
    misfits = np.array([_misfit(register, earlier, later, motion) for motion in turned])
    beside = np.pad(misfits, 1, constant_values=np.inf)
    minima = np.flatnonzero((misfits <= beside[:-2]) & (misfits <= beside[2:]))
    best = minima[np.argsort(misfits[minima])][:_TRIED]
    return any(_fits_as_well(register(earlier, later, turned[number]), found) for number in best)


def _misfit(register: Registration, earlier: TouchedSurface, later: TouchedSurface, motion: RigidMotion) -> float:
    distance, _, both, _ = register.residual(earlier, later, motion)
    return float(np.where(both > 0.5, np.minimum(np.abs(distance), _FAR_MM), _FAR_MM).mean())


def _fits_as_well(other: RegistrationResult | None, found: RegistrationResult) -> bool:
    """Return whether a registration ended at another turn, and fits there."""
    limit_mm = _WORSE * max(found.rms_mm, LEAST_DISTANCE_MM)
    if other is None or other.rms_mm > limit_mm or other.overlap < _LESS * found.overlap:
        return False
    return bool(abs(other.motion.after(found.motion.inverse).yaw_rad) > _OTHER_RAD)
