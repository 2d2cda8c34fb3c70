"""What touches, followed over time: the motion of an object on the skin from frame to frame, with its covariance.

`ObjectTracker` follows an object through a stream of readings; `register` finds the motion between two of them.
"""

from ninedtact.tracking.object_tracker import ObjectMotion, ObjectTracker, TrackState
from ninedtact.tracking.registration import Registration, RegistrationResult
from ninedtact.tracking.rigid_motion import RigidMotion
from ninedtact.tracking.slip import SlipEstimate, SlipEstimator, SlipState
from ninedtact.tracking.touched_surface import TouchedSurface, touched_surface

__all__ = [
    "ObjectMotion",
    "ObjectTracker",
    "Registration",
    "RegistrationResult",
    "RigidMotion",
    "SlipEstimate",
    "SlipEstimator",
    "SlipState",
    "TouchedSurface",
    "TrackState",
    "touched_surface",
]
