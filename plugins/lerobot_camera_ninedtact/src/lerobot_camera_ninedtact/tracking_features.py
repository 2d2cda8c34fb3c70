"""Contacts, motion and slip as numbers of a feature, the same of a robot and of exported recordings."""

import numpy as np

from ninedtact.tracking import TrackedContacts

TRACKING_NAMES = (
    "contacts",
    "moved_x_mm",
    "moved_y_mm",
    "turn_z_rad",
    "turn_z_std_rad",
    "p_incipient",
    "p_gross",
    "sticking_share",
)
UNKNOWN = -1.0
"""Probabilities and shares that are not known, because statistics cannot hold NaN."""
UNSEEN_RAD = 2.0
"""Standard deviation of a turn that is not seen, as that of a ball."""


def tracking_values(found: TrackedContacts) -> list[float]:
    """Return the values of `TRACKING_NAMES`; a turn that is not known is zero with the standard deviation `UNSEEN_RAD`."""
    motion, slip = found.motion, found.slip
    turn = (motion.motion.yaw_rad, min(float(motion.std[5]), UNSEEN_RAD)) if motion.is_known else (0.0, UNSEEN_RAD)
    shares = (slip.p_incipient, slip.p_gross, slip.sticking_share)
    known = [float(one) if np.isfinite(one) else UNKNOWN for one in shares]
    return [float(len(found.contacts)), *found.displacement_mm.tolist(), *turn, *known]
