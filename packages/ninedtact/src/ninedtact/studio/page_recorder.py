"""Records what the live page shows of its sensors: readings, with heights, wrenches and labels, into one MCAP file.

A sensor thread only puts readings into a queue; a thread of the recorder writes them. Where the disk is too slow, images drop,
and they are counted. All viewers of a page share one `PageRecorder`.
"""

from collections import deque
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Event, RLock, Thread
from time import monotonic, monotonic_ns

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.errors import InputError, NinedtactError
from ninedtact.live.wrench_history import WrenchHistory
from ninedtact.reading import Reading
from ninedtact.recording.metadata import HEIGHT_STEP_16_BIT_MM, RecordingMetadata
from ninedtact.recording.recorder import new_reading_writer, notify_partial_recording
from ninedtact.recording.topics_and_messages import LabelledSpan, Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.studio.saved_files import SaveQuota

BUFFERED_READINGS = 48
"""Readings that wait to be written at most: about 150 MB."""
_WAIT_S = 0.05
_ReadingQueue = Queue[tuple[int, Reading]]
"""Readings with the numbers of their sensors."""


@dataclass(frozen=True)
class PageSensorToRecord:
    """One of the sensors of a page, as it is recorded."""

    sensor: SensorFolder
    source: str
    wrenches: Sequence[WrenchHistory]
    """The first one without stated errors is written as measured; estimates come with the readings."""
    name: str = ""
    """Name among several sensors."""

    @property
    def measured(self) -> WrenchHistory | None:
        """The wrenches that are written as measured."""
        return next((history for history in self.wrenches if not history.states_errors), None)

    @property
    def has_estimates(self) -> bool:
        """Whether estimates are written."""
        return any(history.states_errors for history in self.wrenches)


@dataclass(frozen=True)
class RecorderState:
    """The state of the recorder at one moment."""

    path: Path | None = None
    """The recording that runs, or the last one; None before the first."""
    is_running: bool = False
    seconds: float = 0.0
    written_bytes: int = 0
    dropped: int = 0
    """Images that the source counted and that are not in the file."""
    label: str | None = None
    """The label whose span has begun and not ended."""
    labels: int = 0
    trouble: str = ""
    """Why the last recording ended before it was stopped, and what was kept."""


