"""Records a sensor: reads its sources in the background, so that slow writing delays no source, and counts lost items."""

from collections.abc import Callable, Collection, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Event
from time import monotonic, monotonic_ns
from typing import NamedTuple

from ninedtact.calibration.drift.diagnosis_and_reference_check import load_reference_image_checker
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.frame_pacing import DelayCorrectedSource
from ninedtact.capture.frame_source import FrameSource, SourceEnded, SourceIncomplete
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.errors import NinedtactError
from ninedtact.force.estimator_interface import ForceEstimator, NoForceEstimator
from ninedtact.quantities import Frame, Wrench
from ninedtact.reading import Reading, read_frame
from ninedtact.recording.errors import RecordingStopped, ReferenceMomentRefused
from ninedtact.recording.merge_streams import BackgroundReader
from ninedtact.recording.metadata import ImageStorage, RecordingMetadata
from ninedtact.recording.reader import Recording, recorded_sensor_addresses, sensor_folder_attachments
from ninedtact.recording.topics_and_messages import ESTIMATE_TOPICS, RecordingEvent, RecordingEventKind, Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.shape.calibrated_shape import REFERENCE_FRAMES, CalibratedShape, FindReferenceFaults
from ninedtact.shape.depth import DepthReader

_BUFFERED_IMAGES = 128
"""Images that wait to be written at most: about 120 MB."""
_BUFFERED_SAMPLES = 100_000
_WAIT_S = 0.05


def record(
    source: FrameSource,
    out: Path | str,
    sensor: SensorFolder,
    force_torque: WrenchSource | None = None,
    seconds: float | None = None,
    heights: bool = False,
    estimator: ForceEstimator | None = None,
    settings: str = "{}",
    images: ImageStorage = "zstd",
    height_step_mm: float = 0.0,
    camera_delay_ms: float = 0.0,
    should_stop: Callable[[], bool] = lambda: False,
    notify: Callable[[str], None] = lambda sentence: None,
    on_progress: Callable[[RecordingWriter], None] = lambda writer: None,
) -> RecordingWriter:
    """Record a sensor into a new MCAP file until `seconds` are over, `should_stop` is true, or the source ends.

    `record_several` records several sensors into one file. source: opened and closed here. sensor: its folder is attached to the
    file. force_torque: its wrenches are written as measured. heights and estimator: also write heights (mm) and estimated
    wrenches; the first ten frames are then taken as reference images (no contact), and compared with those of the calibration.
    settings: stored in the file, JSON. images: how images are stored, always without loss. height_step_mm: quantisation step of
    heights in 16 bits; 0 for 32-bit floating point. camera_delay_ms: is subtracted from the arrival times of the images. notify:
    called with every fault of the reference, a step of the clock and, after an error, what the file keeps: sentences.
    on_progress: called a few times a second.

    Returns the closed writer, which has the numbers of messages and dropped images. Raises `RecordingRefused`,
    `RecordingStopped`, what a lost device or a damaged video raises, and `ReferenceMomentRefused` where there were too few frames
    for a reference; the file keeps everything recorded before.

    >>> sensor = ninedtact.load_sensor("my_sensor")
    >>> writer = ninedtact.record(ninedtact.source_for("sim"), "press.mcap", sensor, seconds=0.5)
    >>> with ninedtact.Recording("press.mcap") as recording:
    ...     recording.metadata.sensor
    'my_sensor'
    """
    stored = RecordingMetadata(
        sensor.id, settings=settings, images=images, height_step_mm=height_step_mm if heights else 0.0
    )
    part = SensorToRecord(source, sensor, force_torque, estimator, camera_delay_ms)
    recorder = _new_recorder("", part, out, stored, heights, notify)
    end_at = float("inf") if seconds is None else monotonic() + seconds
    with notify_partial_recording(Path(out), notify):
        with recorder.writer as writer:
            recorder.run(lambda: should_stop() or monotonic() >= end_at, lambda: on_progress(writer))
        recorder.require_reference()
    return writer


