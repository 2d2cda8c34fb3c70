"""The folder of a data set: paths of its files, how it is begun, and how a stopped build or generation is recognised.

settings.json        what the data set is made from; written first
data/                files of pairs
references.parquet   reference images (no contact)
sensors.json         all parameters of simulated sensors, in a generated data set or one that was built from such
sensors/             sensor folders by the names of the sensors: carried by recordings, or calibrated for simulated sensors
report.json          what the checks found, in a built data set
README.md            the card; written last: where it exists, the data set is finished
"""

import json
import re
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ninedtact.atomic_write import FileNotWritten, is_partial_file, write_file_atomically
from ninedtact.calibration.sensor_folder import SENSOR_FILE
from ninedtact.checked_reading import CHECKSUM_KEY, mapping_checksum, read_json_object, read_text_file
from ninedtact.errors import DatasetError, FileFormatError, OutputError
from ninedtact_train.dataset.parquet_files import require_pair_columns
from ninedtact_train.dataset.schema import DATASET_FORMAT

REFERENCES_FILE, SETTINGS_FILE, SENSORS_FILE = "references.parquet", "settings.json", "sensors.json"
REPORT_FILE, CARD_FILE, SENSOR_FOLDERS = "report.json", "README.md", "sensors"
_FILE_COUNT = re.compile(r"-of-(\d+)\.parquet$")


def pair_file(folder: Path, number: int, count: int) -> Path:
    """Return the path of one of this many files of pairs."""
    return folder / "data" / f"train-{number:05d}-of-{count:05d}.parquet"


def find_pair_files(folder: Path) -> list[Path]:
    """Return all files of pairs of a data set in order.

    Raises `FileFormatError`, also if files are missing.
    """
    files = sorted(path for path in (folder / "data").glob("*.parquet") if not path.name.startswith("."))
    if not files:
        raise FileFormatError(
            expected="a data set",
            got=f"{folder} without Parquet files in {folder / 'data'}",
            remedy="give the folder that 'ninedtact dataset build' or 'ninedtact simulate dataset' made",
        )
    numbered = _FILE_COUNT.search(files[-1].name)
    if numbered and int(numbered[1]) != len(files):
        raise FileFormatError(
            expected=f"{int(numbered[1])} files in {folder / 'data'}",
            got=f"{len(files)}",
            remedy="finish it with the command that began it",
        )
    if not (folder / REFERENCES_FILE).is_file():
        raise FileFormatError(
            expected=f"{folder / REFERENCES_FILE}",
            got="no such file",
            remedy="finish the data set with the command that began it",
        )
    for file in files:
        require_pair_columns(file)
    return files


def begin_or_resume_dataset(folder: Path, settings: Mapping[str, Any], source_paths: Iterable[Path] = ()) -> None:
    """Make the folder of a new data set, or check that it was begun with the same settings.

    The version of the program and of the format belong to the settings. Half-written files of a stopped run are removed.
    Raises `OutputError`, also for a folder inside one of the sources, and `FileNotWritten`.
    """
    for source in source_paths:
        if source.is_dir() and folder.resolve().is_relative_to(source.resolve()):
            raise OutputError(
                expected="a folder outside of the sources", got=f"{folder} in {source}", remedy="give another"
            )
    begin_or_resume_folder(folder, {"ninedtact": version("ninedtact"), "format": DATASET_FORMAT, **settings})
    for half_written in [*folder.rglob(".*.partial")]:
        if half_written.is_dir():
            shutil.rmtree(half_written, ignore_errors=True)
        else:
            half_written.unlink(missing_ok=True)
    make_folder(folder / "data")


