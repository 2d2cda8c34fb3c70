"""A folder that appears whole or not at all: filled under a temporary name beside it, then moved into place."""

import shutil
from collections.abc import Callable, Iterator
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


def foreign(folder: Path, belongs: Callable[[str], bool]) -> list[str]:
    """What would be lost if the folder were replaced: its files and links whose path within it (with /) does not belong; none where
    nothing is there, its own name where it is a file."""
    if not folder.is_dir():
        return [folder.name] if folder.exists() else []
    files = (
        path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()
    )
    return sorted(file for file in files if not belongs(file))


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
