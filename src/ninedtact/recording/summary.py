"""What a recording holds, in figures: rates, drops and gaps."""

from collections import Counter
from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from numpy import ndarray as Array

from ninedtact.recording.reader import Recording
from ninedtact.recording.recorded_source import median_rate_hz
from ninedtact.recording.ros_messages import TYPES, EventKind, Topic
from ninedtact.recording.saved_pairs import SavedPairReader

GAP = 2.5
"""Times the usual distance of two messages, from which something is missing."""
STEADY = (Topic.IMAGES, Topic.MEASURED, Topic.ESTIMATED, Topic.HEIGHTS)
"""Topics that come at a rate, where they were not chosen one by one."""


@dataclass(frozen=True)
class TopicSummary:
    """One topic."""

    topic: str
    type: str
    messages: int
    rate_hz: float | None = None
    """Usual rate; None where messages come as they may."""
    longest_gap_ms: float | None = None
    gaps: int | None = None
    """Times that something is missing between two messages."""


@dataclass(frozen=True)
class RecordingSummary:
    """One recording."""

    sensor: str
    source: str
    force_torque: str
    purpose: str
    session: str
    began: str
    """UTC."""
    seconds: float
    finished: bool
    """Closed in order; if not, its last half second may be missing."""
    dropped: int
    """Images that the source counted and nobody could write."""
    topics: list[TopicSummary]
    pairs: dict[str, int]
    """Of each kind, undone contacts taken out."""
    events: dict[str, int]


def summarise_recording(episode: Recording) -> RecordingSummary:
    """The figures of an open recording."""
    events = episode.events()
    stamps_ns = [stamps for topic in Topic if len(stamps := episode.stamps_ns(topic))]
    first_ns, last_ns = (
        (int(end) for end in (min(map(np.min, stamps_ns)), max(map(np.max, stamps_ns)))) if stamps_ns else (0, 0)
    )
    began = datetime.fromtimestamp(episode.session.wall_ns(first_ns) / 1e9, UTC)
    session = episode.session
    return RecordingSummary(
        sensor=session.sensor,
        source=session.source,
        force_torque=session.force_torque,
        purpose=session.purpose,
        session=session.id,
        began=began.isoformat(timespec="milliseconds"),
        seconds=(last_ns - first_ns) / 1e9,
        finished=episode.finished,
        dropped=sum(int(event.subject) for event in events if event.kind is EventKind.DROPPED),
        topics=[figures for topic in Topic if (figures := topic_figures(episode, topic)).messages],
        pairs=dict(Counter(mark.kind for mark in SavedPairReader(episode).marks)),
        events=dict(Counter(event.kind.value for event in events)),
    )


def topic_figures(episode: Recording, topic: Topic) -> TopicSummary:
    """Rate and gaps of one topic."""
    stamps_ns = episode.stamps_ns(topic)
    chosen = topic is Topic.IMAGES and episode.session.purpose != "record"
    if topic not in STEADY or chosen or len(stamps_ns) < 3:
        return TopicSummary(topic.value, TYPES[topic], len(stamps_ns))
    longest_ms, gaps = gaps_of(stamps_ns)
    return TopicSummary(topic.value, TYPES[topic], len(stamps_ns), median_rate_hz(stamps_ns), longest_ms, gaps)


def gaps_of(stamps_ns: Array) -> tuple[float, int]:
    """The longest distance of two messages in ms, and how many are gaps."""
    apart_ns = np.diff(stamps_ns)
    return float(apart_ns.max() / 1e6), int((apart_ns > GAP * np.median(apart_ns)).sum())
