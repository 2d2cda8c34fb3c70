"""ROS 2 without ROS: messages in CDR to and from the network by DDS (Eclipse Cyclone DDS; extra `ros2`), and a sensor on it.

    sensor thread:     Sensor ──read──▶ newest reading ──▶ recording thread, while one is made
    publishing thread: newest reading ──SensorMessages──▶ CDR ──▶ DDS        commands ──▶ answers on `status`

The publishing thread alone waits for subscribers that stall. ROS 2 maps topic `/a/b` to the DDS topic `rt/a/b` and type
`std_msgs/msg/String` to `std_msgs::msg::dds_::String_`. Cyclone's own serialisation takes tens of milliseconds for an
image, so that the types here carry CDR bytes that rosbags has encoded; their fields serve discovery and Cyclone's tools.
"""

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from dataclasses import dataclass as idl_dataclass
from functools import cache
from pathlib import Path
from queue import Full, Queue
from socket import if_nameindex
from threading import Thread
from time import monotonic, monotonic_ns
from types import TracebackType, new_class
from typing import Any

from ninedtact.errors import DeviceError, InputError, NinedtactError
from ninedtact.interop.ros2_messages import (
    COMMAND,
    LIVE_TOPICS,
    STATUS,
    STRING_TYPE,
    TF_STATIC,
    TF_TYPE,
    QosProfile,
    SensorMessages,
    decode_command,
    encode_status,
)
from ninedtact.reading import Reading
from ninedtact.recording.metadata import RecordingMetadata, wall_minus_monotonic_ns
from ninedtact.recording.reader import sensor_folder_attachments
from ninedtact.recording.ros_messages import Topic, type_store
from ninedtact.recording.writer import RecordingWriter
from ninedtact.sensor import Sensor
from ninedtact.studio.sensor_poller import SensorPhase, SensorPoller

_CONFIGURATION_VARIABLE = "CYCLONEDDS_URI"
_DOMAIN_VARIABLE = "ROS_DOMAIN_ID"
_LAST_DOMAIN = 232
_LOOPBACK = "lo"
_LOOPBACK_DATAGRAMS = "<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>65000B</FragmentSize>"
"""Loopback carries whole UDP datagrams, so that an image takes 15 instead of 700."""
_LONGEST_WRITE_MS = 20
"""Longest time for which a write waits for a subscriber that does not keep up; the message is then dropped and counted."""
_DEPTHS = {QosProfile.SENSOR_DATA: 5, QosProfile.RELIABLE: 10, QosProfile.LATCHED: 1}
_COMMAND_WAIT_S = 0.05
_STATUS_S = 1.0
_WAITING_READINGS = 128
"""Readings that wait to be recorded at most: about 120 MB."""


class DdsUnavailable(DeviceError):
    """Raised where DDS finds no network interface, or not the one that is named."""


class InvalidRos2Option(InputError):
    """Raised for a domain, a topic or a quality of service that does not exist."""


def parse_qos(choices: tuple[str, ...]) -> dict[str, QosProfile]:
    """Return the quality of service of every published topic, where `choices` such as `points=sensor_data` change the defaults.

    Raises `InvalidRos2Option`.
    """
    profiles = {str(topic): profile for topic, (_, profile) in LIVE_TOPICS.items()}
    for choice in choices:
        topic, _, profile = choice.partition("=")
        if topic not in profiles or profile not in list(QosProfile):
            raise InvalidRos2Option(
                f"expected --qos as TOPIC=PROFILE with a topic of {', '.join(profiles)} and a profile of "
                f"{', '.join(QosProfile)}, got {choice}; correct it"
            )
        profiles[topic] = QosProfile(profile)
    return profiles


