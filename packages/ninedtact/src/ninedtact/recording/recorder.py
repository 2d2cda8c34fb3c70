"""Records a sensor: reads its sources in the background, so that slow writing delays no source, and counts lost items."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import Event
from time import monotonic, monotonic_ns
from typing import Annotated, Any

from msgspec import Meta

from ninedtact.bounds import checks_arguments
from ninedtact.calibration.drift.reference_check import load_reference_image_checker
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.frame_pacing import DelayCorrectedSource
from ninedtact.capture.frame_source import FrameSource, SourceEnded, SourceIncomplete
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.errors import InputError, NinedtactError
from ninedtact.force.estimator_and_scale import ForceEstimator, NoForceEstimator
from ninedtact.quantities import Frame, Wrench
from ninedtact.reading import read_frame
from ninedtact.recording.attached_sensor import sensor_folder_attachments
from ninedtact.recording.background_reader import STALL_S, BackgroundReader
from ninedtact.recording.errors import RecordingStopped
from ninedtact.recording.metadata import ImageStorage, RecordingMetadata
from ninedtact.recording.reader import Recording, recorded_sensor_addresses
from ninedtact.recording.topics_and_messages import ESTIMATE_TOPICS, RecordingEvent, RecordingEventKind, Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.shape.calibrated_shape import REFERENCE_FRAMES, CalibratedShape, DepthReader, FindReferenceFaults

_BUFFERED_IMAGES = 128
"""Images that wait to be written at most: about 120 MB."""
_BUFFERED_SAMPLES = 100_000
_WAIT_S = 0.05


@checks_arguments
def record(
    source: FrameSource,
    out: Path | str,
    sensor: SensorFolder,
    force_torque: WrenchSource | None = None,
    seconds: Annotated[float, Meta(gt=0)] | None = None,
    heights: bool = False,
    estimator: ForceEstimator = NoForceEstimator(),
    settings: str = "{}",
    images: ImageStorage = "zstd",
    height_step_mm: Annotated[float, Meta(ge=0)] = 0.0,
    camera_delay_ms: float = 0.0,
    should_stop: Callable[[], bool] = lambda: False,
    notify: Callable[[str], None] = lambda sentence: None,
    on_progress: Callable[[RecordingWriter], None] = lambda writer: None,
) -> RecordingWriter:
    """Record a sensor into a new MCAP file until `seconds` are over, `should_stop` is true, or the source ends.

    `record_several` records several sensors into one file. source: opened and closed here. sensor: its folder is attached to the
    file. force_torque: its wrenches are written as measured. heights and estimator: also write heights (mm) and estimated
    wrenches; the first ten frames are then taken as reference images (no contact), and compared with those of the calibration. A
    twin brings reference images of its own, which are written too.
    settings: stored in the file, JSON. images: how images are stored, always without loss. height_step_mm: quantisation step of
    heights in 16 bits; 0 for 32-bit floating point. camera_delay_ms: is subtracted from the arrival times of the images. notify:
    called with every fault of the reference, a step of the clock and, after an error, what the file keeps: sentences.
    on_progress: called a few times a second.

    Returns the closed writer, which has the numbers of messages and dropped images. Raises `OutputError`,
    `RecordingStopped`, what a lost device or a damaged video raises, and `InputError` where there were too few frames
    for a reference; the file keeps everything recorded before.

    >>> sensor = ninedtact.load_sensor("my_sensor")
    >>> writer = ninedtact.record(ninedtact.source_for("sim"), "press.mcap", sensor, seconds=0.5)
    >>> with ninedtact.Recording("press.mcap") as recording:
    ...     recording.metadata.sensor
    'my_sensor'
    """
    writers, _ = record_several(
        {"": SensorToRecord(source, sensor, force_torque, estimator, camera_delay_ms)},
        out,
        heights,
        settings,
        images,
        height_step_mm,
        seconds,
        should_stop,
        notify,
        on_progress=lambda writers: on_progress(*writers),
    )
    return writers[""]


@checks_arguments
@dataclass(frozen=True)
class SensorToRecord:
    """A sensor with what is recorded of it."""

    source: FrameSource
    sensor: SensorFolder
    force_torque: WrenchSource | None = None
    estimator: ForceEstimator = field(default_factory=NoForceEstimator)
    camera_delay_ms: float = 0.0


def record_several(
    sensors: Mapping[str, SensorToRecord],
    out: Path | str,
    heights: bool = False,
    settings: str = "{}",
    images: ImageStorage = "zstd",
    height_step_mm: float = 0.0,
    seconds: float | None = None,
    should_stop: Callable[[], bool] = lambda: False,
    notify: Callable[[str], None] = lambda sentence: None,
    on_progress: Callable[[Collection[RecordingWriter]], None] = lambda writers: None,
) -> tuple[dict[str, RecordingWriter], dict[str, NinedtactError]]:
    """Record several sensors, by their names, into one new MCAP file, until all sources have ended, `seconds` are over since
    all of them were opened, or `should_stop` is true.

    All sources are opened, or none. A sensor that fails later is reported through `notify` and marked in the file, and the others
    go on; where the file itself can no longer be written (a full disk), all of them end, and what was written before is kept. The
    only sensor of a file may have an empty name; what it raises is raised. Returns the closed writers, and the errors of those that
    failed. Raises what `record` raises where nothing is recorded.
    """
    first = RecordingMetadata("", settings=settings, images=images, height_step_mm=height_step_mm if heights else 0.0)
    recorders: dict[str, Recorder] = {}
    for name, part in sensors.items():
        beside = next((one.writer for one in recorders.values()), None)
        said = partial(lambda beginning, sentence: notify(beginning + sentence), f"{name}: " if name else "")
        recorders[name] = _new_recorder(part, out, replace(first, name=name), heights, said, beside)
    writers, errors = {name: recorder.writer for name, recorder in recorders.items()}, dict[str, NinedtactError]()
    ending, end_at = Event(), float("inf")

    def write(name: str) -> None:
        recorder = recorders[name]
        try:
            recorder.write(lambda: ending.is_set() or monotonic() >= end_at or should_stop())
            if recorder.estimates is not None:
                recorder.estimates.require_reference()
        except NinedtactError as error:
            if not name:
                raise
            errors[name] = error
            recorder.notify(str(error) if isinstance(error, RecordingStopped) else f"{error}; the others go on")
            with suppress(NinedtactError):
                recorder.writer.write_event(
                    RecordingEvent(monotonic_ns(), RecordingEventKind.REMARK, "lost", str(error))
                )

    with notify_partial_recording(Path(out), notify), next(iter(writers.values())), ExitStack() as opened:
        for recorder in recorders.values():
            opened.enter_context(recorder.opened())
        end_at = float("inf") if seconds is None else monotonic() + seconds
        with ThreadPoolExecutor(len(recorders), "record") as pool:
            written = [pool.submit(write, name) for name in recorders]
            try:
                while wait(written, _WAIT_S).not_done:
                    on_progress(writers.values())
            finally:
                ending.set()
            for one in written:
                one.result()
    return writers, errors


def _new_recorder(
    part: SensorToRecord,
    out: Path | str,
    stored: RecordingMetadata,
    heights: bool,
    notify: Callable[[str], None],
    beside: RecordingWriter | None = None,
) -> "Recorder":
    sensor, force_torque, estimates = part.sensor, part.force_torque, None
    if heights or not isinstance(part.estimator, NoForceEstimator):
        find_faults = load_reference_image_checker(sensor).find_faults
        estimates = EstimateRecorder(sensor.shape, part.estimator, heights, find_faults, notify)
    references = [Topic.REFERENCE] if part.source.reference_frames else []
    topics = {
        Topic.IMAGES,
        *references,
        *(estimates.topics if estimates else ()),
        *([Topic.MEASURED] if force_torque else ()),
    }
    metadata = replace(
        stored,
        source=part.source.name,
        force_torque=force_torque.name if force_torque else "",
        camera_delay_ms=part.camera_delay_ms,
        estimate_notices="; ".join(part.estimator.notices),
    )
    writer = new_sensor_writer(out, sensor, metadata, topics, notify, beside)
    camera = DelayCorrectedSource(part.source, part.camera_delay_ms) if part.camera_delay_ms else part.source
    return Recorder(writer, camera, force_torque, estimates, notify)


def new_sensor_writer(
    path: Path | str,
    sensor: SensorFolder,
    metadata: RecordingMetadata,
    topics: Collection[Topic],
    notify: Callable[[str], None] = lambda sentence: None,
    beside: RecordingWriter | None = None,
) -> RecordingWriter:
    """Return the writer of a sensor into a new file, to which its folder is attached, and which is not open yet.

    metadata: is completed with what is known of the sensor. The others are as of `RecordingWriter`.
    """
    has_scale = not {Topic.HEIGHTS, Topic.ESTIMATED, Topic.REFERENCE_GREY}.isdisjoint(topics)
    complete = replace(metadata, sensor=sensor.id, mm_per_px=sensor.shape.rectify.mm_per_px if has_scale else 0.0)
    return RecordingWriter(
        path, complete, topics, sensor_folder_attachments(sensor.path, metadata.name), notify, beside
    )


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
class EstimateRecorder:
    """Computes heights and wrenches of frames and writes them beside the images.

    The reference is that of the images that the source brings, as a twin does, otherwise that of the first ten.
    """

    shape: CalibratedShape
    estimator: ForceEstimator = field(default_factory=NoForceEstimator)
    heights: bool = True
    find_reference_faults: FindReferenceFaults = lambda _: ()
    notify: Callable[[str], None] = lambda sentence: None
    """Receives a sentence about every fault of the reference."""
    _first: list[Frame] = field(default_factory=list, init=False)
    _depth_reader: DepthReader | None = field(default=None, init=False)

    @property
    def topics(self) -> set[Topic]:
        """The topics that `write` writes to."""
        return {*(ESTIMATE_TOPICS if self._estimates_force else ()), *([Topic.HEIGHTS] if self.heights else ())}

    def require_reference(self) -> None:
        """Raise `InputError` where the frames were too few for reference images, so that nothing was written."""
        if self._depth_reader is None:
            raise InputError(
                expected=f"at least {REFERENCE_FRAMES} images for the reference of heights and forces",
                got=f"{len(self._first)}, so that neither was computed",
                remedy="record longer",
            )

    def write(self, frame: Frame, writer: RecordingWriter, brought: Sequence[Frame] = ()) -> None:
        """Write heights and estimate of a frame, and of the first frames once the reference is known.

        brought: reference images that the source brings.
        """
        self._first.append(frame)
        if self._depth_reader is None:
            references = brought or self._first
            if len(references) < REFERENCE_FRAMES:
                return
            self._depth_reader = self.shape.depth_reader(*references, find_faults=self.find_reference_faults)
            for fault in self._depth_reader.reference_faults:
                remark = RecordingEvent(frame.stamp_ns, RecordingEventKind.REMARK, "reference image", fault)
                writer.write_event(remark)
                self.notify(f"the reference image is doubtful; {fault}")
        for waiting in self._first:
            reading = read_frame(waiting, self.shape, self._depth_reader)
            if self._estimates_force:
                reading = reading.with_force(self.estimator.estimate(reading))
            writer.write_measurements(reading)
        self._first.clear()

    @property
    def _estimates_force(self) -> bool:
        return not isinstance(self.estimator, NoForceEstimator)


@dataclass
class Recorder:
    """Writes what a camera and a force/torque sensor deliver into an open recording."""

    writer: RecordingWriter
    camera: FrameSource
    force_torque: WrenchSource | None = None
    estimates: EstimateRecorder | None = None
    notify: Callable[[str], None] = lambda sentence: None
    """Receives a sentence each time that a device has delivered nothing for `stall_s`."""
    stall_s: float = STALL_S

    def __post_init__(self) -> None:
        stalls: dict[str, Any] = {"on_stall": self.notify, "stall_s": self.stall_s}
        self._images = BackgroundReader[Frame](self.camera, _BUFFERED_IMAGES, **stalls)
        self._samples: BackgroundReader[Wrench] | None = None
        if self.force_torque is not None:
            self._samples = BackgroundReader(self.force_torque, _BUFFERED_SAMPLES, **stalls)

    @contextmanager
    def opened(self) -> Iterator[None]:
        """Read the devices in the background while the block runs; raises what opening them raises."""
        with self._samples or nullcontext(), self._images:
            yield

    def write(self, should_stop: Callable[[], bool]) -> None:
        """Record until `should_stop` is true or the source ends, all that was read until then, and the notices of the camera.

        Raises what a live source raises, and `SourceIncomplete` for a damaged file, whose last images are then counted as dropped.
        """
        try:
            while not should_stop():
                self._write_arrivals()
            for _ in range(self._images.waiting):  # what was read before the end, while writing was slow
                self._write_arrivals()
        except SourceEnded:
            pass
        except SourceIncomplete as damage:
            self.writer.count_dropped(damage.uncounted)
            raise
        for notice in self.camera.notices:
            self.notify(notice)
            self.writer.write_event(RecordingEvent(monotonic_ns(), RecordingEventKind.REMARK, "camera", notice))

    def _write_arrivals(self) -> None:
        while self._samples is not None and (sample := self._samples.take()) is not None:
            self.writer.write_measured(sample.item)
        arrival = self._images.take(_WAIT_S)
        if arrival is not None:
            frame, brought = arrival.item, self.camera.reference_frames
            if not self.writer.written[Topic.IMAGES]:
                for reference in brought:
                    self.writer.write_reference(replace(reference, stamp_ns=frame.stamp_ns), tare=0)
            self.writer.write_image(frame)
            if self.estimates is not None:
                self.estimates.write(frame, self.writer, brought)
