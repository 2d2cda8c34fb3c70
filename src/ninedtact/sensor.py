"""A calibrated sensor at work, from camera image to shape and force. Read this file first.

source ──▶ Frame ──rectify──▶ Rectified ──depth──▶ HeightMap ──estimator──▶ WrenchEstimate
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from time import monotonic_ns
from types import TracebackType

from ninedtact.capture.frame_source import FrameSource, SourceEnded
from ninedtact.errors import CalibrationError
from ninedtact.force.estimator_interface import ForceEstimator
from ninedtact.quantities import Frame, Rectified, WrenchEstimate
from ninedtact.reading import CheckedReference, Reading, Stopwatch, read_frame
from ninedtact.reference_following import FollowingSettings, ReferenceFollower
from ninedtact.shape.calibrated_shape import REFERENCE_FRAMES, CalibratedShape
from ninedtact.shape.depth import DepthReader


class ReferenceMissing(CalibrationError):
    """A reading was asked for before the sensor had a reference image."""


@dataclass
class _SessionReference:
    """The reference image that an opened sensor uses now, and where it comes from."""

    reader: DepthReader | None
    """Computes heights against this image; None until one was taken."""
    faults: tuple[str, ...] = ()
    """Why it cannot be that of the calibrated sensor."""
    follower: ReferenceFollower | None = None
    """Moves it while nothing touches; None before the first reading that may move it."""
    last_recorded: CheckedReference | None = None
    """The one that a recording gave last."""
    is_chosen: bool = False
    """Whether it was taken or given since the opening, which ends the use of recorded ones."""
    later_used: int = 0
    """Number of later references that have come into use."""


def _assume_faultless(_: Sequence[Frame]) -> Sequence[str]:
    """Return no fault."""
    return ()


@dataclass
class Sensor:
    """A frame source together with a calibration. Open it in a `with` statement while nothing touches the gel.

    Opening the sensor takes the reference image (no contact), unless a depth reader with a reference is given.
    """

    source: FrameSource
    shape: CalibratedShape
    reference_frames: int = REFERENCE_FRAMES
    depth_reader: DepthReader | None = None
    """Computes heights against the reference image with which every opening begins; None takes a new one at every opening."""
    later_references: Sequence[Sequence[Frame]] = ()
    """Reference images of a recording that replace the present ones from the stamp of their first on, in order of time."""
    recorded_reference: Callable[[int], CheckedReference | None] | None = None
    """Returns the reference image that a recording has for a stamp, the same object until it changes."""
    estimator: ForceEstimator | None = None
    """Estimates the wrench of every reading; None leaves `Reading.wrench` empty."""
    find_reference_faults: Callable[[Sequence[Frame]], Sequence[str]] = _assume_faultless
    """Returns why frames cannot be reference images of the calibrated sensor; called once for every reference that is taken."""
    given_reference_faults: tuple[str, ...] = ()
    """Why the reference image that is given with a depth reader cannot be that of the calibrated sensor."""
    following: FollowingSettings | None = None
    """How the reference image follows slow changes while nothing touches; None keeps it as it was taken."""
    frames_read: int = field(default=0, init=False)
    """Number of frames read since the sensor was opened, reference frames included."""
    last_frame_ns: int = field(default=0, init=False)
    """Stamp of the newest frame, or the time of opening when none has arrived yet."""
    _first_index: int = field(default=0, init=False, repr=False)
    """Index of the first frame: 0 for a live source, which may have lost earlier ones; a recording may begin with any."""
    _session: _SessionReference = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._begin_session()

    def read(self) -> Reading:
        """Wait for the next frame and return its reading.

        Raises `ReferenceMissing` when the sensor has no reference image, and whatever the source raises.
        """
        self._require_reference()
        watch = Stopwatch()
        frame = self._next_frame()
        self._use_recorded_reference(frame.stamp_ns)
        self._use_later_reference(frame.stamp_ns)
        watch.mark("capture")
        depth = self._require_reference()
        dropped = frame.index - self._first_index + 1 - self.frames_read
        reading = read_frame(frame, self.shape, depth, self._session.faults, watch, dropped)
        estimate = None
        if self.estimator is not None:
            estimate = self.estimator.estimate(reading)
            watch.mark("force")
        if self.following is not None:
            estimate = self._follow(reading, estimate, depth.reference, self.following)
        return reading if estimate is None else reading.with_force(estimate)

    def _follow(
        self, reading: Reading, estimate: WrenchEstimate | None, reference: Rectified, settings: FollowingSettings
    ) -> WrenchEstimate | None:
        """Let the reference follow for the next reading; return the estimate with the error of gel that is still settling."""
        if self._session.follower is None:
            self._session.follower = ReferenceFollower(reference, settings)
        follower = self._session.follower
        moved = follower.follow(reading, estimate)
        if moved is not None:
            self._session.reader = self.shape.reader_against(moved)
        return None if estimate is None else follower.with_settling_error(estimate)

    @property
    def current_depth_reader(self) -> DepthReader | None:
        """Computes heights against the reference image in use; None before one was taken."""
        return self._session.reader

    @property
    def reference_faults(self) -> tuple[str, ...]:
        """Why the reference image in use cannot be that of the calibrated sensor; empty where it can."""
        return self._session.faults

    @property
    def reference_drift(self) -> float:
        """Relative change of the reference image's mean brightness since it was taken; zero where it does not follow."""
        return 0.0 if self._session.follower is None else self._session.follower.drift

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
                f"expected {self.reference_frames} images without contact for the reference, got the end of {self.source.name} "
                f"after {len(frames)}; give a reference image"
            ) from ended
        self.use_reference(frames)

    def use_reference(self, frames: Sequence[Frame]) -> None:
        """Make the mean of frames without contact the reference image from now on; raises `ReferenceUnusable`."""
        self._session = replace(
            self._session,
            reader=self.shape.depth_reader(*frames),
            faults=tuple(self.find_reference_faults(frames)),
            follower=None,
            is_chosen=True,
        )
        if self.estimator is not None:
            self.estimator.forget()

    def open(self, take_reference: bool = True) -> None:
        """Open the source and, unless a depth reader was given, take the reference image.

        With `take_reference=False` the caller takes it later. Raises what the source raises; the source is closed then.
        """
        self.source.open()
        self.frames_read, self.last_frame_ns = 0, monotonic_ns()
        self._begin_session()
        if self.estimator is not None:
            self.estimator.forget()
        if take_reference and self.depth_reader is None:
            try:
                self.take_reference()
            except BaseException:
                self.source.close()
                raise

    def close(self) -> None:
        """Close the source."""
        self.source.close()

    def _begin_session(self) -> None:
        """Use the given reference, if there is one, and nothing of an earlier session."""
        faults = () if self.depth_reader is None else self.given_reference_faults
        self._session = _SessionReference(self.depth_reader, faults)

    def _use_recorded_reference(self, now_ns: int) -> None:
        """Use the reference that a recording has for this moment, unless another was chosen since the opening."""
        if self.recorded_reference is None or self._session.is_chosen:
            return
        found = self.recorded_reference(now_ns)
        if found is not None and found is not self._session.last_recorded:
            self._session = replace(
                self._session, reader=found.reader, faults=found.faults, last_recorded=found, follower=None
            )

    def _use_later_reference(self, now_ns: int) -> None:
        """Use a later reference where its moment has come."""
        later = self.later_references[self._session.later_used :]
        due = [frames for frames in later if frames[0].stamp_ns <= now_ns]
        if due:
            self.use_reference(due[-1])
            self._session.later_used += len(due)

    def _next_frame(self) -> Frame:
        frame = self.source.read()
        if self.frames_read == 0:
            self._first_index = 0 if self.source.is_live else frame.index
        self.frames_read, self.last_frame_ns = self.frames_read + 1, frame.stamp_ns
        return frame

    def _require_reference(self) -> DepthReader:
        if self._session.reader is None:
            raise ReferenceMissing(
                "expected a reference image (no contact) before the first reading, got none; open the sensor in a with "
                "statement, or call take_reference()"
            )
        return self._session.reader

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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
