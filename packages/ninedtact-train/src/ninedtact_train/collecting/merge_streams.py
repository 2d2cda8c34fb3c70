"""Merges the frames of a camera and the samples of a force/torque sensor into one stream.

Live sources are read in background threads and merged as their items arrive; recordings and simulated sources are merged in
the order of their stamps.
"""

from collections.abc import Callable, Generator

from ninedtact.capture.frame_source import FrameSource, SourceEnded
from ninedtact.capture.wrench_source import WrenchSampleRejected, WrenchSource
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.background_reader import STALL_S, Arrival, BackgroundReader

_READ_AHEAD_NS = 300_000_000
"""Time by which samples are read ahead of the newest frame before the next frame is read."""
_BUFFERED_IMAGES, _BUFFERED_SAMPLES = 128, 100_000
_WAIT_S = 0.02

MergedArrival = Arrival[Frame | Wrench | WrenchSampleRejected] | None
"""An arrival, or None where nothing arrived for a moment."""


def merge_live_streams(
    camera: FrameSource,
    force_torque: WrenchSource,
    on_stall: Callable[[str], None] = lambda sentence: None,
    stall_s: float = STALL_S,
) -> Generator[MergedArrival, None, None]:
    """Yield what two devices deliver, each read in its own thread; raises what they raise, ends with a recording.

    on_stall: called with a sentence each time that a device has delivered nothing for `stall_s`.
    """
    with (
        BackgroundReader[Wrench](
            force_torque, _BUFFERED_SAMPLES, WrenchSampleRejected, on_stall=on_stall, stall_s=stall_s
        ) as samples,
        BackgroundReader[Frame](camera, _BUFFERED_IMAGES, on_stall=on_stall, stall_s=stall_s) as images,
    ):
        try:
            while True:
                while (sample := samples.take()) is not None:
                    yield sample
                yield images.take(_WAIT_S)
        except SourceEnded:
            return


def merge_recorded_streams(camera: FrameSource, force_torque: WrenchSource) -> Generator[MergedArrival, None, None]:
    """Yield every frame and every sample in the order of their stamps, as fast as they are requested, until one source ends.

    Samples are read ahead, so that frames follow the last sample, up to its stamp.
    """
    newest_ns, has_samples = 0, True
    with force_torque, camera:
        try:
            while True:
                frame = camera.read()
                if not has_samples and frame.stamp_ns > newest_ns:
                    return
                yield Arrival(frame, frame.stamp_ns)
                while has_samples and newest_ns < frame.stamp_ns + _READ_AHEAD_NS:
                    if (sample := _read_sample(force_torque)) is None:
                        has_samples = False
                        break
                    newest_ns = max(newest_ns, sample.stamp_ns if isinstance(sample, Wrench) else 0)
                    yield Arrival(sample, newest_ns)
        except SourceEnded:
            return


def _read_sample(force_torque: WrenchSource) -> Wrench | WrenchSampleRejected | None:
    """Return the next sample, or the reason for its rejection; None after the last one."""
    try:
        return force_torque.read()
    except WrenchSampleRejected as reason:
        return reason
    except SourceEnded:
        return None
