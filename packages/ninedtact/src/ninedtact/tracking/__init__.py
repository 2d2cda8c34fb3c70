"""What touches, followed over time: readings in; contacts, the motion of the object with its covariance, and slip out.

`ContactTracker` does all of it. `ObjectTracker` follows an object by its shape,
`Registration` finds the motion between two readings, and `SlipEstimator` needs no more than displacement and loads.
`SequenceTracker`, with `UprightTracker` and `slip_of_sequence`, is for sensors without a calibration.
"""

from ninedtact.tracking.contact_follower import ContactFollower
from ninedtact.tracking.contact_tracker import ContactTracker, TrackedContacts
from ninedtact.tracking.object_tracker import ObjectMotion, ObjectTracker, TrackState
from ninedtact.tracking.registration import Registration, RegistrationResult
from ninedtact.tracking.rigid_motion import RigidMotion
from ninedtact.tracking.sequence_tracker import SequenceTracker, TrackedImage
from ninedtact.tracking.sliding_springs import SlipSample
from ninedtact.tracking.slip import SlipEstimate, SlipEstimator, SlipState
from ninedtact.tracking.slip_of_sequence import slip_of_sequence
from ninedtact.tracking.touched_surface import TouchedSurface, extract_touched_surface
from ninedtact.tracking.upright_motion import UprightMotion, UprightTracker

__all__ = [
    "ContactFollower",
    "ContactTracker",
    "ObjectMotion",
    "ObjectTracker",
    "Registration",
    "RegistrationResult",
    "RigidMotion",
    "SequenceTracker",
    "SlipEstimate",
    "SlipEstimator",
    "SlipSample",
    "SlipState",
    "TouchedSurface",
    "TrackState",
    "TrackedContacts",
    "TrackedImage",
    "UprightMotion",
    "UprightTracker",
    "extract_touched_surface",
    "slip_of_sequence",
]
