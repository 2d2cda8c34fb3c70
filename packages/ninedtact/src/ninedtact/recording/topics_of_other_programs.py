"""Recordings of our topics that another program wrote: `ros2 bag record`, or the tools of MCAP on one of our files.

They have neither metadata nor a sensor folder. The names of the sensors and the storage of images follow from the topics. Stamps
are the times at which the other program received the messages, on the clock of the file.
"""

import re
from collections.abc import Mapping

from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.mcap_file import McapFile
from ninedtact.recording.metadata import (
    LATEST_NS,
    METADATA_RECORD,
    ImageStorage,
    RecordingMetadata,
    parse_sensor_metadata,
)
from ninedtact.recording.topics_and_messages import Topic

_IMAGE_TOPIC = re.compile(rf"/(\w{{1,100}})/{Topic.IMAGES}(/compressed)?")
_SAME_CLOCK_NS = 60_000_000_000
"""Difference below which a time of publishing and a time of receiving are of one clock."""


def is_of_other_program(file: McapFile) -> bool:
    """Return whether a file lacks the metadata that recordings of this package begin with."""
    return all(one.name != METADATA_RECORD for one in file.metadata)


def read_sensor_metadata(file: McapFile) -> tuple[RecordingMetadata, ...]:
    """Return the metadata of every sensor of a file, which follow from its topics where another program wrote it.

    Raises `RecordingUnreadable`.
    """
    if not is_of_other_program(file):
        return parse_sensor_metadata(file.metadata, file.path)
    storage = _storage_of_sensors(file.types_of_topics)
    if not storage:
        raise RecordingUnreadable(
            expected=f"a recording of ninedtact in {file.path}",
            got=f"an MCAP file of another program without a topic /SENSOR/{Topic.IMAGES} of ROS, or one that was cut "
            f"short before it began: {_listed(file.types_of_topics)}",
            remedy="record with 'ninedtact record'",
        )
    return tuple(_metadata_of_topics(file, sensor, images, len(storage)) for sensor, images in storage.items())


def _listed(types_of_topics: Mapping[str, str]) -> str:
    """Return the first topics of a file and their types in words."""
    return ", ".join(f"{topic} ({kind})" for topic, kind in types_of_topics.items())[:200] or "no topics"


def _metadata_of_topics(file: McapFile, sensor: str, images: ImageStorage, sensors: int) -> RecordingMetadata:
    positions = file.positions(Topic.IMAGES.path(sensor, images))
    wall_ahead_ns = 0
    if len(positions):
        first = file.message(positions[0])
        wall_ahead_ns = first.publish_time - first.log_time
        if not _SAME_CLOCK_NS < abs(wall_ahead_ns) <= LATEST_NS:  # the other program stamped with the wall clock itself
            wall_ahead_ns = 0
    began_ns = wall_ahead_ns + int(positions["stamp_ns"][0]) if len(positions) else 0
    return RecordingMetadata(
        sensor,
        images=images,
        name=sensor if sensors > 1 else "",
        source="another program, which kept no metadata",
        software="",
        id=f"{sensor}-{began_ns}",
        wall_minus_monotonic_ns=wall_ahead_ns,
    )


def _storage_of_sensors(types_of_topics: Mapping[str, str]) -> dict[str, ImageStorage]:
    """Return how the images of every sensor are stored, by its name in topics; raw ones where both kinds are there."""
    storage: dict[str, ImageStorage] = {}
    for topic, message_type in sorted(types_of_topics.items()):
        match = _IMAGE_TOPIC.fullmatch(topic)
        images: ImageStorage = "zstd" if match is None or match[2] is None else "png"
        if match is not None and message_type == Topic.IMAGES.message_type(images):
            storage.setdefault(match[1], images)
    return storage
