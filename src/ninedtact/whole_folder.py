"""A folder that appears whole or not at all: filled under a temporary name beside it, then moved into place."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex


@contextmanager
def whole_folder(final: Path) -> Iterator[Path]:
    """A folder to fill, which takes the place of `final` when the block ends well; whoever asks has made sure that it may."""
    final.parent.mkdir(parents=True, exist_ok=True)
    partial = final.with_name(f".{final.name}.{token_hex(4)}.partial")
    partial.mkdir()
    try:
        yield partial
        swap(partial, final)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def is_free(folder: Path, mark: str) -> bool:
    """Whether nothing would be lost: nothing is there, an empty folder, or one of the kind that holds a file of this name."""
    return not folder.exists() or (folder.is_dir() and (not any(folder.iterdir()) or (folder / mark).is_file()))


def swap(partial: Path, final: Path) -> None:
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
