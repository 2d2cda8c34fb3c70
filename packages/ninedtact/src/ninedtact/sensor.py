"""A calibrated sensor at work, from camera image to shape and force. Read this file first.

source ──▶ Frame ──rectify──▶ Rectified ──depth──▶ HeightMap ──estimator──▶ WrenchEstimate

Heights and forces are changes since a reference image (no contact), which `ReferenceImages` keeps.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from time import monotonic_ns
from typing import Annotated

from msgspec import Meta

from ninedtact.bounds import checks_arguments
from ninedtact.capture.frame_source import FrameSource, SourceEnded, require_frame
from ninedtact.errors import CalibrationError
from ninedtact.force.estimator_and_scale import ForceEstimator, NoForceEstimator
from ninedtact.quantities import Frame
from ninedtact.reading import Reading, Stopwatch, read_frame
from ninedtact.reference_images import ReferenceImages
from ninedtact.shape.calibrated_shape import REFERENCE_FRAMES, CalibratedShape, DepthReader


@checks_arguments
@dataclass
class Sensor:
    """A frame source together with a calibration. Open it in a `with` statement while nothing touches the gel.

    Opening the sensor takes the reference image (no contact), unless one is given.
    """

    source: FrameSource
    shape: CalibratedShape
    references: ReferenceImages = field(default_factory=ReferenceImages)
    """The reference image in use, and what replaces it."""
    estimator: ForceEstimator = field(default_factory=NoForceEstimator)
    """Estimates the wrench of every reading; `NoForceEstimator` leaves `Reading.wrench` empty."""
    reference_frames: Annotated[int, Meta(ge=1)] = REFERENCE_FRAMES
    """Number of frames of a reference image that is taken."""
    frames_read: int = field(default=0, init=False)
    """Number of frames read since the sensor was opened, reference frames included."""
    last_frame_ns: int = field(default=0, init=False)
    """Stamp of the newest frame, or the time of opening when none has arrived yet."""
    _first_index: int = field(default=0, init=False, repr=False)
    """Index of the first frame: 0 for a live source, which may have lost earlier ones; a recording may begin with any."""

    def read(self) -> Reading:
        """Wait for the next frame and return its reading.

        Raises `CalibrationError` when the sensor has no reference image, and whatever the source raises.
        """
        self._require_reference()
        watch = Stopwatch()
        frame = self._next_frame()
        depth_reader = self._depth_reader_at(frame.stamp_ns)
        watch.mark("capture")
        dropped = frame.index - self._first_index + 1 - self.frames_read
        reading = read_frame(frame, self.shape, depth_reader, watch, dropped, self.references.memory)
        reading = self.estimator.add_force(reading)
        if reading.force is not None:
            watch.mark("force")
        return self.references.follow(reading)

    @property
    def current_depth_reader(self) -> DepthReader | None:
        """Computes heights against the reference image in use; None before one was taken."""
        return self.references.in_use

    @property
    def reference_faults(self) -> tuple[str, ...]:
        """Why the reference image in use cannot be that of the calibrated sensor; empty where it can."""
        return () if self.references.in_use is None else self.references.in_use.reference_faults

    def take_reference(self) -> None:
        """Average the next frames into a new reference image. Nothing may touch the gel meanwhile.

        Raises `ReferenceUnusable` when the images are too dark, and whatever the source raises.
        """
        frames = list[Frame]()
        try:
            while len(frames) < self.reference_frames:
                frames.append(self._next_frame())
        except SourceEnded as ended:
            raise SourceEnded(
                expected=f"{self.reference_frames} images without contact for the reference",
                got=f"the end of {self.source.name} after {len(frames)}",
                remedy="give a reference image",
            ) from ended
        self.use_reference(frames)

    @checks_arguments
    def use_reference(self, frames: Sequence[Frame]) -> None:
        """Make the mean of frames without contact the reference image from now on; raises `ReferenceUnusable`."""
        self.references.take(frames, self.shape)
        self._forget()

    def open(self, take_reference: bool = True) -> None:
        """Open the source and, unless a reference image is given, take one.

        With `take_reference=False` the caller takes it later. Raises what the source raises; the source is closed then.
        """
        self.source.open_for(self)
        self.frames_read, self.last_frame_ns = 0, monotonic_ns()
        self.references.begin()
        self._forget()
        if take_reference and self.references.in_use is None:
            try:
                self.take_reference()
            except BaseException:
                self.source.close_for(self)
                raise

    def close(self) -> None:
        """Close the source."""
        self.source.close_for(self)

    def _next_frame(self) -> Frame:
        frame = require_frame(self.source.read(), self.source.name)
        if self.frames_read == 0:
            self._first_index = 0 if self.source.is_live else frame.index
        self.frames_read, self.last_frame_ns = self.frames_read + 1, frame.stamp_ns
        return frame

    def _depth_reader_at(self, stamp_ns: int) -> DepthReader:
        """Return the depth reader for the reference image that is to be used at a stamp."""
        if self.references.replace_at(stamp_ns):
            self._forget()
        return self._require_reference()

    def _require_reference(self) -> DepthReader:
        if self.references.in_use is None:
            raise CalibrationError(
                expected="a reference image (no contact) before the first reading",
                got="none",
                remedy="open the sensor in a with statement, or call take_reference()",
            )
        return self.references.in_use

    def _forget(self) -> None:
        """Estimate the next wrench as if it were the first: the images before it had another reference."""
        self.estimator.forget()

    def __iter__(self) -> Iterator[Reading]:
        """Yield readings until the source ends; a camera never does."""
        try:
            while True:
                yield self.read()
        except SourceEnded:
            return

    def __enter__(self) -> "Sensor":
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
