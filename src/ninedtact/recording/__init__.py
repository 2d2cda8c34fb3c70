"""Recordings: what a sensor delivers, as one MCAP file of ROS 2 messages with the sensor folder attached.

In go a `FrameSource`, a `WrenchSource` and a sensor folder (`record`), or a person's presses (`collecting`). Out comes a file,
which `Recording` reads again, `RecordedSource` plays as a camera, `export_recording` writes out as images and tables,
and `read_saved_pairs` turns into training pairs. The names below load when they are first used, because
they need the libraries of the extra `recording`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ninedtact.recording.export import export_recording
    from ninedtact.recording.mcap_repair import repair_recording
    from ninedtact.recording.metadata import RecordingMetadata
    from ninedtact.recording.reader import Recording, RecordingSummary
    from ninedtact.recording.recorded_source import RecordedSource, RecordedWrenchSource
    from ninedtact.recording.recorder import record
    from ninedtact.recording.ros_messages import Topic
    from ninedtact.recording.saved_pairs import SavedPair, read_saved_pairs
    from ninedtact.recording.writer import RecordingWriter

_MODULES = {
    "RecordedSource": "recorded_source",
    "RecordedWrenchSource": "recorded_source",
    "Recording": "reader",
    "RecordingMetadata": "metadata",
    "RecordingSummary": "reader",
    "RecordingWriter": "writer",
    "SavedPair": "saved_pairs",
    "Topic": "ros_messages",
    "export_recording": "export",
    "read_saved_pairs": "saved_pairs",
    "record": "recorder",
    "repair_recording": "mcap_repair",
}

__all__ = [
    "RecordedSource",
    "RecordedWrenchSource",
    "Recording",
    "RecordingMetadata",
    "RecordingSummary",
    "RecordingWriter",
    "SavedPair",
    "Topic",
    "export_recording",
    "read_saved_pairs",
    "record",
    "repair_recording",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its module."""
    if name not in _MODULES:
        raise AttributeError(f"module 'ninedtact.recording' has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
