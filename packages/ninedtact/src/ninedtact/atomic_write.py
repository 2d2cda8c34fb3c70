"""Files are written whole or not at all: a temporary name in the same folder, then a rename over the final one.

A folder that appears whole or not at all: filled under a temporary name beside it, then moved into place.
"""

import errno
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from tempfile import TemporaryDirectory
from typing import BinaryIO

from ninedtact.errors import OutputError


class FileNotWritten(OutputError):
    """The disk is full, the folder is missing or closed to us; what was at the path before is still there."""


def write_file_atomically(path: Path | str, *content: bytes | memoryview) -> None:
    """Write the parts of `content` one after the other; raises `FileNotWritten`."""
    with open_atomic_file(path) as file:
        for part in content:
            file.write(part)


@contextmanager
def open_atomic_file(path: Path | str) -> Iterator[BinaryIO]:
    """Open a file that appears at `path` when the block ends well; if the block raises, nothing is left of it.

    Not synced to the disk: this guards against a full disk and a stopped program, not against a power cut.
    Where `path` is a link, the file takes the place of the one that the link names. An `OSError` in the block becomes
    `FileNotWritten`, which is also raised for a device or a pipe; everything else passes through.
    """
    final = _follow_link(Path(path))
    if final.exists() and not (final.is_file() or final.is_dir()):
        raise FileNotWritten(
            expected="to write a file", got=f"{path}, which is a device or a pipe", remedy="name a file"
        )
    # A name of our own instead of tempfile's, whose files nobody else may read, also after the rename.
    partial = final.with_name(f".{token_hex(6)}.partial")
    try:
        with partial.open("xb") as file:
            yield file
        partial.replace(final)
    except OSError as trouble:
        partial.unlink(missing_ok=True)
        raise FileNotWritten(_write_failure_message(final, trouble)) from trouble
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def require_new_file(path: Path | None, option: str = "--out") -> None:
    """Refuse a file that would replace one or could not be written, before long work for it begins; None: nobody asked for one.

    Raises `OutputError`, `FileNotWritten`.
    """
    if path is None:
        return
    if path.is_file():
        raise OutputError(expected=f"{option} to be a new file", got=str(path), remedy="choose another name")
    require_place_for_file(path)


def require_place_for_file(path: Path) -> None:
    """Refuse a file that could not be written in the end, before long work for it begins; raises `FileNotWritten`."""
    is_taken = path.exists() and not path.is_file()
    if is_taken or not os.access(path.parent, os.W_OK):
        with open_atomic_file(path):  # refuses it in its own words
            pass


def _follow_link(path: Path) -> Path:
    """Return what a link names, also where that is not there yet; any other path as it is."""
    if not path.is_symlink():
        return path
    return Path(os.path.realpath(path))  # `Path.resolve` would raise for a link to itself


def is_partial_file(path: Path) -> bool:
    """Return whether a file is one that `open_atomic_file` has begun and not finished."""
    return path.name.startswith(".") and path.name.endswith(".partial")


def _write_failure_message(path: Path, trouble: OSError) -> str:
    """Say what stood in the way of writing `path`."""
    remedy = f"make the folder {path.parent}"
    if path.parent.is_dir() and trouble.errno == errno.ENOENT:  # a file system of the kernel, such as /proc
        remedy = "choose another folder"
    elif path.parent.is_dir():
        remedy = "free the disk or correct the folder's permissions"
    elif path.parent.exists():
        remedy = f"{path.parent} is no folder, so choose another name"
    return f"expected to write {path}, got: {trouble.strerror or trouble}; {remedy}"


def refuse_working_directory(final: Path) -> None:
    """Refuse to replace the working directory, or a folder above it, which would move it away; raises `FileNotWritten`.

    A working directory that has been deleted is none, and nothing can be written into it.
    """
    try:
        here = Path.cwd()
    except FileNotFoundError as gone:
        if final.is_absolute():
            return
        raise FileNotWritten(
            expected=f"to write {final} into the working directory",
            got="one that has been deleted",
            remedy="change to another folder",
        ) from gone
    if here.is_relative_to(final.resolve()):
        raise FileNotWritten(
            expected="a folder that can be replaced as a whole",
            got=f"{final}, in which this program runs",
            remedy="run it from another folder, or give another name",
        )


@contextmanager
def create_folder_atomically(final: Path) -> Iterator[Path]:
    """A folder to fill, which takes the place of `final` when the block ends well; whoever asks has made sure that it may.

    Where `final` is a link, the folder takes the place of the one that the link names. Raises `FileNotWritten` for the working
    directory and the folders above it.
    """
    refuse_working_directory(final)
    final = _follow_link(final)
    partial = final.with_name(f".{final.name}.{token_hex(4)}.partial")
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        partial.mkdir()
    except OSError as trouble:
        raise FileNotWritten(_write_failure_message(final, trouble)) from trouble
    try:
        yield partial
        _replace_folder(partial, final)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def write_files_atomically(folder: Path, files: Iterable[tuple[str, bytes]]) -> None:
    """Write files so that each entry of the folder appears whole or not at all, one after the other.

    files: their paths in the folder and their contents. An entry is a file, or a folder with its files; they appear in the order
    of their names. Raises `FileNotWritten`, `OSError`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder, prefix=".", suffix=".partial") as name:
        staging = Path(name)
        for path, content in files:
            (staging / path).parent.mkdir(parents=True, exist_ok=True)
            write_file_atomically(staging / path, content)
        for entry in sorted(staging.iterdir()):
            entry.replace(folder / entry.name)


def list_foreign_files(folder: Path, belongs: Callable[[str], bool]) -> list[str]:
    """What would be lost if the folder were replaced: its files and links whose path within it (with /) does not belong; none where
    nothing is there, its own name where it is a file."""
    if not folder.is_dir():
        return [folder.name] if folder.exists() else []
    files = (
        path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()
    )
    return sorted(file for file in files if not belongs(file))


def _replace_folder(partial: Path, final: Path) -> None:
    """Move the finished folder into place; what was there is removed only then."""
    if not final.exists():
        partial.rename(final)
        return
    previous = partial.with_suffix(".previous")
    final.rename(previous)
    try:
        partial.rename(final)
    except BaseException:
        previous.rename(final)
        raise
    shutil.rmtree(previous, ignore_errors=True)
