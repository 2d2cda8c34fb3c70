"""Finds the sources of pairs: arguments PATH or NAME=PATH go in, sources of the right kind with different names come out."""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import chain, count
from pathlib import Path

from ninedtact.errors import InputError
from ninedtact_train.dataset.parquet_files import escape_invalid_utf8
from ninedtact_train.dataset.sources.htt_episodes import EPISODE_SUFFIX, TactileTransformerSource
from ninedtact_train.dataset.sources.original_9dtact import OriginalDatasetSource, find_original_dataset
from ninedtact_train.dataset.sources.own_formats import (
    RECORDING_SUFFIX,
    ExistingDatasetSource,
    RecordingsSource,
)
from ninedtact_train.dataset.sources.source import Source, SourceConventions

_KINDS = (
    "recordings of 'ninedtact collect' (.mcap), the original project's Dataset folder (image/ or mixed_image/, and wrench/), "
    "force episodes (.npz) or a data set (data/*.parquet)"
)


def find_sources(arguments: Sequence[str], conventions: SourceConventions = SourceConventions()) -> list[Source]:
    """Return the sources at these paths, each given as `PATH` or `NAME=PATH`; raises `InputError`."""
    if not arguments:
        raise InputError(expected="at least one source", got="none", remedy=f"name {_KINDS}")
    named = list(_give_different_names(arguments))
    sources = [_open_source(name, path, conventions, several=len(named) > 1) for name, path in named]
    _require_effect(conventions, sources)
    return sources


def _require_effect(conventions: SourceConventions, sources: Sequence[Source]) -> None:
    """Refuse statements that no source needs, because its files say the same; raises `InputError`."""
    kinds = {type(source) for source in sources}
    of_labels = kinds & {OriginalDatasetSource, TactileTransformerSource}
    needed = {
        "--sensor": RecordingsSource in kinds,
        "--reference": OriginalDatasetSource in kinds,
        "--sensor-name": of_labels,
        "--origin-mm": of_labels,
        "--axes": of_labels,
        "--mm-per-px": of_labels,
    }
    useless = [option for option in conventions.stated_options() if not needed[option]]
    if useless:
        raise InputError(
            expected="options that have an effect on these sources",
            got=f"{' and '.join(useless)}",
            remedy="drop what does not apply: recordings and data sets say axes, torque point and scale themselves",
        )


def _open_source(name: str, path: Path, conventions: SourceConventions, several: bool) -> Source:
    if not path.exists():
        raise InputError(expected=f"a source at {path}", got="nothing there", remedy="check the path")
    if find_original_dataset(path):
        return OriginalDatasetSource(name, path, conventions=conventions)
    if any((path / "data").glob("*.parquet")):
        return ExistingDatasetSource(name, path, several)
    if _contains_suffix(path, RECORDING_SUFFIX):
        return RecordingsSource(name, path, conventions=SourceConventions(sensor=conventions.sensor))
    if _contains_suffix(path, EPISODE_SUFFIX):
        return TactileTransformerSource(name, path, conventions=conventions)
    raise InputError(expected=f"{_KINDS}", got=f"{path} with none of them", remedy="name the folder that holds them")


def _contains_suffix(path: Path, suffix: str) -> bool:
    return path.suffix == suffix if path.is_file() else any(path.rglob(f"*{suffix}"))


def _give_different_names(arguments: Sequence[str]) -> Iterator[tuple[str, Path]]:
    """Yield paths with different names; raises `InputError` if one name was given twice."""
    given = [_split_argument(argument) for argument in arguments]
    given_names = [name for name, _ in given if name]
    repeated = [name for name, times in Counter(given_names).items() if times > 1]
    if repeated:
        raise InputError(
            expected="names of sources to differ", got=f"{repeated[0]!r} more than once", remedy="change one"
        )
    taken = set(given_names)
    for name, path in given:
        stem = path.resolve().stem or "source"
        numbered = chain([stem], (f"{stem}-{number}" for number in count(2)))
        own = name or next(free for free in numbered if free not in taken)
        taken.add(own)
        yield escape_invalid_utf8(own), path


def _split_argument(argument: str) -> tuple[str, Path]:
    """Return a name, which may be empty, and a path; raises `InputError` for a name that no file could have."""
    name, mark, path = argument.partition("=")
    if not mark or Path(argument).exists():
        return "", Path(argument)
    if not name or not path or "/" in name or name.startswith("."):
        raise InputError(expected="NAME=PATH with a name without slashes", got=f"{argument!r}", remedy="correct it")
    return name, Path(path)
