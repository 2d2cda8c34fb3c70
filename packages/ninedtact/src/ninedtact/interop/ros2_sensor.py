"""A sensor on ROS 2: its readings as messages, commands to it, and answers.

    sensor thread:     Sensor ──read──▶ newest reading ──▶ recording thread, while one is made
    publishing thread: newest reading ──SensorMessages──▶ CDR ──▶ DDS        commands ──▶ answers on `status`
    measuring thread:  force/torque sensor ──▶ every sample ──▶ CDR ──▶ DDS, and to the recording thread

The publishing and the measuring thread wait for subscribers that stall; the sensor does not.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from queue import Queue
from threading import Event, Semaphore, Thread
from time import monotonic, monotonic_ns
from typing import Any

from ninedtact.capture.frame_source import SourceEnded
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.errors import InputError, NinedtactError
from ninedtact.interop.dds import DdsParticipant
from ninedtact.interop.ros2_topics_and_messages import (
    COMMAND,
    LIVE_TOPICS,
    STATUS,
    STRING_TYPE,
    TF_STATIC,
    TF_TYPE,
    QosProfile,
    SensorMessages,
    decode_ros2_command,
    encode_ros2_status,
)
from ninedtact.interop.sensor_sharing import watch_sensor
from ninedtact.live.sensor_poller import SensorPoller, SensorSnapshot
from ninedtact.quantities import Rectified, Wrench
from ninedtact.reading import Reading
from ninedtact.recording.errors import RecordingStopped
from ninedtact.recording.metadata import RecordingMetadata, wall_time_ns
from ninedtact.recording.recorder import new_reading_writer, notify_partial_recording
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.recording.writer import RecordingWriter
from ninedtact.sensor import Sensor

_STATUS_S = 1.0
_REFERENCE_S = 1.0
"""Shortest time between two reference images, which may follow slow changes of light and gel."""
_WAITING_READINGS = 128
"""Readings that wait to be recorded at most: about 120 MB."""


class _RunningRecording:
    """A recording that a thread of its own writes, so that a slow disk delays neither the sensor nor subscribers."""

    def __init__(self, writer: RecordingWriter) -> None:
        """Create the file; raises `OutputError` or `RecordingStopped`."""
        self.writer, self.trouble = writer, ""
        """trouble: why nothing more is written, and what the file keeps; empty while there is no reason."""
        self._waiting: Queue[Reading | Wrench | None] = Queue()
        self._room = Semaphore(_WAITING_READINGS)
        self._opened, self._kept = ExitStack(), list[str]()
        self._opened.enter_context(notify_partial_recording(writer.path, self._kept.append))
        self._opened.enter_context(writer)
        self._thread = Thread(target=self._run, name=f"record {writer.path}", daemon=True)
        self._thread.start()

    def add(self, item: Reading | Wrench) -> None:
        """Record a reading or a measured wrench; a reading is dropped, and counted by the writer, where too many wait."""
        if not self.trouble and (isinstance(item, Wrench) or self._room.acquire(blocking=False)):
            self._waiting.put(item)

    def close(self) -> None:
        """Write what waits and finish the file."""
        self._waiting.put(None)
        self._thread.join()

    def _run(self) -> None:
        try:
            with self._opened:
                while (item := self._waiting.get()) is not None:
                    self._write(item)
        except Exception as error:  # is published, and the sensor goes on
            self.trouble = "; ".join([str(error), *self._kept])

    def _write(self, item: Reading | Wrench) -> None:
        if isinstance(item, Wrench):
            self.writer.write_measured(item)
        else:
            self.writer.write_reading(item)
            self._room.release()


@dataclass
class ReadingRecorder:
    """Records a sensor's readings and measured wrenches between the commands start and stop, one recording at a time."""

    messages: SensorMessages
    source: str
    """Where the images come from, in words."""
    force_torque: str
    """Where the measured wrenches come from, in words; empty where there are none."""
    out: Path
    """Folder of recordings; a command names files in it, not paths."""
    trouble: str = field(default="", init=False)
    """Why the last recording ended by itself, and what it keeps; empty where it did not."""
    _running: _RunningRecording | None = field(default=None, init=False)

    @property
    def writer(self) -> RecordingWriter | None:
        """The writer of the recording that is being made."""
        return None if self._running is None else self._running.writer

    def add(self, item: Reading | Wrench) -> None:
        """Hand a reading or a measured wrench to the recording that is being made; called in the thread that has it."""
        running = self._running
        if running is not None:
            running.add(item)

    def start(self, name: str = "") -> str:
        """Begin a recording and say so in a sentence; raises `InputError` and what creating the file raises."""
        if self.writer is not None:
            raise InputError(expected="no recording in progress", got=f"{self.writer.path}", remedy="stop it first")
        name = name or f"{self.messages.name}_{wall_time_ns(monotonic_ns())}"
        if Path(name).name != name or name.startswith(".") or not name.isprintable():
            raise InputError(
                expected="the printable name of a recording without a folder", got=f"{name!r}", remedy="leave it out"
            )
        self.out.mkdir(parents=True, exist_ok=True)
        path = self.out / f"{name.removesuffix('.mcap')}.mcap"
        metadata = RecordingMetadata("", "ros2", self.source, self.force_torque)
        writer = new_reading_writer(path, self.messages.folder, metadata, bool(self.force_torque), True)
        self._running, self.trouble = _RunningRecording(writer), ""
        return f"recording to {path}"

    def end_if_failed(self) -> bool:
        """End a recording that could not be continued, as on a full disk, and return whether there was one."""
        running = self._running
        if running is None or not running.trouble:
            return False
        self._running, self.trouble = None, running.trouble
        running.close()
        return True

    def stop(self) -> str:
        """Finish the recording; return a sentence about it, or nothing where there was none. Raises `RecordingStopped`."""
        running, self._running = self._running, None
        if running is None:
            return ""
        running.close()
        if running.trouble:
            raise RecordingStopped(running.trouble)
        return f"{running.writer.path}: {running.writer.written[Topic.IMAGES]} images, {running.writer.dropped} dropped"


