"""A sensor on ROS 2: its readings as messages, commands to it, and answers.

    sensor thread:     Sensor ──read──▶ newest reading ──▶ recording thread, while one is made
    publishing thread: newest reading ──SensorMessages──▶ CDR ──▶ DDS        commands ──▶ answers on `status`
    measuring thread:  force/torque sensor ──▶ every sample ──▶ CDR ──▶ DDS, and to the recording thread

The publishing and the measuring thread wait for subscribers that stall; the sensor does not.
"""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from time import monotonic, monotonic_ns
from typing import Any

from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.errors import InputError, NinedtactError
from ninedtact.interop.dds import DdsParticipant
from ninedtact.interop.ros2_topics_and_messages import (
    COMMAND,
    CONTACTS,
    LIVE_TOPICS,
    SLIP,
    STATUS,
    STRING_TYPE,
    TF,
    TF_STATIC,
    TF_TYPE,
    QosProfile,
    SensorMessages,
    decode_ros2_command,
    encode_ros2_contacts,
    encode_ros2_slip,
    encode_ros2_status,
)
from ninedtact.interop.sensor_sharing import watch_sensor
from ninedtact.live.reading_recorder import ReadingRecorder, RecordedSensorMetadata
from ninedtact.live.sensor_poller import SensorPoller, SensorSnapshot
from ninedtact.live.wrench_history import WrenchPoller
from ninedtact.quantities import Rectified, Wrench
from ninedtact.reading import Reading
from ninedtact.recording.errors import RecordingStopped
from ninedtact.recording.metadata import wall_time_ns
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.sensor import Sensor
from ninedtact.tracking import ContactTracker

_STATUS_S = 1.0
_REFERENCE_S = 1.0
"""Shortest time between two reference images, which may follow slow changes of light and gel."""


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
    _recording_trouble: str = field(default="", init=False)
    """Why the last recording ended by itself, and what it keeps; empty where it did not."""
    _tracker: ContactTracker | None = field(default=None, init=False, repr=False)
    """Follows contacts and the object while anybody subscribes to them."""
    _reference: Rectified | None = field(default=None, init=False, repr=False)
    """The reference image that was published last, and when, in s."""
    _reference_at: float = field(default=-_REFERENCE_S, init=False)

    def __post_init__(self) -> None:
        meaning = "" if self.measured is None else self.measured_meaning or self.measured.name
        notices = self.sensor.estimator.notices
        recorded = RecordedSensorMetadata(self.messages.folder, self.sensor.source.name, meaning, True, notices)
        self._recorder = ReadingRecorder([recorded], self.out, "ros2")
        make = self.participant.writer
        self._writers = {
            topic: make(self.messages.path(topic), LIVE_TOPICS[topic][0], profile)
            for topic, profile in self.profiles.items()
        }
        self._transforms = make(TF_STATIC, TF_TYPE, QosProfile.LATCHED)
        self._object = make(TF, TF_TYPE, QosProfile.RELIABLE)
        self._commands = self.participant.reader(self.messages.path(COMMAND), STRING_TYPE, QosProfile.RELIABLE)

    def run(self, should_stop: Callable[[], bool]) -> None:
        """Publish until `should_stop` is true or the source ends; raises what the sensor raises."""
        self._transforms.write(self.messages.encode_static_transforms(wall_time_ns(monotonic_ns())))
        status_at = 0.0
        try:
            source = self.measured
            with nullcontext() if source is None else WrenchPoller(source, "", "", self._publish_measured) as measuring:
                for moment in watch_sensor(self.sensor, should_stop, self.notify, self._recorder.add):
                    now = moment.snapshot
                    if measuring is not None and measuring.history.trouble is not None:
                        raise measuring.history.trouble
                    if moment.new_reading is not None:
                        self.publish(moment.new_reading)
                    for command in self._commands.take():
                        self._write_status(now, **self._obey(command, moment.poller))
                    trouble, self._recording_trouble = self._recording_trouble, self._recorder.state().trouble
                    has_recording_failed = bool(self._recording_trouble) and self._recording_trouble != trouble
                    if has_recording_failed:
                        self.notify(self._recording_trouble)
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
        self._publish_tracking(reading, wall_ns, wanted)
        if reading.reference is not self._reference:
            self._publish_reference(reading.reference, wall_ns)
        self.published += 1

    def _publish_tracking(self, reading: Reading, wall_ns: int, wanted: set[str]) -> None:
        """Publish contacts, slip and the object's frame where somebody subscribes to one of them."""
        if not (wanted & {CONTACTS, SLIP} or self._object.has_subscribers):
            self._tracker = None  # a gap would be taken for a motion
            return
        self._tracker = self._tracker or ContactTracker()
        found = self._tracker.update(reading)
        if CONTACTS in wanted:
            self._writers[CONTACTS].write(encode_ros2_contacts(found, wall_ns))
        if SLIP in wanted:
            self._writers[SLIP].write(encode_ros2_slip(found.slip, wall_ns))
        if found.motion.is_known and self._object.has_subscribers:
            self._object.write(self.messages.encode_object_transform(found.motion, wall_ns))

    def _publish_reference(self, reference: Rectified, wall_ns: int) -> None:
        if monotonic() - self._reference_at > _REFERENCE_S:
            self._reference, self._reference_at = reference, monotonic()
            self._writers[Topic.REFERENCE_GREY].write(self.messages.encode_reference(reference, wall_ns))

    def _publish_measured(self, wrench: Wrench) -> None:
        self._recorder.add(wrench)
        writer = self._writers[Topic.MEASURED]
        if writer.has_subscribers:
            writer.write(self.messages.encode_measured(wrench, wall_time_ns(wrench.stamp_ns)))

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
            return self._start_recording(argument)
        if word == "stop_recording":
            return self._stop_recording()
        raise InputError(
            expected="take_reference, start_recording [NAME] or stop_recording",
            got=f"{word!r}",
            remedy="send one of them",
        )

    def _start_recording(self, name: str) -> str:
        """Begin a recording and say so in a sentence; raises `InputError` and what creating the file raises."""
        state = self._recorder.state()
        if state.is_running:
            raise InputError(expected="no recording in progress", got=f"{state.path}", remedy="stop it first")
        name = name or f"{self.messages.name}_{wall_time_ns(monotonic_ns())}"
        if Path(name).name != name or name.startswith(".") or not name.isprintable():
            raise InputError(
                expected="the printable name of a recording without a folder", got=f"{name!r}", remedy="leave it out"
            )
        return f"recording to {self._recorder.start(name.removesuffix('.mcap'))}"

    def _stop_recording(self) -> str:
        """Finish the recording and return a sentence about it; raises `RecordingStopped`."""
        if not self._recorder.state().is_running:
            return "nothing was being recorded"
        state = self._recorder.stop()
        if state.trouble:
            raise RecordingStopped(state.trouble)
        return f"{state.path}: {state.images} images, {state.dropped} dropped"

    def _write_status(self, now: SensorSnapshot, **fields: Any) -> None:
        recording = self._recorder.state()
        state = {
            "sensor": self.messages.name,
            "phase": now.phase_text(monotonic_ns()),
            "trouble": now.trouble_sentence,
            "published": self.published,
            "dropped": sum(writer.dropped for writer in self._writers.values()),
            "recording": str(recording.path) if recording.is_running else None,
            "recording_trouble": recording.trouble,
            "camera_info_residual_px": round(self.messages.camera.residual_px, 3),
        }
        self._writers[STATUS].write(encode_ros2_status({**state, **fields}))
