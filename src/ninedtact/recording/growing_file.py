"""A file that only grows, by whole records: whatever stops it, what stands in it can be read."""

import os
from pathlib import Path

from ninedtact.errors import NinedtactError


class RecordingRefused(NinedtactError):
    """An episode cannot be begun there."""


class RecordingStopped(NinedtactError):
    """Nothing more can be written; what was written is kept."""


class GrowingFile:
    """The output of an MCAP writer, which hands over whole records with every write; nothing waits in this process.

    Not synced to the disk: it outlives the program, not a power cut.
    """

    def __init__(self, path: Path) -> None:
        """Begin a new file; raises `RecordingRefused`."""
        self.path, self._end = path, 0
        try:
            self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError as trouble:
            raise RecordingRefused(f"expected a new file to record to, got {path}; choose another name") from trouble
        except OSError as trouble:
            raise RecordingRefused(
                f"expected to begin {path}, got: {trouble.strerror}; correct the path and its permissions"
            ) from trouble

    def write(self, records: bytes) -> int:
        """Append whole records, or none of them; raises `RecordingStopped`."""
        left = memoryview(records)
        try:
            while left:
                left = left[os.write(self._file, left) :]
        except BaseException as trouble:
            os.ftruncate(self._file, self._end)
            os.lseek(self._file, self._end, os.SEEK_SET)
            if isinstance(trouble, OSError):
                raise RecordingStopped(stopped(self.path, trouble)) from trouble
            raise
        self._end += len(records)
        return len(records)

    def tell(self) -> int:
        """Where the next record will stand."""
        return self._end

    def flush(self) -> None:
        """Nothing waits."""

    def close(self) -> None:
        """Let go of the file; its number may soon be another file's."""
        descriptor, self._file = self._file, -1
        os.close(descriptor)


def stopped(path: Path, trouble: OSError) -> str:
    """What is said when the disk takes no more."""
    return (
        f"expected to write on to {path}, got: {trouble.strerror}; what was recorded until then is kept: free the disk, and "
        "record on under another name"
    )