@dataclass(frozen=True)
class SensorToRecord:
    """A sensor with what is recorded of it."""

    source: FrameSource
    sensor: SensorFolder
    force_torque: WrenchSource | None = None
    estimator: ForceEstimator | None = None
    camera_delay_ms: float = 0.0


def record_several(
    sensors: Mapping[str, SensorToRecord],
    out: Path | str,
    heights: bool = False,
    settings: str = "{}",
    images: ImageStorage = "zstd",
    height_step_mm: float = 0.0,
    should_stop: Callable[[], bool] = lambda: False,
    notify: Callable[[str], None] = lambda sentence: None,
    on_progress: Callable[[Collection[RecordingWriter]], None] = lambda writers: None,
) -> tuple[dict[str, RecordingWriter], dict[str, NinedtactError]]:
    """Record several sensors, by their names, into one new MCAP file, until all sources have ended or `should_stop` is true.

    All sources are opened, or none. A sensor that fails later is reported through `notify` and marked in the file, and the others
    go on; where the file itself can no longer be written (a full disk), all of them end, and what was written before is kept.
    Returns the closed writers, and the errors of those that failed. Raises what `record` raises where nothing is recorded.
    """
    first = RecordingMetadata("", settings=settings, images=images, height_step_mm=height_step_mm if heights else 0.0)
    recorders: dict[str, Recorder] = {}
    for name, part in sensors.items():
        beside = next((one.writer for one in recorders.values()), None)
        said = partial(_notify_of, name, notify)
        recorders[name] = _new_recorder(name, part, out, replace(first, name=name), heights, said, beside)
    writers, errors = {name: recorder.writer for name, recorder in recorders.items()}, dict[str, NinedtactError]()

    ending = Event()

    def write(name: str, streams: "_Streams") -> None:
        recorder = recorders[name]
        try:
            recorder.write(streams, lambda: ending.is_set() or should_stop())
            recorder.require_reference()
        except NinedtactError as error:
            errors[name] = error
            recorder.notify(str(error) if isinstance(error, RecordingStopped) else f"{error}; the others go on")
            with suppress(NinedtactError):
                recorder.writer.write_event(
                    RecordingEvent(monotonic_ns(), RecordingEventKind.REMARK, "lost", str(error))
                )

    with notify_partial_recording(Path(out), notify), next(iter(writers.values())), ExitStack() as opened:
        streams = {name: opened.enter_context(recorder.opened()) for name, recorder in recorders.items()}
        with ThreadPoolExecutor(len(recorders), "record") as pool:
            written = [pool.submit(write, *one) for one in streams.items()]
            try:
                while wait(written, _WAIT_S).not_done:
                    on_progress(writers.values())
            finally:
                ending.set()
            for one in written:
                one.result()
    return writers, errors


def _notify_of(name: str, notify: Callable[[str], None], sentence: str) -> None:
    """Report a sentence about one of several sensors."""
    notify(f"{name}: {sentence}")


def _new_recorder(
    name: str,
    part: SensorToRecord,
    out: Path | str,
    stored: RecordingMetadata,
    heights: bool,
    notify: Callable[[str], None],
    beside: RecordingWriter | None = None,
) -> "Recorder":
    """Return the recorder of one sensor, whose file and sources are still closed."""
    sensor, force_torque, estimates = part.sensor, part.force_torque, None
    if heights or part.estimator:
        find_faults = load_reference_image_checker(sensor).find_faults
        estimates = EstimateRecorder(sensor.shape, part.estimator or NoForceEstimator(), heights, find_faults, notify)
    topics = {Topic.IMAGES, *(estimates.topics if estimates else ()), *([Topic.MEASURED] if force_torque else ())}
    metadata = replace(
        stored,
        sensor=sensor.id,
        source=part.source.name,
        force_torque=force_torque.name if force_torque else "",
        mm_per_px=sensor.shape.rectify.mm_per_px if estimates else 0.0,
        camera_delay_ms=part.camera_delay_ms,
    )
    attachments = sensor_folder_attachments(sensor.path, name)
    writer = RecordingWriter(out, metadata, topics, attachments, notify, beside)
    camera = DelayCorrectedSource(part.source, part.camera_delay_ms) if part.camera_delay_ms else part.source
    return Recorder(writer, camera, force_torque, estimates, notify)


