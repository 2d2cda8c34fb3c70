"""The folder of a sensor's parts: it appears whole or not at all, and replaces nothing but an older one of its kind."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ninedtact.errors import NinedtactError
from ninedtact.whole_folder import is_free, whole_folder

MANIFEST = "manifest.json"


class FolderRefused(NinedtactError):
    """Something else is where the parts should go."""


@contextmanager
def new_parts_folder(out: Path) -> Iterator[Path]:
    """A folder to fill, which takes the place of `out` when the block ends well; raises `FolderRefused`."""
    require_replaceable(out)
    with whole_folder(out) as partial:
        yield partial


def require_replaceable(out: Path) -> None:
    """Only nothing, an empty folder, or parts exported before are replaced; raises `FolderRefused`."""
    if not is_free(out, MANIFEST):
        raise FolderRefused(
            f"expected --out to be new, empty or written by this command, got {out} with other content; choose another name"
        )