@cache
def dds_type(message_type: str) -> Any:
    """Return the DDS type of a ROS 2 message type; its objects carry CDR bytes (`cdr`).

    Fields and nested types are those of rosbags' definition.
    """
    from cyclonedds.idl import IdlStruct

    package, _, name = message_type.split("/")
    annotations = {key: _dds_field(node) for key, node in type_store().fielddefs[message_type][1]}

    def fill(namespace: dict[str, Any]) -> None:
        namespace["__annotations__"] = annotations

    made: Any = idl_dataclass(new_class(name, (IdlStruct,), {"typename": f"{package}::msg::dds_::{name}_"}, fill))
    made.serialize = lambda self, buffer=None, endianness=None, use_version_2=None: self.cdr
    made.deserialize = classmethod(
        lambda this, data, has_header=True, use_version_2=None: wrap_cdr(message_type, bytes(data))
    )
    return made


def wrap_cdr(message_type: str, cdr: bytes) -> Any:
    """Return an object of the DDS type that carries a message in CDR."""
    sample = dds_type(message_type).__new__(dds_type(message_type))
    sample.cdr = cdr
    return sample


def _dds_field(node: Any) -> Any:
    """Return the type of one field in the words of cyclonedds."""
    from cyclonedds.idl import types
    from rosbags.interfaces import Nodetype

    words: Any = types
    kind, value = node
    if kind == Nodetype.NAME:
        return dds_type(value)
    if kind == Nodetype.BASE:
        return {"string": str, "bool": bool}.get(value[0]) or getattr(words, value[0])
    element, length = value
    if kind == Nodetype.ARRAY:
        return words.array[_dds_field(element), length]
    return words.sequence[_dds_field(element)]


class DdsParticipant:
    """One program in a DDS domain, while it is open (`with`).

    domain: number of the domain; None takes that of ROS_DOMAIN_ID, or 0. interface: network interface, such as `lo` for this
    computer alone; None takes what CYCLONEDDS_URI says, or the one that DDS chooses.
    """

    def __init__(self, domain: int | None = None, interface: str | None = None) -> None:
        self.domain, self.interface = resolve_domain(domain), interface
        self._participant: Any = None
        self._configured: Any = None

    def __enter__(self) -> "DdsParticipant":
        """Join the domain; raises `DdsUnavailable`."""
        from cyclonedds.core import DDSException
        from cyclonedds.domain import Domain, DomainParticipant

        known = [name for _, name in if_nameindex()]
        if self.interface is not None and self.interface not in known:
            raise DdsUnavailable(
                f"expected --interface to name one of {', '.join(known) or 'no network interfaces'}, got {self.interface}; name one"
            )
        try:
            self._configured = None if self.interface is None else Domain(self.domain, configuration(self.interface))
            self._participant = DomainParticipant(self.domain)
        except DDSException as error:
            raise DdsUnavailable(
                f"expected a network interface for DDS in domain {self.domain}, got none that works; name one with --interface, "
                f"{_LOOPBACK} for this computer alone, or correct {_CONFIGURATION_VARIABLE}"
            ) from error
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._participant, self._configured = None, None

    def writer(self, path: str, message_type: str, profile: QosProfile) -> "DdsWriter":
        """Return a writer on a topic of ROS 2."""
        from cyclonedds.pub import DataWriter

        return DdsWriter(DataWriter(self._participant, self._topic(path, message_type), _qos(profile)), message_type)

    def reader(self, path: str, message_type: str, profile: QosProfile) -> "DdsReader":
        """Return a reader of a topic of ROS 2."""
        from cyclonedds.sub import DataReader

        return DdsReader(DataReader(self._participant, self._topic(path, message_type), _qos(profile)))

    def _topic(self, path: str, message_type: str) -> Any:
        from cyclonedds.topic import Topic as DdsTopic

        return DdsTopic(self._participant, f"rt{path}", dds_type(message_type))


def configuration(interface: str) -> str:
    """Return Cyclone's configuration for one network interface."""
    loopback = interface == _LOOPBACK
    multicast = ' multicast="true"' if loopback else ""
    return (
        f'<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="{interface}"{multicast}/></Interfaces>'
        f'{_LOOPBACK_DATAGRAMS * loopback}</General><Internal><SocketReceiveBufferSize max="8 MB"/>'
        "<Watermarks><WhcHigh>8 MB</WhcHigh></Watermarks></Internal></Domain></CycloneDDS>"
    )


