"""Sources in, episode out: nothing that is slow holds a source up, and what is lost is counted."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field

from ninedtact.capture.frame_source import FrameSource, SourceEnded
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.force.estimator import ForceEstimator, NoForce
from ninedtact.quantities import Frame, Wrench
from ninedtact.reading import Reading
from ninedtact.recording.merge_streams import BackgroundReader
from ninedtact.recording.ros_messages import Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.depth import DepthReader

IMAGES_AT_MOST = 128
"""That wait to be written: some 120 MB."""
SAMPLES_AT_MOST = 100_000
WAIT_S = 0.05
REFERENCE_FRAMES = 10


@dataclass
class RecordedEstimates:
    """What images mean, written beside them: heights, and the wrench where there is an estimator.

    The first images are taken for untouched skin, and read like all others.
    """

    shape: CalibratedShape
    estimator: ForceEstimator = field(default_factory=NoForce)
    heights: bool = True
    _first: list[Frame] = field(default_factory=list, init=False)
    _reader: DepthReader | None = field(default=None, init=False)

    @property
    def topics(self) -> set[Topic]:
        """What it writes."""
        wrench = set() if isinstance(self.estimator, NoForce) else {Topic.ESTIMATED}
        return wrench | ({Topic.HEIGHTS} if self.heights else set())

    def write(self, frame: Frame, episode: RecordingWriter) -> None:
        """Read an image."""
        for waiting, reader in self._readable(frame):
            rectified = self.shape.rectify(waiting)
            reading = Reading(waiting, rectified, reader(rectified), reference=reader.reference)
            if self.heights:
                episode.height(reading.height, waiting.index)
            if Topic.ESTIMATED in self.topics:
                episode.estimated(self.estimator.estimate(reading).wrench)

    def _readable(self, frame: Frame) -> Iterator[tuple[Frame, DepthReader]]:
        if self._reader is not None:
            yield frame, self._reader
            return
        self._first.append(frame)
        if len(self._first) == REFERENCE_FRAMES:
            self._reader = self.shape.depth_reader(*self._first)
            yield from ((waiting, self._reader) for waiting in self._first)
            self._first.clear()


@dataclass
class Recorder:
    """Writes what a camera and a force/torque sensor deliver until it is over."""

    episode: RecordingWriter
    camera: FrameSource
    force_torque: WrenchSource | None = None
    interpretation: RecordedEstimates | None = None

    def run(self, is_over: Callable[[], bool], on_progress: Callable[[], None] = lambda: None) -> None:
        """Record; ends well with a recording that is played. Raises what a live source raises, everything before kept."""
        with ExitStack() as opened:
            samples = None
            if self.force_torque is not None:
                samples = opened.enter_context(BackgroundReader[Wrench](self.force_torque, SAMPLES_AT_MOST))
            images = opened.enter_context(BackgroundReader[Frame](self.camera, IMAGES_AT_MOST))
            try:
                while not is_over():
                    self._write_what_came(images, samples)
                    on_progress()
            except SourceEnded:
                return

    def _write_what_came(self, images: BackgroundReader[Frame], samples: BackgroundReader[Wrench] | None) -> None:
        if samples is not None:
            for wrench in waiting(samples):
                self.episode.measured(wrench)
        heard = images.take(WAIT_S)
        if heard is not None:
            self.episode.image(heard.item)
            if self.interpretation is not None:
                self.interpretation.write(heard.item, self.episode)


def waiting(samples: BackgroundReader[Wrench]) -> Iterator[Wrench]:
    """All samples that came."""
    while (heard := samples.take()) is not None:
        yield heard.item
