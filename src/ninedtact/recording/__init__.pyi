from .collected_pairs import SavedPair, read_saved_pairs
from .export import export_recording
from .mcap_repair import repair_recording
from .metadata import RecordingMetadata
from .reader import Recording, sensor_addresses
from .recorded_source import RecordedSource, RecordedWrenchSource
from .recorder import SensorToRecord, record, record_several
from .summary import RecordingSummary
from .topics_and_messages import Topic
from .writer import RecordingWriter

__all__ = [
    "RecordedSource",
    "RecordedWrenchSource",
    "Recording",
    "RecordingMetadata",
    "RecordingSummary",
    "RecordingWriter",
    "SavedPair",
    "SensorToRecord",
    "Topic",
    "export_recording",
    "read_saved_pairs",
    "record",
    "record_several",
    "repair_recording",
    "sensor_addresses",
]
