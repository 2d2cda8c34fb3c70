"""The folder of a data set: begun once, and known again."""

import json
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from ninedtact.atomic_write import FileNotWritten, write_file_atomically
from ninedtact.dataset.generation.bench import bench
from ninedtact.dataset.generation.deck import object_of
from ninedtact.dataset.generation.pair import png
from ninedtact.dataset.generation.settings import DatasetImpossible, DatasetSettings
from ninedtact.dataset.generation.table import write_references

PROCESSOR = "cpu"
SETTINGS, MEMBERS, REFERENCES = "settings.json", "members/sensors.json", "references.parquet"


def path_of(folder: Path, settings: DatasetSettings, number: int) -> Path:
    """Of one file of pairs."""
    return folder / "data" / f"train-{number:05d}-of-{settings.files:05d}.parquet"


def begin(folder: Path, settings: DatasetSettings, device: str = PROCESSOR) -> None:
    """Make the folder and what all files share, or see that it holds an earlier run of the same job on this kind of device."""
    resolved = resolved_settings(settings, device)
    if (folder / SETTINGS).is_file():
        require_same(folder / SETTINGS, resolved)
    else:
        require_empty(folder)
        require_objects(settings)
        make_folders(folder)
        write_file_atomically(folder / SETTINGS, as_json(resolved))
    clear_halves(folder)
    if not (folder / MEMBERS).is_file():
        sensors = [settings.member(number).as_table() for number in range(settings.sensors)]
        write_file_atomically(folder / MEMBERS, as_json(sensors))
    if not (folder / REFERENCES).is_file():
        write_references(folder / REFERENCES, references(settings))


def require_empty(folder: Path) -> None:
    """Refuse a folder that holds something else; raises `DatasetImpossible`."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise DatasetImpossible(
            f"expected an empty folder or a data set to go on with, got {folder}, which holds something else; give another"
        )


def require_objects(settings: DatasetSettings) -> None:
    """Refuse names that no object has, before work begins; raises `ObjectUnknown`."""
    for name in settings.names:
        object_of(name, settings.objects_seed)


def make_folders(folder: Path) -> None:
    """For pairs and for sensors; raises `FileNotWritten`."""
    try:
        for part in ("data", "members"):
            (folder / part).mkdir(parents=True, exist_ok=True)
    except OSError as trouble:
        raise FileNotWritten(
            f"expected to make the folder {folder}, got: {trouble.strerror or trouble}; correct the path or its permissions"
        ) from trouble


def clear_halves(folder: Path) -> None:
    """Remove what a killed job left half written."""
    for half in folder.rglob(".*.partial"):
        half.unlink(missing_ok=True)


def resolved_settings(settings: DatasetSettings, device: str = PROCESSOR) -> dict[str, Any]:
    """With the version that they belong to, as JSON gives them back; and the kind of device, where it is not the processor."""
    kind = {} if device == PROCESSOR else {"device": device}
    return {"ninedtact": version("ninedtact"), **kind, **json.loads(json.dumps(settings.as_table()))}


def as_json(value: Any) -> bytes:
    """For people and programs."""
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode()


def require_same(kept: Path, resolved: dict[str, Any]) -> None:
    """Refuse to mix two data sets in one folder; raises `DatasetImpossible`."""
    try:
        found = json.loads(kept.read_text())
    except ValueError:
        found = {}
    found, resolved = {"device": PROCESSOR, **found}, {"device": PROCESSOR, **resolved}
    differing = sorted(name for name in {*found, *resolved} if found.get(name) != resolved.get(name))
    if differing:
        name = differing[0]
        raise DatasetImpossible(
            f"expected the settings that {kept.parent} was begun with, got another {', '.join(differing)} ({name}: "
            f"{resolved.get(name)} instead of {found.get(name)}); give the same settings to go on, or another folder"
        )


def references(settings: DatasetSettings) -> Iterator[tuple[str, bytes]]:
    """The untouched image of every sensor, as taken when it was switched on."""
    for number in range(settings.sensors):
        sensor, rng = bench(number, settings), np.random.default_rng([settings.seed, 3, number])
        yield sensor.member.name, png(sensor.eye.image(None, rng))
