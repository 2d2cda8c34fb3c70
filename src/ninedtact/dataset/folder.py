"""The folder of a data set that is being built: begun once, and known again.

`settings.json` comes first, `parts/` holds what was made so far, `README.md` comes last: where it is, the data set is finished.
"""

import json
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ninedtact.atomic_write import FileNotWritten, write_file_atomically
from ninedtact.dataset.generation.folder import as_json, clear_halves
from ninedtact.dataset.generation.job import CARD
from ninedtact.dataset.report import REPORT
from ninedtact.dataset.sources.source import Source
from ninedtact.dataset.sources.table import REFERENCES, SETTINGS
from ninedtact.errors import NinedtactError


class FolderTaken(NinedtactError):
    """A folder that holds something else, or a data set of other sources."""


@dataclass(frozen=True)
class BuildFolder:
    """Where things are in it."""

    path: Path

    @property
    def settings(self) -> Path:
        """What was asked for."""
        return self.path / SETTINGS

    @property
    def card(self) -> Path:
        """What a person reads."""
        return self.path / CARD

    @property
    def report(self) -> Path:
        """What the checks found."""
        return self.path / REPORT

    @property
    def references(self) -> Path:
        """The untouched images."""
        return self.path / REFERENCES

    @property
    def parts(self) -> Path:
        """What was made so far."""
        return self.path / "parts"

    def pairs(self, number: int, of: int) -> Path:
        """One file of pairs."""
        return self.path / "data" / f"train-{number:05d}-of-{of:05d}.parquet"

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return self.card.is_file()


def begin(folder: BuildFolder, wanted: dict[str, Any], sources: Iterable[Source]) -> None:
    """Make the folder, or see that it holds an earlier run of the same; raises `FolderTaken`, `FileNotWritten`."""
    resolved = {"ninedtact": version("ninedtact"), **json.loads(json.dumps(wanted))}
    if folder.settings.is_file():
        require_same(folder.settings, resolved)
    else:
        require_empty(folder.path, sources)
        make_folders(folder)
        write_file_atomically(folder.settings, as_json(resolved))
    clear_halves(folder.path)
    if not folder.finished:
        make_folders(folder)


def require_empty(path: Path, sources: Iterable[Source]) -> None:
    """Refuse a folder that holds something, or that lies in a source."""
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise FolderTaken(
            f"expected an empty folder or a data set to go on with, got {path}, which holds something else; give another"
        )
    for source in sources:
        if source.path.is_dir() and path.resolve().is_relative_to(source.path.resolve()):
            raise FolderTaken(f"expected a folder outside of the sources, got {path} in {source.path}; give another")


def require_same(kept: Path, resolved: dict[str, Any]) -> None:
    """Refuse to mix two data sets in one folder."""
    try:
        found = json.loads(kept.read_text())
    except (OSError, ValueError):
        found = {}
    differing = sorted(name for name in {*found, *resolved} if found.get(name) != resolved.get(name))
    if differing:
        name = differing[0]
        raise FolderTaken(
            f"expected what {kept.parent} was begun with, got another {', '.join(differing)} ({name}: {resolved.get(name)} "
            f"instead of {found.get(name)}); name the same sources and options to go on, or another folder"
        )


def make_folders(folder: BuildFolder) -> None:
    """For pairs and for parts; raises `FileNotWritten`."""
    try:
        for path in (folder.path / "data", folder.parts):
            path.mkdir(parents=True, exist_ok=True)
    except OSError as trouble:
        raise FileNotWritten(
            f"expected to make the folder {folder.path}, got: {trouble.strerror or trouble}; correct the path or its permissions"
        ) from trouble


def remove_parts(folder: BuildFolder) -> None:
    """What was needed until now."""
    shutil.rmtree(folder.parts, ignore_errors=True)
