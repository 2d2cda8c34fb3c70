"""A sensor at work: the shape and force rows of the flow, top-down. Read this file first.

source ──▶ Frame ──rectify──▶ Rectified ──depth──▶ HeightMap ──estimator──▶ WrenchEstimate
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from time import monotonic_ns, perf_counter
from types import TracebackType

from ninedtact.capture.frame_source import FrameSource, SourceEnded
from ninedtact.force.estimator import ForceEstimator, NoForce
from ninedtact.quantities import Frame, Reading
from ninedtact.shape.calibrated import CalibratedShape
from ninedtact.shape.depth import DepthReader

REFERENCE_FRAMES = 10
"""Frames of untouched skin averaged when a session starts: their noise falls below that of a reading."""


class Stopwatch:
    """Milliseconds of each stage since the last mark."""

    def __init__(self) -> None:
        self.stage_ms: dict[str, float] = {}
        self._last = perf_counter()

    def mark(self, stage: str) -> None:
        """The time since the last mark belongs to this stage."""
        now = perf_counter()
        self.stage_ms[stage], self._last = (now - self._last) * 1e3, now


@dataclass
class Sensor:
    """A frame source with a calibration. Open it with `with`; the skin must be untouched then."""

    source: FrameSource
    calibrated: CalibratedShape
    reference_frames: int = REFERENCE_FRAMES
    depth: DepthReader | None = None
    """Bound to the untouched skin of this session when the sensor is opened; given here, it is kept."""
    estimator: ForceEstimator = field(default_factory=NoForce)
    """What reads the wrench out of each reading."""
    frames_read: int = field(default=0, init=False)
    """Since the sensor was opened."""
    heard_ns: int = field(default=0, init=False)
    """Stamp of the newest frame, or of the opening: the source has been silent since."""

    def read(self) -> Reading:
        """The newest reading: waits for the next frame; raises what the source raises."""
        watch = Stopwatch()
        frame = self.next_frame()
        watch.mark("capture")
        rectified = self.calibrated.rectify(frame)
        watch.mark("rectify")
        height = self.reader(rectified)
        watch.mark("depth")
        dropped = frame.index + 1 - self.frames_read
        reading = Reading(frame, rectified, height, watch.stage_ms, dropped, self.reader.reference)
        force = self.estimator.estimate(reading)
        watch.mark("force")
        return replace(reading, force=force)

    def next_frame(self) -> Frame:
        """Wait for the next frame of the source, and count it."""
        frame = self.source.read()
        self.frames_read, self.heard_ns = self.frames_read + 1, frame.stamp_ns
        return frame

    @property
    def reader(self) -> DepthReader:
        """The depth reader of this session; the first use without one takes the reference."""
        if self.depth is None:
            self.take_reference()
        assert self.depth is not None
        return self.depth

    def take_reference(self) -> None:
        """Take the skin as it is now for untouched."""
        frames = [self.next_frame() for _ in range(self.reference_frames)]
        self.depth = self.calibrated.depth_reader(*frames)
        self.estimator.forget()

    def __iter__(self) -> Iterator[Reading]:
        try:
            while True:
                yield self.read()
        except SourceEnded:
            return

    def __enter__(self) -> "Sensor":
        self.source.__enter__()
        self.frames_read, self.heard_ns = 0, monotonic_ns()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.source.__exit__(kind, error, trace)