def new_reading_writer(
    path: Path,
    sensor: SensorFolder,
    metadata: RecordingMetadata,
    measured: bool,
    estimated: bool,
    topics: Collection[Topic] = (),
    beside: RecordingWriter | None = None,
) -> RecordingWriter:
    """Return the writer of readings (`RecordingWriter.write_reading`) into a new file, which is not open yet.

    metadata: is completed with what is known of the sensor. measured, estimated: whether such wrenches are
    written. topics: those beside images, reference images and wrenches. beside: the first writer of the same file.
    """
    complete = replace(metadata, sensor=sensor.id, mm_per_px=sensor.shape.rectify.mm_per_px)
    written = {Topic.IMAGES, Topic.REFERENCE_GREY, *topics, *(ESTIMATE_TOPICS if estimated else ())}
    written |= {Topic.MEASURED} if measured else set()
    attachments = sensor_folder_attachments(sensor.path, metadata.name)
    return RecordingWriter(path, complete, written, attachments, beside=beside)


@contextmanager
def notify_partial_recording(path: Path, notify: Callable[[str], None]) -> Iterator[None]:
    """Where the block fails, notify of what the recording that it began holds, as read back from the file."""
    existed = path.exists()
    try:
        yield
    except BaseException:
        with suppress(NinedtactError, OSError):
            if not existed and path.exists():
                counts = []
                for address in recorded_sensor_addresses(path):
                    with Recording(address) as recording:
                        counts += [f"{topic.messages} of {topic.topic}" for topic in recording.summary().topics]
                notify(f"{path} keeps the messages before the failure: {', '.join(counts)}")
        raise


@dataclass
class ReadingComputer:
    """Computes readings from frames, against a known reference image (no contact) or that of the first ten frames."""

    shape: CalibratedShape
    find_reference_faults: FindReferenceFaults = lambda _: ()
    depth_reader: DepthReader | None = None
    """Computes heights against a reference image that is known; None takes that of the first ten frames."""
    _first: list[Frame] = field(default_factory=list, init=False)

    def require_reference(self) -> None:
        """Raise `ReferenceMomentRefused` where the frames so far were too few for reference images."""
        if self.depth_reader is None:
            raise ReferenceMomentRefused(
                f"expected at least {REFERENCE_FRAMES} images for the reference of heights and forces, got {len(self._first)}, "
                "so that neither was computed; record longer"
            )

    def readings(self, frame: Frame) -> Iterator[Reading]:
        """Yield the readings that this frame completes: none for the first nine frames, ten for the tenth, then one."""
        for waiting, depth_reader in self._readable(frame):
            yield read_frame(waiting, self.shape, depth_reader)

    def _readable(self, frame: Frame) -> Iterator[tuple[Frame, DepthReader]]:
        if self.depth_reader is not None:
            yield frame, self.depth_reader
            return
        self._first.append(frame)
        if len(self._first) == REFERENCE_FRAMES:
            reader = self.depth_reader = self.shape.depth_reader(*self._first, find_faults=self.find_reference_faults)
            yield from ((waiting, reader) for waiting in self._first)
            self._first.clear()


