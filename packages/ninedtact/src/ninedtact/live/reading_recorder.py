"""Records the readings and measured wrenches of running sensors, with labels, into one MCAP file at a time, for page and ROS 2.

A sensor thread only puts readings into a queue; a thread of the recording writes them. Where the disk is too slow, readings drop,
and they are counted.
"""

from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from queue import Empty, Queue
from threading import RLock, Semaphore, Thread
from time import monotonic, monotonic_ns

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.errors import InputError, NinedtactError
from ninedtact.quantities import Wrench
from ninedtact.reading import Reading
from ninedtact.recording.metadata import HEIGHT_STEP_16_BIT_MM, RecordingMetadata
from ninedtact.recording.recorder import new_sensor_writer, notify_partial_recording
from ninedtact.recording.topics_and_messages import ESTIMATE_TOPICS, LabelledSpan, Topic
from ninedtact.recording.writer import RecordingWriter

_WAITING_READINGS = 48
"""Readings of each sensor that wait to be written at most: about 150 MB with their heights."""


@dataclass(frozen=True)
class RecordedSensorMetadata:
    """A sensor whose readings are recorded, and what the file says of them."""

    sensor: SensorFolder
    source: str
    """Where the images come from, in words."""
    force_torque: str = ""
    """Where the measured wrenches come from, in words; empty where none are recorded."""
    has_estimates: bool = False
    estimate_notices: tuple[str, ...] = ()
    """What a person must know of every estimate."""
    name: str = ""
    """Name among several sensors."""


@dataclass(frozen=True)
class RecorderState:
    """The state of the recorder at one moment."""

    path: Path | None = None
    """The recording that runs, or the last one; None before the first."""
    is_running: bool = False
    seconds: float = 0.0
    written_bytes: int = 0
    images: int = 0
    """Images of the first sensor in the file."""
    dropped: int = 0
    """Images that the sources counted and that are not in the file."""
    label: str | None = None
    """The label whose span has begun and not ended."""
    labels: int = 0
    trouble: str = ""
    """Why the last recording ended before it was stopped, and what was kept."""


class ReadingRecorder:
    """Records all sensors into one file at a time, until it is stopped or nothing more may be written."""

    def __init__(
        self,
        sensors: Sequence[RecordedSensorMetadata],
        out: Path,
        purpose: str = "record",
        topics: Collection[Topic] = (),
        before_start: Callable[[], None] = lambda: None,
        on_growth: Callable[[int], None] = lambda more_bytes: None,
    ) -> None:
        """out: folder of the recordings. purpose: the command that makes them. topics: those beside images, reference images and
        wrenches. before_start: may refuse a recording. on_growth: called with the number of bytes that were written since the
        last call; what it raises ends the recording."""
        self.sensors, self.out = tuple(sensors), out
        self._purpose, self._topics, self._before_start, self._on_growth = purpose, topics, before_start, on_growth
        self._recording: _Recording | None = None
        """The recording that runs, or the last one. It is replaced and never reused, so that a sensor thread may be late."""
        self._lock = RLock()

    def state(self) -> RecorderState:
        """Return the present state."""
        recording = self._recording
        return RecorderState() if recording is None else recording.state()

    def add(self, item: Reading | Wrench, number: int = 0) -> None:
        """Record a reading or a measured wrench of a sensor where a recording runs; never waits."""
        recording = self._recording
        if recording is not None:
            recording.add(item, number)

    def start(self, name: str = "") -> Path:
        """Begin a recording, or return the path of the one that runs; raises `OutputError` and `RecordingStopped`.

        name: of the file, without its ending; the date and time, if not given.
        """
        with self._lock:
            if self._recording is not None and self._recording.is_running:
                return self._recording.path
            self._before_start()
            self.out.mkdir(parents=True, exist_ok=True)
            path = self.out / f"{name or f'recording_{datetime.now():%Y%m%d_%H%M%S_%f}'}.mcap"
            self._recording = _Recording(path, self._new_writers(path), self._on_growth)
            return path

    def stop(self) -> RecorderState:
        """End the recording after what has been read is written, and return the last state."""
        if self._recording is not None:
            self._recording.close()
        return self.state()

    def begin_label(self, label: str) -> None:
        """Begin a labelled span now; raises `InputError`."""
        recording, name = self._recording, label.strip()
        if recording is None or not recording.is_running or not name:
            raise InputError(
                expected="a recording and a name for the label",
                got=f"'{label}' and {('a recording' if self.state().is_running else 'no recording')}",
                remedy="begin a recording and name the label",
            )
        recording.change_label(name)

    def end_label(self) -> None:
        """End the labelled span now; nothing happens where none has begun, as where another person has just ended it."""
        if self._recording is not None:
            self._recording.change_label(None)

    def _new_writers(self, path: Path) -> list[RecordingWriter]:
        """Return the writers of all sensors into one file; the first one opens it."""
        first = RecordingMetadata("", self._purpose, height_step_mm=HEIGHT_STEP_16_BIT_MM)
        writers: list[RecordingWriter] = []
        for one in self.sensors:
            said = replace(first, name=one.name, source=one.source, force_torque=one.force_torque)
            said = replace(said, estimate_notices="; ".join(one.estimate_notices))
            topics = {Topic.IMAGES, Topic.REFERENCE_GREY, *self._topics}
            topics |= {Topic.MEASURED} if one.force_torque else set()
            topics |= ESTIMATE_TOPICS if one.has_estimates else set()
            writers.append(new_sensor_writer(path, one.sensor, said, topics, beside=next(iter(writers), None)))
        return writers


