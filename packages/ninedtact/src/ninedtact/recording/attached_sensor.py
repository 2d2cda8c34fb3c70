"""The sensor folder that a recording carries, one attachment for each of its files."""

import re
from collections.abc import Iterable
from pathlib import Path, PurePosixPath

from mcap.records import Attachment

SENSOR_FOLDER, SEVERAL_FOLDERS = "sensor", "sensors"
"""First part of the names of the attachments; among several sensors, the name of the sensor is the second."""


def sensor_folder_attachments(folder: Path, name: str = "") -> dict[str, bytes]:
    """Return the content of the files of a sensor folder by the names that they have in a recording.

    name: of the sensor among several.
    """
    return {f"{_attached_folder(name)}/{file}": content for file, content in read_folder_files(folder).items()}


def attached_sensor_files(attachments: Iterable[Attachment], name: str) -> dict[str, bytes]:
    """Return the content of an attached sensor folder's files by their paths in it.

    name: of the sensor among several. Paths that lead elsewhere, or into a file, are skipped.
    """
    folder, files = PurePosixPath(_attached_folder(name)).parts, {}
    for attachment in attachments:
        parts = PurePosixPath(attachment.name).parts
        if parts[: len(folder)] == folder and _is_path_in_folder(parts[len(folder) :]):
            files[PurePosixPath(*parts[len(folder) :])] = attachment.data
    return {str(path): data for path, data in files.items() if files.keys().isdisjoint(path.parents)}


def _is_path_in_folder(parts: tuple[str, ...]) -> bool:
    """Return whether parts of a path name a file in a folder on every system."""
    names = (
        name != ".." and len(name.encode()) <= 255 and not re.search(r'[\x00-\x1f\x7f<>:"|?*\\]', name)
        for name in parts
    )
    return 0 < len(parts) <= 8 and all(names)


def _attached_folder(name: str) -> str:
    return f"{SEVERAL_FOLDERS}/{name}" if name else SENSOR_FOLDER


def read_folder_files(folder: Path) -> dict[str, bytes]:
    """Return the content of all files of a folder by their paths in it."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
