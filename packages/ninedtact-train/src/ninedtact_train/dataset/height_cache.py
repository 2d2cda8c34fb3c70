"""The skin's heights in the images of a data set on a network's grid, computed once with the calibration of each sensor.

    cache/heights-<digest>/train-00000-of-00040.npy …      float16, one file for each Parquet file

The digest is that of the data, the grid, the calibrations and the version of ninedtact. Every file appears whole or not at all,
so that a computation that was stopped continues.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float16, Float32, Shaped
from numpy import ndarray as Array

from ninedtact._version import __version__
from ninedtact.atomic_write import write_file_atomically
from ninedtact.checked_reading import NPY_READ_ERRORS
from ninedtact.parallel_jobs import run_jobs
from ninedtact.quantities import NO_OBJECT
from ninedtact.shape.orthorectification import SkinGrid, orthorectified_heights
from ninedtact_train.dataset.calibrated_readings import (
    DatasetSensorCalibration,
    iterate_rows_with_references,
    require_calibrations,
)
from ninedtact_train.dataset.folder import REFERENCES_FILE, find_pair_files
from ninedtact_train.dataset.image_cache import digest_files_with_cache, make_cache_folder
from ninedtact_train.dataset.parquet_files import read_columns, wrench_array
from ninedtact_train.dataset.reader import read_name_column, read_pair_columns


@dataclass(frozen=True)
class HeightWrenchPairs:
    """Pairs of height grid and wrench, in the order of the files."""

    ids: Shaped[Array, " n"]
    z_mm: Float16[Array, "n rows cols"]
    """Heights in mm, negative where the skin is pressed in."""
    wrenches: Float32[Array, "n 6"]
    """Wrenches, N and N·m about the skin's centre."""
    objects: Shaped[Array, " n"]
    sensors: Shaped[Array, " n"]


def load_height_pairs(
    folder: Path,
    sensors: Mapping[str, DatasetSensorCalibration],
    grid: SkinGrid,
    cache: Path | None = None,
    workers: int = 1,
    *,
    left_out: Collection[str] = (),
    progress: bool = False,
) -> HeightWrenchPairs:
    """Return all height grids of a data set without those of the sensors that are left out; missing ones are computed now.

    Raises `FileFormatError`, `CalibrationError`, `FileNotWritten`.
    """
    table = read_pair_columns(folder)
    names = read_name_column(table, "sensor")
    kept = ~np.isin(names, list(left_out))
    require_calibrations(set(names[kept].tolist()), sensors)
    files = find_pair_files(folder)
    cache = folder / "cache" if cache is None else cache
    target = cache / f"heights-{_digest_inputs(files, cache, sensors, grid)}"
    make_cache_folder(target)
    _compute_missing_files(files, target, grid, sensors, workers, progress)
    stored = [_read_heights(_cache_file(target, file), grid) for file in files]
    if any(one is None for one in stored):
        _compute_missing_files(files, target, grid, sensors, workers, progress)
        stored = [_read_heights(_cache_file(target, file), grid) for file in files]
    z_mm = np.concatenate([one for one in stored if one is not None])
    ids, objects = read_name_column(table, "id"), read_name_column(table, "object", NO_OBJECT)
    return HeightWrenchPairs(ids[kept], z_mm[kept], wrench_array(table)[kept], objects[kept], names[kept])


def _digest_inputs(
    files: Sequence[Path], cache: Path, sensors: Mapping[str, DatasetSensorCalibration], grid: SkinGrid
) -> str:
    calibrations = sorted((name, sensor.digest) for name, sensor in sensors.items())
    data = digest_files_with_cache([*files, files[0].parents[1] / REFERENCES_FILE], cache)
    return blake2b(repr((__version__, data, calibrations, grid)).encode(), digest_size=6).hexdigest()


def _cache_file(folder: Path, pair_file: Path) -> Path:
    return folder / f"{pair_file.stem}.npy"


def _read_heights(file: Path, grid: SkinGrid) -> Float16[Array, "n rows cols"] | None:
    """Return the heights in one file of the cache; remove a file that is damaged, and return None."""
    try:
        found = np.load(file)
    except NPY_READ_ERRORS:
        found = None
    if isinstance(found, Array) and found.dtype == np.float16 and found.shape[1:] == (grid.rows, grid.cols):
        return found
    file.unlink(missing_ok=True)
    return None


def _compute_missing_files(
    files: Sequence[Path],
    target: Path,
    grid: SkinGrid,
    sensors: Mapping[str, DatasetSensorCalibration],
    workers: int,
    progress: bool,
) -> None:
    from tqdm import tqdm

    missing = [file for file in files if not _cache_file(target, file).is_file()]
    jobs = []
    for file in missing:
        own = {name: sensors[name] for name in set(_read_sensor_names(file).tolist()) & sensors.keys()}
        jobs.append((file, _cache_file(target, file), own, grid))  # a process receives no other calibrations
    with tqdm(total=len(files), initial=len(files) - len(missing), unit="file", disable=not progress) as bar:
        for _ in run_jobs(_compute_cache_file, jobs, workers):
            bar.update()


def _read_sensor_names(file: Path) -> Shaped[Array, " n"]:
    return read_name_column(read_columns([file], ["sensor"]), "sensor")


def _compute_cache_file(
    file: Path, target: Path, sensors: Mapping[str, DatasetSensorCalibration], grid: SkinGrid
) -> None:
    """Write the heights of one Parquet file; they are zero for sensors that are not given.

    Raises `FileFormatError`, `CalibrationError`, `FileNotWritten`.
    """
    names = _read_sensor_names(file)
    is_known = np.isin(names, list(sensors))
    heights = np.zeros((len(names), grid.rows, grid.cols), np.float16)
    groups = iterate_rows_with_references([file], left_out=set(names[~is_known].tolist()))
    pairs = (pair for group in groups for pair in group.readings(sensors))
    for row, pair in zip(np.flatnonzero(is_known), pairs, strict=True):
        heights[row] = orthorectified_heights(pair.reading.height, grid)
    content = BytesIO()
    np.save(content, heights)
    write_file_atomically(target, content.getvalue())