class PageRecorder:
    """Writes one recording at a time into the page's folder, until it is stopped or nothing more may be written."""

    def __init__(self, sensors: Sequence[PageSensorToRecord], out: Path, quota: SaveQuota) -> None:
        """sensors: are all recorded into one file."""
        self.sensors, self.out, self._quota = tuple(sensors), out, quota
        self._queue: _ReadingQueue | None = None
        """Readings of the recording that runs; None where none runs. It is replaced and never reused, so that a sensor thread that
        has looked it up may be late."""
        self._spans: deque[LabelledSpan] = deque()
        self._span: tuple[str, int] | None = None
        self._state, self._began_at = RecorderState(), 0.0
        self._lock, self._stopping = RLock(), Event()
        self._thread: Thread | None = None

    def state(self) -> RecorderState:
        """Return the present state."""
        with self._lock:
            label = None if self._span is None else self._span[0]
            seconds = monotonic() - self._began_at if self._state.is_running else self._state.seconds
            return replace(self._state, label=label, seconds=seconds)

    def keep(self, reading: Reading, number: int = 0) -> None:
        """Record a reading of a sensor where a recording runs; never waits. The writer counts those that find no room."""
        queue = self._queue
        if queue is not None:
            with suppress(Full):
                queue.put_nowait((number, reading))

    def start(self) -> Path:
        """Begin a recording, or return the path of the one that runs.

        Raises `OutputError`, `RecordingStopped`.
        """
        with self._lock:
            if self._state.is_running and self._state.path is not None:
                return self._state.path
            if self._thread is not None:
                self._thread.join()
            self._quota.count_save(0, self.out, "a recording")
            self.out.mkdir(parents=True, exist_ok=True)
            path = self.out / f"recording_{datetime.now():%Y%m%d_%H%M%S_%f}.mcap"
            opened = ExitStack()
            kept: list[str] = []
            opened.enter_context(notify_partial_recording(path, kept.append))
            writers = self._new_writers(path)
            opened.enter_context(writers[0])
            queue, self._span = _ReadingQueue(BUFFERED_READINGS * len(self.sensors)), None
            self._spans.clear()
            self._stopping.clear()
            self._began_at = monotonic()
            self._state = RecorderState(path, is_running=True)
            self._thread = Thread(
                target=self._run, args=(opened, writers, queue, kept), name=f"record {path.name}", daemon=True
            )
            self._thread.start()
            self._queue = queue
            return path

    def stop(self) -> RecorderState:
        """End the recording after what has been read is written, and return the last state."""
        with self._lock:
            if self._span is not None:
                self.end_label()
            self._queue = None
            self._stopping.set()
        if self._thread is not None:
            self._thread.join()
        return self.state()

    def begin_label(self, label: str) -> None:
        """Begin a labelled span now; raises `InputError`."""
        with self._lock:
            is_running = self._state.is_running and not self._stopping.is_set()
            if not is_running or not label.strip():
                raise InputError(
                    expected="a recording and a name for the label",
                    got=f"'{label}' and {('a recording' if is_running else 'no recording')}",
                    remedy="begin a recording and name the label",
                )
            if self._span is not None:
                self.end_label()
            self._span = label.strip(), monotonic_ns()

    def end_label(self) -> None:
        """End the labelled span now; raises `InputError` where none has begun."""
        with self._lock:
            if self._span is None:
                raise InputError(expected="a label that has begun", got="none", remedy="begin one first")
            (label, begin_ns), self._span = self._span, None
            self._spans.append(LabelledSpan(begin_ns, monotonic_ns(), label))

    def _new_writers(self, path: Path) -> list[RecordingWriter]:
        """Return the writers of all sensors into one file; the first one opens it."""
        first = RecordingMetadata("", height_step_mm=HEIGHT_STEP_16_BIT_MM)
        writers: list[RecordingWriter] = []
        for part in self.sensors:
            metadata = replace(
                first,
                name=part.name,
                source=part.source,
                force_torque="" if part.measured is None else part.measured.meaning,
            )
            kinds, beside = (part.measured is not None, part.has_estimates), writers[0] if writers else None
            topics = (Topic.HEIGHTS, Topic.SPANS)
            writers.append(new_reading_writer(path, part.sensor, metadata, *kinds, topics, beside))
        return writers

    def _run(self, opened: ExitStack, writers: list[RecordingWriter], queue: _ReadingQueue, kept: list[str]) -> None:
        """Write until the end; what ends the recording early is kept as a sentence for the page."""
        trouble, writer = "", writers[0]
        try:
            with opened:
                self._write_all(writers, queue)
        except Exception as error:  # every viewer is told, and the sensor goes on
            trouble = "; ".join([str(error), *kept])
        with self._lock:
            self._state = replace(
                self._state,
                is_running=False,
                labels=writer.written[Topic.SPANS],
                seconds=monotonic() - self._began_at,
                written_bytes=writer.path.stat().st_size if writer.path.exists() else 0,
                dropped=sum(one.dropped for one in writers),
                trouble=trouble,
            )

    def _write_all(self, writers: list[RecordingWriter], queue: _ReadingQueue) -> None:
        """Write until the recorder is stopped and nothing waits any longer."""
        streams = [_MeasuredWrenchWriter(part, writer) for part, writer in zip(self.sensors, writers, strict=True)]
        counted_bytes = 0
        try:
            while True:
                is_last = self._stopping.is_set() and queue.empty()
                with suppress(Empty):
                    number, reading = queue.get(timeout=_WAIT_S)
                    writers[number].write_reading(reading)
                for stream in streams:
                    stream.write_wrenches()
                self._write_spans(writers[0])
                counted_bytes = self._count(writers, counted_bytes)
                if is_last:
                    return
        finally:
            with self._lock:  # a label that has begun ends with a recording that nobody has stopped
                if self._span is not None:
                    self.end_label()
                self._queue = None
                self._stopping.set()
            with suppress(NinedtactError):  # what ended the recording is said in its place
                self._write_spans(writers[0])

    def _write_spans(self, writer: RecordingWriter) -> None:
        """Write the labelled spans that have ended."""
        while self._spans:
            writer.write_span(self._spans[0])
            self._spans.popleft()

    def _count(self, writers: list[RecordingWriter], counted_bytes: int) -> int:
        """Count the bytes against the quota of the page and return them; raises `OutputError` where it is used up."""
        size = writers[0].path.stat().st_size
        self._quota.add_bytes(size - counted_bytes)
        dropped, labels = sum(one.dropped for one in writers), writers[0].written[Topic.SPANS]
        with self._lock:
            self._state = replace(self._state, written_bytes=size, dropped=dropped, labels=labels)
        self._quota.require_space(0, self.out, "a recording that goes on")
        return size


class _MeasuredWrenchWriter:
    """Writes the measured wrenches of one sensor."""

    def __init__(self, part: PageSensorToRecord, writer: RecordingWriter) -> None:
        self._writer, self._measured = writer, part.measured
        self._measured_ns = monotonic_ns()

    def write_wrenches(self) -> None:
        """Write the measured wrenches that are newer than the last one."""
        if self._measured is None:
            return
        for stamp_ns, sample in self._measured.snapshot(None, monotonic_ns()).samples:
            if stamp_ns > self._measured_ns:
                self._writer.write_measured(sample.wrench)
                self._measured_ns = stamp_ns
