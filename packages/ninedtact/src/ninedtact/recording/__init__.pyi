from .collected_pairs import RecordedPair, read_recorded_pairs
from .export import export_recording
from .mcap_repair import repair_recording
from .metadata import RecordingMetadata
from .reader import Recording, recorded_sensor_addresses
from .recorded_source import RecordedFrameSource, RecordedWrenchSource
from .recorder import SensorToRecord, record, record_several
from .summary import RecordingSummary
from .topics_and_messages import Topic
from .writer import RecordingWriter

__all__ = [
    "RecordedFrameSource",
    "RecordedPair",
    "RecordedWrenchSource",
    "Recording",
    "RecordingMetadata",
    "RecordingSummary",
    "RecordingWriter",
    "SensorToRecord",
    "Topic",
    "export_recording",
    "read_recorded_pairs",
    "record",
    "record_several",
    "recorded_sensor_addresses",
    "repair_recording",
]
