"""Files are written whole or not at all: a temporary name in the same folder, then a rename over the final one."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from typing import BinaryIO

from ninedtact.errors import NinedtactError


class FileNotWritten(NinedtactError):
    """The disk is full, the folder is missing or closed to us; what was at the path before is still there."""


def write_whole(path: Path | str, *content: bytes | memoryview) -> None:
    """Write the parts of `content` one after the other; raises `FileNotWritten`."""
    with whole_file(path) as file:
        for part in content:
            file.write(part)


@contextmanager
def whole_file(path: Path | str) -> Iterator[BinaryIO]:
    """Open a file that appears at `path` when the block ends well; if the block raises, nothing is left of it.

    Not synced to the disk: this guards against a full disk and a stopped program, not against a power cut.
    An `OSError` in the block becomes `FileNotWritten`; everything else passes through.
    """
    final = Path(path)
    # A name of our own instead of tempfile's, whose files nobody else may read, also after the rename.
    partial = final.with_name(f".{token_hex(6)}.partial")
    try:
        with partial.open("xb") as file:
            yield file
        partial.replace(final)
    except OSError as trouble:
        partial.unlink(missing_ok=True)
        raise FileNotWritten(refusal(final, trouble)) from trouble
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def refusal(path: Path, trouble: OSError) -> str:
    """Say what stood in the way of writing `path`."""
    remedy = (
        "free the disk or correct the folder's permissions"
        if path.parent.is_dir()
        else f"make the folder {path.parent}"
    )
    return f"expected to write {path}, got: {trouble.strerror or trouble}; {remedy}"
