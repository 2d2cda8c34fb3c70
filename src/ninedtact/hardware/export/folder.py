"""A folder that appears whole or not at all; an older one of its kind is replaced."""

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex

from ninedtact.errors import NinedtactError

MANIFEST = "manifest.json"


class FolderRefused(NinedtactError):
    """Something else is where the parts should go."""


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """A folder to fill, which takes the place of `out` when the block ends well; raises `FolderRefused`."""
    require_replaceable(out)
    out.parent.mkdir(parents=True, exist_ok=True)
    partial = out.with_name(f".{out.name}.{token_hex(4)}.partial")
    partial.mkdir()
    try:
        yield partial
        swap(partial, out)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


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


def require_replaceable(out: Path) -> None:
    """Only nothing, an empty folder, or parts exported before are replaced."""
    if out.is_dir() and (not any(out.iterdir()) or (out / MANIFEST).is_file()):
        return
    if out.exists():
        raise FolderRefused(
            f"expected --out to be new, empty or written by this command, got {out} with other content; choose another name"
        )
