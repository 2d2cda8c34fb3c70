from .export import export_recording
from .labels_and_whole_copy import write_whole_copy
from .metadata import RecordingMetadata
from .reader import Recording, recorded_sensor_addresses
from .recorded_source import RecordedFrameSource, RecordedWrenchSource
from .recorder import SensorToRecord, record, record_several
from .summary import RecordingSummary
from .topics_and_messages import Topic
from .writer import RecordingWriter

__all__ = [
    "RecordedFrameSource",
    "RecordedWrenchSource",
    "Recording",
    "RecordingMetadata",
    "RecordingSummary",
    "RecordingWriter",
    "SensorToRecord",
    "Topic",
    "export_recording",
    "record",
    "record_several",
    "recorded_sensor_addresses",
    "write_whole_copy",
]
