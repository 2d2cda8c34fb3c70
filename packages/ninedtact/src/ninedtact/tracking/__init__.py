"""What touches, followed over time: the motion of an object on the skin from frame to frame, with its covariance.

`ObjectTracker` follows an object through a stream of readings; `register` finds the motion between two of them. `UprightTracker`
and `slip_of_sequence` are for sensors without a calibration.
"""

from ninedtact.tracking.object_tracker import ObjectMotion, ObjectTracker, TrackState
from ninedtact.tracking.registration import Registration, RegistrationResult
from ninedtact.tracking.rigid_motion import RigidMotion
from ninedtact.tracking.slip import SlipEstimate, SlipEstimator, SlipState
from ninedtact.tracking.slip_of_sequence import SlipSample, slip_of_sequence
from ninedtact.tracking.touched_surface import TouchedSurface, touched_surface
from ninedtact.tracking.upright_motion import UprightMotion, UprightTracker

__all__ = [
    "ObjectMotion",
    "ObjectTracker",
    "Registration",
    "RegistrationResult",
    "RigidMotion",
    "SlipEstimate",
    "SlipEstimator",
    "SlipSample",
    "SlipState",
    "TouchedSurface",
    "TrackState",
    "UprightMotion",
    "UprightTracker",
    "slip_of_sequence",
    "touched_surface",
]
