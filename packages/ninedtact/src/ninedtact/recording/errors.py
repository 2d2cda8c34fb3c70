"""The errors of recordings, and the check that the libraries for recordings are installed. This module loads no library."""

from importlib.util import find_spec

from ninedtact._version import installation_command
from ninedtact.errors import DatasetError, FileFormatError, InputError, MissingLibraryError, OutputError


class RecordingUnreadable(FileFormatError):
    """Raised for a file that is not a recording of this program, or whose content is damaged."""


class RecordingRefused(OutputError):
    """Raised where a recording cannot be started with these options or at this path."""


class RecordingStopped(DatasetError):
    """Raised where nothing more can be written; the messages written before are kept."""


class WrenchSourceMismatched(InputError):
    """Raised for a camera and a force/torque sensor that cannot belong together."""


class SensorNotGiven(InputError):
    """Raised where neither a sensor folder nor a recording that carries one was given."""


class ReferenceMomentRefused(InputError):
    """Raised for a moment that is not in the recording, or at which its images cannot be a reference (no contact)."""


def require_recording_libraries() -> None:
    """Raise `MissingLibraryError` where recordings can be neither read nor written."""
    absent = [name for name in ("rosbags", "mcap") if find_spec(name) is None]
    if absent:
        raise MissingLibraryError(
            expected="rosbags and mcap, which read and write recordings",
            got=f"no {' and no '.join(absent)}",
            remedy=f"run {installation_command('recording')}",
        )