class _Recording:
    """One file, and the thread that writes it."""

    def __init__(self, path: Path, writers: list[RecordingWriter], on_growth: Callable[[int], None]) -> None:
        self.path, self._writers, self._on_growth = path, writers, on_growth
        self.is_running, self._trouble, self._written_bytes = True, "", 0
        self._items: Queue[tuple[Reading | Wrench | LabelledSpan, int] | None] = Queue()
        self._room = Semaphore(_WAITING_READINGS * len(writers))
        self._label: tuple[str, int] | None = None
        self._began_s, self._ended_s, self._counted_bytes = monotonic(), 0.0, 0
        self._lock, self._opened, self._kept = RLock(), ExitStack(), list[str]()
        self._opened.enter_context(notify_partial_recording(path, self._kept.append))
        self._opened.enter_context(writers[0])
        self._thread = Thread(target=self._run, name=f"record {path.name}", daemon=True)
        self._thread.start()

    def state(self) -> RecorderState:
        written, label = self._writers[0].written, self._label
        size = self.path.stat().st_size if self.path.is_file() else 0
        return RecorderState(
            self.path,
            self.is_running,
            (monotonic() if self.is_running else self._ended_s) - self._began_s,
            size,
            written[Topic.IMAGES],
            sum(writer.dropped for writer in self._writers),
            None if label is None else label[0],
            written[Topic.SPANS],
            self._trouble or self._loss(size),
        )

    def _loss(self, size: int) -> str:
        """Return what is said where less is there than was written, or no file while it is written."""
        if self.is_running and not self.path.is_file():
            return f"expected {self.path}, got no such file: it was removed or moved; stop, and record again"
        if self.is_running or size >= self._written_bytes:
            return ""
        expected = f"the {self._written_bytes} bytes that were recorded to {self.path}"
        return f"expected {expected}, got {size}: the file was removed or cut; record again"

    def add(self, item: Reading | Wrench, number: int) -> None:
        """Queue an item, unless the recording is over, or it is a reading and too many wait."""
        if self.is_running and (isinstance(item, Wrench) or self._room.acquire(blocking=False)):
            self._items.put((item, number))

    def change_label(self, label: str | None) -> None:
        """End the labelled span, if one has begun, and begin another one now, if it has a name."""
        with self._lock:
            before, now_ns = self._label, monotonic_ns()
            self._label = None if label is None else (label, now_ns)
            if before is not None:
                self._items.put((LabelledSpan(before[1], now_ns, before[0]), 0))

    def close(self) -> None:
        """Write what waits, and finish the file."""
        self.change_label(None)
        self._items.put(None)
        self._thread.join()

    def _run(self) -> None:
        """Write until the end; what ends the recording early is kept as a sentence."""
        try:
            with self._opened:
                try:
                    while (item := self._items.get()) is not None:
                        self._write(*item)
                finally:
                    self._write_labels()
        except Exception as error:  # everybody is told, and the sensor goes on
            self._trouble = "; ".join([str(error), *self._kept])
        self._written_bytes = self._writers[0].file_bytes
        self._ended_s, self.is_running = monotonic(), False

    def _write(self, item: Reading | Wrench | LabelledSpan, number: int) -> None:
        if isinstance(item, Reading):
            self._room.release()
            self._writers[number].write_reading(item)
        elif isinstance(item, Wrench):
            self._writers[number].write_measured(item)
        else:
            self._writers[number].write_span(item)
        size = self._writers[0].file_bytes
        grown, self._counted_bytes = size - self._counted_bytes, size
        self._on_growth(grown)

    def _write_labels(self) -> None:
        """Write the labels that have not been written, also one that ends with a recording that nobody has stopped."""
        self.change_label(None)
        with suppress(Empty, NinedtactError):  # what ended the recording is said in its place
            while True:
                item = self._items.get_nowait()
                if item is not None and isinstance(item[0], LabelledSpan):
                    self._writers[0].write_span(item[0])