@dataclass
class EstimateRecorder:
    """Computes heights and wrenches of frames and writes them beside the images."""

    shape: CalibratedShape
    estimator: ForceEstimator = field(default_factory=NoForceEstimator)
    heights: bool = True
    find_reference_faults: FindReferenceFaults = lambda _: ()
    notify: Callable[[str], None] = lambda sentence: None
    """Receives a sentence about every fault of the reference."""

    def __post_init__(self) -> None:
        self._computer = ReadingComputer(self.shape, self.find_reference_faults)
        self._has_reported = False
        self._estimates_force = not isinstance(self.estimator, NoForceEstimator)

    @property
    def topics(self) -> set[Topic]:
        """The topics that `write` writes to."""
        return {*(ESTIMATE_TOPICS if self._estimates_force else ()), *([Topic.HEIGHTS] if self.heights else ())}

    def require_reference(self) -> None:
        """Raise `ReferenceMomentRefused` where nothing could be written for lack of reference images."""
        self._computer.require_reference()

    def write(self, frame: Frame, writer: RecordingWriter) -> None:
        """Write heights and estimate of a frame, and of the first frames once the reference is known."""
        for reading in self._computer.readings(frame):
            self._report_faults(reading.stamp_ns, writer)
            if self._estimates_force:
                reading = reading.with_force(self.estimator.estimate(reading))
            writer.write_measurements(reading)

    def _report_faults(self, stamp_ns: int, writer: RecordingWriter) -> None:
        """Report the faults of the reference once, as remarks in the recording and to the person who records."""
        if self._has_reported or self._computer.depth_reader is None:
            return
        self._has_reported = True
        for fault in self._computer.depth_reader.reference_faults:
            writer.write_event(RecordingEvent(stamp_ns, RecordingEventKind.REMARK, "reference image", fault))
            self.notify(f"the reference image is doubtful; {fault}")


class _Streams(NamedTuple):
    """What the devices of a sensor deliver."""

    images: BackgroundReader[Frame]
    samples: BackgroundReader[Wrench] | None


@dataclass
class Recorder:
    """Writes what a camera and a force/torque sensor deliver into an open recording."""

    writer: RecordingWriter
    camera: FrameSource
    force_torque: WrenchSource | None = None
    estimates: EstimateRecorder | None = None
    notify: Callable[[str], None] = lambda sentence: None
    """Receives a sentence each time that a device has delivered nothing for a while."""

    def run(self, should_stop: Callable[[], bool], on_progress: Callable[[], None] = lambda: None) -> None:
        """Open the devices and `write`."""
        with self.opened() as streams:
            self.write(streams, should_stop, on_progress)

    @contextmanager
    def opened(self) -> Iterator["_Streams"]:
        """Read the devices in the background while the block runs; raises what opening them raises."""
        with ExitStack() as opened:
            samples = None
            if self.force_torque is not None:
                wrenches = BackgroundReader[Wrench](self.force_torque, _BUFFERED_SAMPLES, on_stall=self.notify)
                samples = opened.enter_context(wrenches)
            frames = BackgroundReader[Frame](self.camera, _BUFFERED_IMAGES, on_stall=self.notify)
            yield _Streams(opened.enter_context(frames), samples)

    def write(
        self, streams: "_Streams", should_stop: Callable[[], bool], on_progress: Callable[[], None] = lambda: None
    ) -> None:
        """Record until `should_stop` is true or the source ends, all that was read until then.

        Raises what a live source raises, and `SourceIncomplete` for a damaged file, whose last images are then counted as dropped.
        """
        try:
            while not should_stop():
                self._write_arrivals(*streams)
                on_progress()
            for _ in range(streams.images.waiting):  # what was read before the end, while writing was slow
                self._write_arrivals(*streams)
        except SourceEnded:
            return
        except SourceIncomplete as damage:
            self.writer.count_dropped(damage.uncounted)
            raise

    def require_reference(self) -> None:
        """Raise `ReferenceMomentRefused` where heights or forces could not be written for lack of reference images."""
        if self.estimates is not None:
            self.estimates.require_reference()

    def _write_arrivals(self, images: BackgroundReader[Frame], samples: BackgroundReader[Wrench] | None) -> None:
        while samples is not None and (sample := samples.take()) is not None:
            self.writer.write_measured(sample.item)
        arrival = images.take(_WAIT_S)
        if arrival is not None:
            self.writer.write_image(arrival.item)
            if self.estimates is not None:
                self.estimates.write(arrival.item, self.writer)
