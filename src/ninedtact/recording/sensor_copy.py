"""The sensor's folder rides along in an episode: whoever has the file has the calibration."""

from pathlib import Path, PurePosixPath

from ninedtact.recording.stored import Episode
from ninedtact.recording.unreadable import RecordingUnreadable

FOLDER = "sensor"
"""What the names of its attachments begin with."""


def attachments_of(folder: Path) -> dict[str, bytes]:
    """The files of a sensor folder by the names that they have in an episode."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {f"{FOLDER}/{path.relative_to(folder).as_posix()}": path.read_bytes() for path in files}


def restore_sensor(recording: Path | str, into: Path) -> Path:
    """Write the sensor folder that a recording carries; raises `RecordingUnreadable` where it carries none."""
    with Episode(recording) as episode:
        copied = [write_copy(into, attachment.name, attachment.data) for attachment in episode.attachments()]
    if not any(copied):
        raise RecordingUnreadable(
            f"expected {recording} to carry its sensor's folder, got a recording without; name one with --sensor"
        )
    return into


def write_copy(into: Path, name: str, content: bytes) -> bool:
    """Write one file of the sensor folder; whether it belongs there. Names that lead elsewhere do not."""
    way = PurePosixPath(name)
    if way.parts[:1] != (FOLDER,) or len(way.parts) < 2 or ".." in way.parts or way.is_absolute():
        return False
    path = into.joinpath(*way.parts[1:])
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return True
