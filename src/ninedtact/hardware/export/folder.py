"""The folder of a sensor's parts: it appears whole or not at all, and replaces nothing but an older one of its kind."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ninedtact.atomic_write import create_folder_atomically, list_foreign_files
from ninedtact.errors import NinedtactError

MANIFEST = "manifest.json"


class FolderRefused(NinedtactError):
    """Something else is where the parts should go."""


@contextmanager
def new_parts_folder(out: Path) -> Iterator[Path]:
    """A folder to fill, which takes the place of `out` when the block ends well; raises `FolderRefused`."""
    require_replaceable(out)
    with create_folder_atomically(out) as partial:
        yield partial


def require_replaceable(out: Path) -> None:
    """Only nothing, an empty folder, or parts exported before and nothing else are replaced; raises `FolderRefused`."""
    ours = exported(out / MANIFEST)
    if strange := list_foreign_files(out, ours.__contains__):
        raise FolderRefused(
            f"expected --out to be new, empty or written by this command, got {out} with other content ({strange[0]}); move that "
            "away, or choose another name"
        )


def exported(manifest: Path) -> frozenset[str]:
    """The files that an earlier export lists; none where this is no manifest of ours."""
    try:
        told = json.loads(manifest.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return frozenset()
    listed = told.get("files") if isinstance(told, dict) and "variant" in told else None
    return frozenset(map(str, listed)) if isinstance(listed, list) else frozenset()
