"""The errors of recordings, and the check that the libraries for recordings are installed. This module loads no library."""

from importlib.util import find_spec

from ninedtact.errors import DatasetError, FileFormatError, InputError, MissingLibraryError, OutputError


class RecordingUnreadable(FileFormatError):
    """Not a recording of this program, or one whose content is damaged."""


class RecordingRefused(OutputError):
    """A recording cannot be started with these options or at this path."""


class RecordingStopped(DatasetError):
    """Nothing more can be written; what was written is kept."""


class RecordingLibrariesMissing(MissingLibraryError):
    """The libraries that read and write recordings are not installed."""


class SourcesMismatched(InputError):
    """A camera and a force/torque sensor that cannot belong together."""


class SensorUnnamed(InputError):
    """Neither a sensor folder was named nor a recording that carries one."""


def require_recording_libraries() -> None:
    """Raise `RecordingLibrariesMissing` where recordings can be neither read nor written."""
    absent = [name for name in ("rosbags", "mcap") if find_spec(name) is None]
    if absent:
        raise RecordingLibrariesMissing(
            f"expected rosbags and mcap, which read and write recordings, got no {' and no '.join(absent)}; run "
            "pip install 'ninedtact[recording]'"
        )
