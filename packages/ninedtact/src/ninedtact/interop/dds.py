"""ROS 2 without ROS: messages in CDR to and from the network by DDS (Eclipse Cyclone DDS; extra `ros2`).

ROS 2 maps topic `/a/b` to the DDS topic `rt/a/b` and type `std_msgs/msg/String` to `std_msgs::msg::dds_::String_`. Cyclone's own
serialisation takes tens of milliseconds for an image, so that the types here carry CDR bytes that rosbags has encoded; their
fields serve discovery and Cyclone's tools.
"""

import os
from dataclasses import dataclass as idl_dataclass
from functools import cache
from socket import if_nameindex
from types import new_class
from typing import Any

from ninedtact.errors import DeviceError, InputError
from ninedtact.interop.ros2_topics_and_messages import LIVE_TOPICS, STATUS, QosProfile
from ninedtact.recording.topics_and_messages import type_store

_CONFIGURATION_VARIABLE = "CYCLONEDDS_URI"
_DOMAIN_VARIABLE = "ROS_DOMAIN_ID"
_LAST_DOMAIN = 232
_LOOPBACK = "lo"
_LOOPBACK_DATAGRAMS = "<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>65000B</FragmentSize>"
"""Loopback carries whole UDP datagrams, so that an image takes 15 instead of 700."""
_LONGEST_WRITE_MS = 20
"""Longest time for which a write waits for a subscriber that does not keep up; the message is then dropped and counted."""
_DEPTHS = {QosProfile.SENSOR_DATA: 5, QosProfile.RELIABLE: 10, QosProfile.LATCHED: 1}
_STATUS_DEPTH = 10
"""Messages on `status` that are kept, whatever its profile: answers to commands sent at once must not replace each other."""


def parse_qos(choices: tuple[str, ...]) -> dict[str, QosProfile]:
    """Return the quality of service of every published topic, where `choices` such as `points=sensor_data` change the defaults.

    Raises `InputError`.
    """
    profiles = {str(topic): profile for topic, (_, profile) in LIVE_TOPICS.items()}
    for choice in choices:
        topic, _, profile = choice.partition("=")
        if topic not in profiles or profile not in list(QosProfile):
            raise InputError(
                expected=f"--qos as TOPIC=PROFILE with a topic of {', '.join(profiles)} and a profile of "
                f"{', '.join(QosProfile)}",
                got=f"{choice}",
                remedy="correct it",
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
        lambda this, data, has_header=True, use_version_2=None: wrap_cdr_in_dds_type(message_type, bytes(data))
    )
    return made


def wrap_cdr_in_dds_type(message_type: str, cdr: bytes) -> Any:
    """Return an object of the DDS type that carries a message in CDR."""
    sample = dds_type(message_type).__new__(dds_type(message_type))
    sample.cdr = cdr
    return sample


def _dds_field(node: Any) -> Any:
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
        """Join the domain; raises `DeviceError`."""
        known = [name for _, name in if_nameindex()]
        if self.interface is not None and self.interface not in known:
            raise DeviceError(
                expected=f"--interface to name one of {', '.join(known) or 'no network interfaces'}",
                got=f"{self.interface}",
                remedy="name one",
            )
        from cyclonedds.core import DDSException
        from cyclonedds.domain import Domain, DomainParticipant

        try:
            self._configured = (
                None if self.interface is None else Domain(self.domain, cyclonedds_configuration(self.interface))
            )
            self._participant = DomainParticipant(self.domain)
        except DDSException as error:
            raise DeviceError(
                expected=f"a network interface for DDS in domain {self.domain}",
                got="none that works",
                remedy=f"name one with --interface, {_LOOPBACK} for this computer alone, or correct "
                f"{_CONFIGURATION_VARIABLE}",
            ) from error
        return self

    def __exit__(self, *_: object) -> None:
        self._participant, self._configured = None, None

    def writer(self, path: str, message_type: str, profile: QosProfile) -> "DdsWriter":
        """Return a writer on a topic of ROS 2."""
        from cyclonedds.pub import DataWriter

        topic = self._topic(path, message_type)
        return DdsWriter(DataWriter(self._participant, topic, _qos(path, profile)), message_type)

    def reader(self, path: str, message_type: str, profile: QosProfile) -> "DdsReader":
        """Return a reader of a topic of ROS 2."""
        from cyclonedds.sub import DataReader

        return DdsReader(DataReader(self._participant, self._topic(path, message_type), _qos(path, profile)))

    def _topic(self, path: str, message_type: str) -> Any:
        from cyclonedds.topic import Topic as DdsTopic

        return DdsTopic(self._participant, f"rt{path}", dds_type(message_type))


def cyclonedds_configuration(interface: str) -> str:
    """Return the configuration (XML) of CycloneDDS for one network interface."""
    loopback = interface == _LOOPBACK
    multicast = ' multicast="true"' if loopback else ""
    return (
        f'<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="{interface}"{multicast}/></Interfaces>'
        f'{_LOOPBACK_DATAGRAMS * loopback}</General><Internal><SocketReceiveBufferSize max="8 MB"/>'
        "<Watermarks><WhcHigh>8 MB</WhcHigh></Watermarks></Internal></Domain></CycloneDDS>"
    )


def resolve_domain(domain: int | None) -> int:
    """Return the number of the domain, by ROS_DOMAIN_ID where none is given; raises `InputError`."""
    text = (os.environ.get(_DOMAIN_VARIABLE) or "0") if domain is None else str(domain)
    if not text.isdecimal() or int(text) > _LAST_DOMAIN:
        raise InputError(
            expected=f"a DDS domain from 0 to {_LAST_DOMAIN}",
            got=f"{text}",
            remedy=f"correct --domain or {_DOMAIN_VARIABLE}",
        )
    return int(text)


def _qos(path: str, profile: QosProfile) -> Any:
    """Return the quality of service of a topic in the words of cyclonedds."""
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.util import duration

    depth = _STATUS_DEPTH if path.endswith(f"/{STATUS}") else _DEPTHS[profile]
    is_best_effort = profile is QosProfile.SENSOR_DATA
    reliable = Policy.Reliability.Reliable(duration(milliseconds=_LONGEST_WRITE_MS))
    history, unlimited = Policy.History.KeepLast(depth), -1
    return Qos(
        Policy.Reliability.BestEffort if is_best_effort else reliable,
        Policy.Durability.TransientLocal if profile is QosProfile.LATCHED else Policy.Durability.Volatile,
        history,
        Policy.DurabilityService(0, history, unlimited, unlimited, unlimited),  # for who subscribes later
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
            self._writer.write(wrap_cdr_in_dds_type(self._message_type, cdr))
        except DDSException as error:
            if error.code != DDSException.DDS_RETCODE_TIMEOUT:
                raise DeviceError(f"expected to write on the network, got: {error.msg}; check the network") from error
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