def resolve_domain(domain: int | None) -> int:
    """Return the number of the domain, by ROS_DOMAIN_ID where none is given; raises `InvalidRos2Option`."""
    text = os.environ.get(_DOMAIN_VARIABLE, "0") if domain is None else str(domain)
    if not text.isdecimal() or int(text) > _LAST_DOMAIN:
        raise InvalidRos2Option(
            f"expected a DDS domain from 0 to {_LAST_DOMAIN}, got {text}; correct --domain or {_DOMAIN_VARIABLE}"
        )
    return int(text)


def _qos(profile: QosProfile) -> Any:
    """Return a quality of service in the words of cyclonedds."""
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.util import duration

    is_best_effort = profile is QosProfile.SENSOR_DATA
    reliable = Policy.Reliability.Reliable(duration(milliseconds=_LONGEST_WRITE_MS))
    return Qos(
        Policy.Reliability.BestEffort if is_best_effort else reliable,
        Policy.Durability.TransientLocal if profile is QosProfile.LATCHED else Policy.Durability.Volatile,
        Policy.History.KeepLast(_DEPTHS[profile]),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )


class DdsWriter:
    """Writes messages on one topic and counts those that a stalled subscriber did not let through."""

    def __init__(self, writer: Any, message_type: str) -> None:
        self._writer, self._message_type = writer, message_type
        self.written = self.dropped = 0

    @property
    def has_subscribers(self) -> bool:
        """Whether anybody listens."""
        return bool(self._writer.get_matched_subscriptions())

    def write(self, cdr: bytes) -> None:
        """Write a message, or drop it after `_LONGEST_WRITE_MS`."""
        from cyclonedds.core import DDSException

        try:
            self._writer.write(wrap_cdr(self._message_type, cdr))
        except DDSException as error:
            if error.code != DDSException.DDS_RETCODE_TIMEOUT:
                raise DdsUnavailable(
                    f"expected to write on the network, got: {error.msg}; check the network"
                ) from error
            self.dropped += 1
        else:
            self.written += 1


class DdsReader:
    """Reads messages of one topic."""

    def __init__(self, reader: Any) -> None:
        self._reader = reader

    def take(self, most: int = 10) -> list[bytes]:
        """Return the messages in CDR that have arrived, without waiting."""
        return [
            sample.cdr for sample in self._reader.take(most) if hasattr(sample, "cdr")
        ]  # others tell that a writer left


