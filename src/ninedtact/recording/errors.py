"""What is said of a file that is no episode, and of an extra that is not installed."""

from importlib.util import find_spec

from ninedtact.errors import NinedtactError


class RecordingUnreadable(NinedtactError):
    """Not an episode of this program, or one whose content is damaged."""


class RecordingLibrariesMissing(NinedtactError):
    """The libraries that read and write episodes are not installed."""


def require_recording_libraries() -> None:
    """Refuse at once where episodes can be neither read nor written; raises `RecordingLibrariesMissing`."""
    absent = [name for name in ("rosbags", "mcap") if find_spec(name) is None]
    if absent:
        raise RecordingLibrariesMissing(
            f"expected rosbags and mcap, which read and write recordings, got no {' and no '.join(absent)}; run "
            "pip install 'ninedtact[recording]'"
        )
