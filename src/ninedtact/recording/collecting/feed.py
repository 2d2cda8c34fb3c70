"""Images and samples in one stream: live ones as they come, those of recordings and stepped twins in turn."""

from collections.abc import Generator

from ninedtact.capture.force_torque.refusals import WrenchUntrusted
from ninedtact.capture.source import FrameSource, SourceEnded
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.listening import Heard, Listening

AHEAD_NS = 300_000_000
"""By which samples are read before the next image is."""
IMAGES_AT_MOST, SAMPLES_AT_MOST = 128, 100_000
WAIT_S = 0.02

Fed = Heard[Frame | Wrench | WrenchUntrusted] | None
"""None: nothing came for a moment."""


def live(camera: FrameSource, force_torque: WrenchSource) -> Generator[Fed, None, None]:
    """What two devices deliver, each read in a thread of its own; raises what they raise, ends with a recording."""
    with (
        Listening[Wrench](force_torque, SAMPLES_AT_MOST, WrenchUntrusted) as samples,
        Listening[Frame](camera, IMAGES_AT_MOST) as images,
    ):
        try:
            while True:
                while (sample := samples.take()) is not None:
                    yield sample
                yield images.take(WAIT_S)
        except SourceEnded:
            return


def in_turn(camera: FrameSource, force_torque: WrenchSource) -> Generator[Fed, None, None]:
    """Every image and every sample in the order of their stamps, as fast as they are asked for, until one ends."""
    newest_ns = 0
    with force_torque, camera:
        try:
            while True:
                frame = camera.read()
                yield Heard(frame, frame.stamp_ns)
                while newest_ns < frame.stamp_ns + AHEAD_NS:
                    sample = next_sample(force_torque)
                    newest_ns = max(newest_ns, sample.stamp_ns if isinstance(sample, Wrench) else 0)
                    yield Heard(sample, newest_ns)
        except SourceEnded:
            return


def next_sample(force_torque: WrenchSource) -> Wrench | WrenchUntrusted:
    """The next one, or why it must not be used."""
    try:
        return force_torque.read()
    except WrenchUntrusted as reason:
        return reason
