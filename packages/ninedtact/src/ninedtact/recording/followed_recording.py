"""What touches in the images of a recording, followed from its beginning, as exports write it."""

from collections.abc import Iterator

from ninedtact.recording.reader import Recording
from ninedtact.tracking import ContactTracker, TrackedContacts


def follow_recording(recording: Recording) -> Iterator[TrackedContacts]:
    """Yield what touches in every image, by the sensor of the recording; slip is known where the wrench was recorded.

    Raises what `Recording.readings` raises.
    """
    estimates = {one.wrench.stamp_ns: one for one in recording.estimates()}
    readings = recording.readings()
    return ContactTracker().follow(
        one.with_force(estimates[one.stamp_ns]) if one.stamp_ns in estimates else one for one in readings
    )
