"""The summary of a recording: what `ninedtact info` prints."""

from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from ninedtact.recording.topics_and_messages import LabelledSpan, Topic

if TYPE_CHECKING:
    from ninedtact.recording.reader import Recording

_GAP_FACTOR = 2.5
"""Ratio of an interval between two messages to the usual one from which messages count as missing in between."""
_PERIODIC_TOPICS = (Topic.IMAGES, Topic.MEASURED, Topic.ESTIMATED, Topic.HEIGHTS)
"""Topics that arrive at a rate, unless their messages were selected one by one."""
_DEFAULT_HZ = 30.0


@dataclass(frozen=True)
class TopicSummary:
    """Number, rate and gaps of the messages of one topic."""

    topic: str
    type: str
    messages: int
    rate_hz: float | None = None
    """The usual rate; None where messages are not periodic."""
    longest_gap_ms: float | None = None
    gaps: int | None = None
    """How often something is missing between two messages."""


@dataclass(frozen=True)
class RecordingSummary:
    """A summary of the content of a recording, as `ninedtact info` prints it."""

    sensor: str
    name: str
    """Name of the sensor among several of the recording; empty where it is the only one."""
    source: str
    force_torque: str
    purpose: str
    id: str
    began: str
    """The start of the recording in UTC."""
    seconds: float
    finished: bool
    """Whether the file was closed properly; if not, what followed its last whole part is missing."""
    repaired: bool
    """Whether the file was cut short and completed later; what followed its last whole part is missing."""
    dropped: int
    """Images that the source counted and that were not written."""
    height_step_mm: float
    """Quantisation step of the heights; 0 where they are floating point."""
    camera_delay_ms: float
    """Delay of the camera that was subtracted from the arrival times of the images."""
    topics: list[TopicSummary]
    pairs: dict[str, int]
    """Number of pairs of each kind, undone contacts excluded."""
    events: dict[str, int]
    spans: list[LabelledSpan]
    """Stretches of time that a person has named."""


def summarise_recording(recording: "Recording") -> RecordingSummary:
    """Return sensor, duration, topics with rates and gaps, drops, pairs and events."""
    metadata = recording.metadata
    began = datetime.fromtimestamp(metadata.wall_ns(recording.began_ns) / 1e9, UTC)
    return RecordingSummary(
        sensor=metadata.sensor,
        name=metadata.name,
        source=metadata.source,
        force_torque=metadata.force_torque,
        purpose=metadata.purpose,
        id=metadata.id,
        began=began.isoformat(timespec="milliseconds"),
        seconds=recording.duration_s,
        finished=recording.is_finished,
        repaired=recording.is_repaired,
        dropped=recording.dropped_count,
        height_step_mm=metadata.height_step_mm,
        camera_delay_ms=metadata.camera_delay_ms,
        topics=[summary for topic in Topic if (summary := _summarise_topic(recording, topic)).messages],
        pairs=dict(Counter(label.kind for label in recording.kept_labels())),
        events=dict(Counter(event.kind.value for event in recording.events())),
        spans=recording.spans(),
    )


def median_rate_hz(stamps_ns: Array) -> float:
    """Return the usual rate of some stamps, by the median of their distances, which gaps do not change; 30 if unknown."""
    usual_ns = float(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else 0.0
    return 1e9 / usual_ns if usual_ns > 0 else _DEFAULT_HZ


def _summarise_topic(recording: "Recording", topic: Topic) -> TopicSummary:
    stamps_ns = recording.stamps_ns(topic)
    name, type_name = (
        topic.path(recording.metadata.topic_name, recording.metadata.images),
        topic.message_type(recording.metadata.images),
    )
    selected = topic is Topic.IMAGES and recording.metadata.purpose != "record"
    if topic not in _PERIODIC_TOPICS or selected or len(stamps_ns) < 3:
        return TopicSummary(name, type_name, len(stamps_ns))
    steps_ns = np.diff(stamps_ns)
    longest_ms, gaps = float(steps_ns.max() / 1e6), int((steps_ns > _GAP_FACTOR * np.median(steps_ns)).sum())
    return TopicSummary(name, type_name, len(stamps_ns), median_rate_hz(stamps_ns), longest_ms, gaps)
