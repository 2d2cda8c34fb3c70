"""The errors of recordings, and the check that the libraries for recordings are installed. This module loads no library."""

from ninedtact.errors import DatasetError, FileFormatError
from ninedtact.required_libraries import require_libraries


class RecordingUnreadable(FileFormatError):
    """Raised for a file that is not a recording of this program, or whose content is damaged."""


class RecordingStopped(DatasetError):
    """Raised where nothing more can be written; the messages written before are kept."""


def require_recording_libraries() -> None:
    """Raise `MissingLibraryError` where recordings can be neither read nor written."""
    require_libraries("recording", "rosbags", "mcap")
