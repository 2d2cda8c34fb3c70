"""Which kind of source a path is."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ninedtact.dataset.rows import writable
from ninedtact.dataset.sources.episodes import SUFFIX as EPISODE
from ninedtact.dataset.sources.episodes import EpisodesSource, SensorReader
from ninedtact.dataset.sources.htt import SUFFIX as ARCHIVE
from ninedtact.dataset.sources.htt import HttSource
from ninedtact.dataset.sources.source import Source, SourceUnknown, Statements
from ninedtact.dataset.sources.table import TableSource
from ninedtact.dataset.sources.tree import TreeSource, tree_in

KINDS = (
    "recordings of 'ninedtact collect' (.mcap), the original project's Dataset folder (image/ or mixed_image/, and wrench/), "
    "force episodes (.npz) or a data set (data/*.parquet)"
)


@dataclass(frozen=True)
class Named:
    """A path and what to call it."""

    name: str
    path: Path


@dataclass(frozen=True)
class Finder:
    """Tells kinds apart."""

    read_sensor: SensorReader
    statements: Statements = Statements()

    def sources(self, words: Sequence[str]) -> list[Source]:
        """The sources that a person named, `NAME=PATH` or `PATH`; raises `SourceUnknown`."""
        if not words:
            raise SourceUnknown(f"expected at least one source, got none; name {KINDS}")
        named = list(told_apart(words))
        return [self.source(it, len(named) > 1) for it in named]

    def source(self, named: Named, several: bool) -> Source:
        """What is at a path; raises `SourceUnknown`."""
        name, path = named.name, named.path
        if not path.exists():
            raise SourceUnknown(f"expected a source at {path}, got nothing there; check the path")
        if tree_in(path):
            return TreeSource(name, path, statements=self.statements)
        if any((path / "data").glob("*.parquet")):
            return TableSource(name, path, several)
        if holds(path, EPISODE):
            return EpisodesSource(name, path, self.read_sensor, statements=self.statements)
        if holds(path, ARCHIVE):
            return HttSource(name, path, statements=self.statements)
        raise SourceUnknown(f"expected {KINDS}, got {path} with none of them; name the folder that holds them")


def holds(path: Path, suffix: str) -> bool:
    """Whether it is such a file, or a folder with some."""
    return path.suffix == suffix if path.is_file() else any(path.rglob(f"*{suffix}"))


def told_apart(words: Sequence[str]) -> Iterator[Named]:
    """Names that are unlike each other; raises `SourceUnknown` where a person gave the same twice."""
    given = [split(word) for word in words]
    twice = [name for name, count in Counter(name for name, _ in given if name).items() if count > 1]
    if twice:
        raise SourceUnknown(f"expected names of sources to differ, got {twice[0]!r} more than once; change one")
    taken = {name for name, _ in given if name}
    for name, path in given:
        own = name or next(free for free in numbered(path.resolve().stem or "source") if free not in taken)
        taken.add(own)
        yield Named(writable(own), path)


def numbered(stem: str) -> Iterator[str]:
    """The stem, stem-2, stem-3, …"""
    yield stem
    number = 2
    while True:
        yield f"{stem}-{number}"
        number += 1


def split(word: str) -> tuple[str, Path]:
    """A name, perhaps none, and a path; raises `SourceUnknown` for a name that no file could have."""
    name, mark, path = word.partition("=")
    if not mark or Path(word).exists():
        return "", Path(word)
    if not name or not path or "/" in name or name.startswith("."):
        raise SourceUnknown(f"expected NAME=PATH with a name without slashes, got {word!r}; correct it")
    return name, Path(path)