class _ReadingRecorder:
    """Records readings in a thread of its own, so that a slow disk delays neither the sensor nor subscribers."""

    def __init__(self, path: Path, messages: SensorMessages) -> None:
        topics = {Topic.IMAGES, Topic.ESTIMATED, Topic.COVARIANCE, Topic.WARNINGS}
        metadata = RecordingMetadata(messages.folder.id, purpose="ros2", source=messages.name)
        self.writer = RecordingWriter(path, metadata, topics, sensor_folder_attachments(messages.folder.path))
        self.trouble: NinedtactError | None = None
        self._waiting: Queue[Reading | None] = Queue(_WAITING_READINGS)
        self._thread = Thread(target=self._run, name=f"record {path}", daemon=True)
        self.writer.__enter__()
        self._thread.start()

    def add(self, reading: Reading) -> None:
        """Record a reading; it is dropped, and counted by the writer, where too many wait."""
        with suppress(Full):
            self._waiting.put_nowait(reading)

    def close(self) -> None:
        """Write what waits and finish the file; raises what writing raised."""
        self._waiting.put(None)
        self._thread.join()
        self.writer.__exit__(None, None, None)
        if self.trouble is not None:
            raise self.trouble

    def _run(self) -> None:
        while (reading := self._waiting.get()) is not None:
            try:
                if self.trouble is None:
                    self.writer.write_image(reading.frame)
                    if reading.force is not None:
                        self.writer.write_estimated(reading.force, reading.frame.index)
            except NinedtactError as trouble:
                self.trouble = trouble


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
    published: int = field(default=0, init=False)
    """Readings published."""
    _recorder: _ReadingRecorder | None = field(default=None, init=False)

    def run(self, should_stop: Callable[[], bool]) -> None:
        """Publish until `should_stop` is true or the source ends; raises what the sensor raises."""
        make = self.participant.writer
        self._writers = {
            topic: make(self.messages.path(topic), LIVE_TOPICS[topic][0], profile)
            for topic, profile in self.profiles.items()
        }
        transforms = make(TF_STATIC, TF_TYPE, QosProfile.LATCHED)
        transforms.write(self.messages.encode_static_transforms(monotonic_ns() + wall_minus_monotonic_ns()))
        commands = self.participant.reader(self.messages.path(COMMAND), STRING_TYPE, QosProfile.RELIABLE)
        last, status_at = None, 0.0
        try:
            with SensorPoller(self.sensor, self._record) as poller:
                while not should_stop():
                    poller.wait_for_change(_COMMAND_WAIT_S)
                    now = poller.snapshot(monotonic_ns())
                    if now.phase is SensorPhase.FAILED and now.trouble is not None:
                        raise now.trouble
                    if now.reading is not None and now.reading is not last:
                        self.publish(last := now.reading)
                    for command in commands.take():
                        self._write_status(now.phase, **self._obey(decode_command(command), poller))
                    if monotonic() - status_at > _STATUS_S:
                        status_at = monotonic()
                        self._write_status(now.phase, read_hz=round(now.read_hz, 1))
                    if now.phase is SensorPhase.ENDED:
                        break
        finally:
            self._stop_recording()

    def publish(self, reading: Reading) -> None:
        """Publish a reading on all topics to which anybody subscribes."""
        wall_ns = reading.stamp_ns + wall_minus_monotonic_ns()
        wanted = {topic for topic, writer in self._writers.items() if writer.has_subscribers}
        for topic, message in self.messages.encode(reading, wall_ns, wanted).items():
            self._writers[topic].write(message)
        self.published += 1

    def _record(self, reading: Reading) -> None:
        """Hand a reading to the recording that is being made; called in the sensor thread."""
        recorder = self._recorder
        if recorder is not None:
            recorder.add(reading)

    def _obey(self, command: str, poller: SensorPoller) -> dict[str, Any]:
        """Carry a command out and return the answer."""
        word, _, argument = command.partition(" ")
        try:
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
            return self._stop_recording() or "nothing was being recorded"
        raise InvalidRos2Option(
            f"expected take_reference, start_recording [NAME] or stop_recording, got {word!r}; send one of them"
        )

    def _start_recording(self, name: str) -> str:
        if self._recorder is not None:
            raise InvalidRos2Option(
                f"expected no recording in progress, got {self._recorder.writer.path}; stop it first"
            )
        name = name or f"{self.messages.name}_{monotonic_ns() + wall_minus_monotonic_ns()}"
        if Path(name).name != name or name.startswith("."):
            raise InvalidRos2Option(f"expected the name of a recording without a folder, got {name!r}; leave it out")
        self.out.mkdir(parents=True, exist_ok=True)
        self._recorder = _ReadingRecorder(self.out / f"{name.removesuffix('.mcap')}.mcap", self.messages)
        return f"recording to {self._recorder.writer.path}"

    def _stop_recording(self) -> str:
        """Finish the recording; return a sentence about it, or nothing where there was none."""
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            return ""
        recorder.close()
        return (
            f"{recorder.writer.path}: {recorder.writer.written[Topic.IMAGES]} images, {recorder.writer.dropped} dropped"
        )

    def _write_status(self, phase: SensorPhase, **fields: Any) -> None:
        recorder = self._recorder
        state = {
            "sensor": self.messages.name,
            "phase": phase.value,
            "published": self.published,
            "dropped": sum(writer.dropped for writer in self._writers.values()),
            "recording": None if recorder is None else str(recorder.writer.path),
            "camera_info_residual_px": round(self.messages.camera.residual_px, 3),
        }
        self._writers[STATUS].write(encode_status({**state, **fields}))
