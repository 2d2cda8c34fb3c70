"""The errors of recordings, and the check that the libraries for recordings are installed. This module loads no library."""

from importlib.util import find_spec

from ninedtact._version import installation_command
from ninedtact.errors import DatasetError, FileFormatError, MissingLibraryError


class RecordingUnreadable(FileFormatError):
    """Raised for a file that is not a recording of this program, or whose content is damaged."""


class RecordingStopped(DatasetError):
    """Raised where nothing more can be written; the messages written before are kept."""


def require_recording_libraries() -> None:
    """Raise `MissingLibraryError` where recordings can be neither read nor written."""
    absent = [name for name in ("rosbags", "mcap") if find_spec(name) is None]
    if absent:
        raise MissingLibraryError(
            expected="rosbags and mcap, which read and write recordings",
            got=f"no {' and no '.join(absent)}",
            remedy=f"run {installation_command('recording')}",
        )