@dataclass
class SensorOnRos2:
    """A sensor on ROS 2: publishes its newest readings and obeys commands. `run` ends when `should_stop` is true.

    Commands, as text on the topic `command`: `take_reference`, `start_recording [NAME]`, `stop_recording`. Every one is answered on
    `status`, which is also published once a second.
    """

    sensor: Sensor
    messages: SensorMessages
    participant: DdsParticipant
    profiles: Mapping[str, QosProfile]
    out: Path = Path("recordings")
    """Folder of recordings; a command names files in it, not paths."""
    measured: WrenchSource | None = None
    """A force/torque sensor beside, whose samples are published at its own rate; not yet open."""
    measured_meaning: str = ""
    """What the samples are, in words, for recordings; the name of the force/torque sensor, if not given."""
    notify: Callable[[str], None] = lambda sentence: None
    """Receives a sentence where no readings arrive any more, where they do again, and where a recording ends early."""
    published: int = field(default=0, init=False)
    """Readings published."""
    _recorder: ReadingRecorder = field(init=False)
    _reference: Rectified | None = field(default=None, init=False, repr=False)
    """The reference image that was published last, and when, in s."""
    _reference_at: float = field(default=-_REFERENCE_S, init=False)
    _trouble: NinedtactError | None = field(default=None, init=False)
    """Why no more measured wrenches arrive."""

    def __post_init__(self) -> None:
        meaning = "" if self.measured is None else self.measured_meaning or self.measured.name
        self._recorder = ReadingRecorder(self.messages, self.sensor.source.name, meaning, self.out)
        make = self.participant.writer
        self._writers = {
            topic: make(self.messages.path(topic), LIVE_TOPICS[topic][0], profile)
            for topic, profile in self.profiles.items()
        }
        self._transforms = make(TF_STATIC, TF_TYPE, QosProfile.LATCHED)
        self._commands = self.participant.reader(self.messages.path(COMMAND), STRING_TYPE, QosProfile.RELIABLE)

    def run(self, should_stop: Callable[[], bool]) -> None:
        """Publish until `should_stop` is true or the source ends; raises what the sensor raises."""
        self._transforms.write(self.messages.encode_static_transforms(wall_time_ns(monotonic_ns())))
        status_at = 0.0
        try:
            with self._measuring():
                for moment in watch_sensor(self.sensor, should_stop, self.notify, self._recorder.add):
                    now = moment.snapshot
                    if self._trouble is not None:
                        raise self._trouble
                    if moment.new_reading is not None:
                        self.publish(moment.new_reading)
                    for command in self._commands.take():
                        self._write_status(now, **self._obey(command, moment.poller))
                    has_recording_failed = self._recorder.end_if_failed()
                    if has_recording_failed:
                        self.notify(self._recorder.trouble)
                    if has_recording_failed or moment.has_changed or monotonic() - status_at > _STATUS_S:
                        status_at = monotonic()
                        self._write_status(now, read_hz=round(now.read_hz, 1))
        finally:
            self._recorder.stop()

    def publish(self, reading: Reading) -> None:
        """Publish a reading on all topics to which anybody subscribes."""
        wall_ns = wall_time_ns(reading.stamp_ns)
        wanted = {topic for topic, writer in self._writers.items() if writer.has_subscribers}
        for topic, message in self.messages.encode(reading, wall_ns, wanted).items():
            self._writers[topic].write(message)
        if reading.reference is not self._reference:
            self._publish_reference(reading.reference, wall_ns)
        self.published += 1

    def _publish_reference(self, reference: Rectified, wall_ns: int) -> None:
        """Publish a new reference image for all who subscribe now or later."""
        if monotonic() - self._reference_at > _REFERENCE_S:
            self._reference, self._reference_at = reference, monotonic()
            self._writers[Topic.REFERENCE_GREY].write(self.messages.encode_reference(reference, wall_ns))

    @contextmanager
    def _measuring(self) -> Iterator[None]:
        """Publish the samples of the force/torque sensor during the block; raises what opening it raises."""
        if self.measured is None:
            yield
            return
        over = Event()
        self.measured.open()
        thread = Thread(target=self._publish_measured, args=(self.measured, over), name="measure", daemon=True)
        thread.start()
        try:
            yield
        finally:
            over.set()
            self.measured.close()
            thread.join()

    def _publish_measured(self, source: WrenchSource, over: Event) -> None:
        writer = self._writers[Topic.MEASURED]
        try:
            while not over.is_set():
                wrench = source.read()
                self._recorder.add(wrench)
                if writer.has_subscribers:
                    wall_ns = wall_time_ns(wrench.stamp_ns)
                    writer.write(self.messages.encode_measured(wrench, wall_ns))
        except SourceEnded:
            return
        except NinedtactError as trouble:
            if not over.is_set():
                self._trouble = trouble

    def _obey(self, message: bytes, poller: SensorPoller) -> dict[str, Any]:
        """Carry a command out and return the answer, with the command as text, which is empty where it cannot be decoded."""
        command = ""
        try:
            command = decode_ros2_command(message)
            word, _, argument = command.partition(" ")
            answer = self._carry_out(word, argument.strip(), poller)
        except (NinedtactError, OSError) as refusal:
            return {"command": command, "ok": False, "answer": str(refusal)}
        return {"command": command, "ok": True, "answer": answer}

    def _carry_out(self, word: str, argument: str, poller: SensorPoller) -> str:
        if word == "take_reference":
            poller.take_reference()
            return "the next images are the reference; nothing may touch the gel"
        if word == "start_recording":
            return self._recorder.start(argument)
        if word == "stop_recording":
            return self._recorder.stop() or "nothing was being recorded"
        raise InputError(
            expected="take_reference, start_recording [NAME] or stop_recording",
            got=f"{word!r}",
            remedy="send one of them",
        )

    def _write_status(self, now: SensorSnapshot, **fields: Any) -> None:
        writer = self._recorder.writer
        state = {
            "sensor": self.messages.name,
            "phase": now.phase_text(monotonic_ns()),
            "trouble": now.trouble_sentence,
            "published": self.published,
            "dropped": sum(writer.dropped for writer in self._writers.values()),
            "recording": None if writer is None else str(writer.path),
            "recording_trouble": self._recorder.trouble,
            "camera_info_residual_px": round(self.messages.camera.residual_px, 3),
        }
        self._writers[STATUS].write(encode_ros2_status({**state, **fields}))