def begin_or_resume_folder(path: Path, settings: Mapping[str, Any]) -> None:
    """Make the folder of long work, with its settings, or check that it was begun with the same ones.

    The processes of one work may call it at once: each of them writes the same settings, or finds them. Raises `OutputError`,
    `FileNotWritten`.
    """
    kept, wanted = path / SETTINGS_FILE, json.loads(json.dumps(settings))
    # The order matters: whatever another process of this work has added was added after its settings.
    holds_something = path.exists() and (not path.is_dir() or any(not is_partial_file(file) for file in path.iterdir()))
    if kept.is_file():
        _require_same_settings(kept, wanted)
        return
    if holds_something:
        raise OutputError(
            expected="an empty folder or work to continue",
            got=f"{path}, which holds something else",
            remedy="give another folder",
        )
    make_folder(path)
    write_file_atomically(kept, to_json_bytes({**wanted, CHECKSUM_KEY: mapping_checksum(wanted)}))


@contextmanager
def interrupt_as_stopped(path: Path) -> Iterator[None]:
    """Raise `DatasetError` at Ctrl-C while long work goes on in a folder, with how to continue it."""
    try:
        yield
    except KeyboardInterrupt:
        raise DatasetError(
            f"stopped by Ctrl-C; every file in {path} is whole; run the command again to continue where it stopped"
        ) from None


def read_dataset_settings(folder: Path) -> dict[str, Any]:
    """Return the settings of a data set, none where it states none; raises `FileFormatError` where they were changed."""
    path = folder / SETTINGS_FILE
    if not path.exists():
        return {}
    try:
        found = read_json_object(path)
        if found.get(CHECKSUM_KEY) not in (None, mapping_checksum(found)):
            raise ValueError("other settings than its checksum")
        return found
    except (OSError, ValueError) as trouble:
        raise FileFormatError(
            f"expected {path} as it was written, got: {trouble}; copy the whole data set again"
        ) from trouble


def find_sensor_folders(folder: Path) -> list[Path]:
    """Return the sensor folders in a folder, without those that a killed process left half written."""
    return sorted(file.parent for file in folder.glob(f"*/{SENSOR_FILE}") if not file.parent.name.startswith("."))


def read_sensor_parameters(folder: Path) -> list[dict[str, Any]]:
    """Return all parameters of a data set's simulated sensors as they are stored, none where it has none.

    Raises `FileFormatError`, also where they were changed.
    """
    path = folder / SENSORS_FILE
    if not path.exists() and "objects_seed" not in read_dataset_settings(folder):
        return []
    try:
        tables = json.loads(read_text_file(path))
        by_name = {table["name"]: table for table in tables}
        for name, table in by_name.items():
            if table.get(CHECKSUM_KEY) not in (None, mapping_checksum(table)):
                raise ValueError(f"other parameters of {name} than its checksum")
        return list(by_name.values())
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as trouble:
        raise sensor_parameters_damage(folder, trouble) from trouble


def sensor_parameters_damage(folder: Path, trouble: Exception) -> FileFormatError:
    """Return the error for parameters of simulated sensors that cannot be read."""
    return FileFormatError(
        f"expected the simulated sensors in {folder / SENSORS_FILE} as they were written, got: {trouble}; copy the whole data set "
        "again"
    )


def make_folder(path: Path, advice: str = "correct the path or its permissions") -> None:
    """Make a folder with its parents; raises `FileNotWritten`."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        reason = error.strerror or error
        raise FileNotWritten(f"expected to make the folder {path}, got: {reason}; {advice}") from error


def to_json_bytes(value: Any) -> bytes:
    """Return a value as JSON for people and programs."""
    return (json.dumps(value, indent=1, ensure_ascii=False) + "\n").encode()


def _require_same_settings(kept: Path, resolved: dict[str, Any]) -> None:
    try:
        found = read_json_object(kept)
    except (OSError, ValueError):
        found = {}
    names = {*found, *resolved} - {CHECKSUM_KEY}
    if differing := sorted(name for name in names if found.get(name) != resolved.get(name)):
        name = differing[0]
        raise OutputError(
            expected=f"what {kept.parent} was begun with",
            got=f"another {', '.join(differing)} ({name}: {resolved.get(name)} instead of {found.get(name)})",
            remedy="give the same data and options to continue, or another folder",
        )
