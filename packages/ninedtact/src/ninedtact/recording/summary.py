"""The summary of a recording: what `ninedtact info` prints."""

from dataclasses import dataclass

import numpy as np
from numpy import ndarray as Array

from ninedtact.recording.topics_and_messages import LabelledSpan, Topic

_GAP_FACTOR = 2.5
"""Ratio of an interval between two messages to the usual one from which messages count as missing in between."""
PERIODIC_TOPICS = (Topic.IMAGES, Topic.MEASURED, Topic.ESTIMATED, Topic.HEIGHTS)
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
    calibration_checksum: str
    """That of the sensor folder in the recording; empty where there is none."""
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


def usual_rate_hz(stamps_ns: Array) -> float:
    """Return the usual rate of some stamps, by the mean of their distances near the lower median; 30 if unknown.

    Gaps do not change it. The times of many video formats are whole milliseconds: 60 Hz are 17, 17, 16.
    """
    steps_ns = np.diff(stamps_ns)
    median_ns = float(np.quantile(steps_ns, 0.5, method="lower")) if len(steps_ns) else 0.0
    usual_ns = float(steps_ns[np.abs(steps_ns - median_ns) <= 0.5 * median_ns].mean()) if median_ns > 0 else 0.0
    return 1e9 / usual_ns if usual_ns > 0 else _DEFAULT_HZ


def summarise_topic(topic: str, type_name: str, stamps_ns: Array, is_periodic: bool) -> TopicSummary:
    """Return the summary of the messages with these stamps; is_periodic: whether they arrive at a rate."""
    if not is_periodic or len(stamps_ns) < 3:
        return TopicSummary(topic, type_name, len(stamps_ns))
    steps_ns = np.diff(stamps_ns)
    longest_ms, gaps = float(steps_ns.max() / 1e6), int((steps_ns > _GAP_FACTOR * np.median(steps_ns)).sum())
    return TopicSummary(topic, type_name, len(stamps_ns), usual_rate_hz(stamps_ns), longest_ms, gaps)
