"""The skin's heights in the images of a data set on a network's grid, computed once with each sensor's calibration.

    cache/heights-<digest>/train-00000-of-00040.npy …      (n, rows, cols) float16 mm, one file for each Parquet file

The digest is that of the data, the grid and the calibrations. Every file appears whole or not at all, so that a computation that
was stopped continues.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float16, Float32, Shaped
from numpy import ndarray as Array

from ninedtact.atomic_write import write_file_atomically
from ninedtact.dataset.calibrated_readings import (
    READ_COLUMNS,
    CalibratedSensor,
    FileDepthReader,
    SensorCalibrationMissing,
    read_file_references,
)
from ninedtact.dataset.folder import REFERENCES_FILE, find_pair_files
from ninedtact.dataset.image_cache import digest_files, make_cache_folder
from ninedtact.dataset.parquet_files import iterate_rows, wrench_array
from ninedtact.dataset.reader import read_name_column, read_pair_columns
from ninedtact.dataset.schema import NO_OBJECT
from ninedtact.parallel_jobs import run_jobs
from ninedtact.shape.orthorectification import SkinGrid, orthorectified_heights


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
    sensors: Mapping[str, CalibratedSensor],
    grid: SkinGrid,
    cache: Path | None = None,
    workers: int = 1,
    *,
    left_out: Collection[str] = (),
    progress: bool = False,
) -> HeightWrenchPairs:
    """Return all height grids of a data set without those of the sensors that are left out; missing ones are computed now.

    Raises `DatasetDamaged`, `SensorCalibrationMissing`, `FileNotWritten`.
    """
    table = read_pair_columns(folder)
    names = np.array(read_name_column(table, "sensor"))
    kept = ~np.isin(names, list(left_out))
    _require_calibrations(names[kept], sensors)
    files = find_pair_files(folder)
    cache = folder / "cache" if cache is None else cache
    target = cache / f"heights-{_digest_inputs(files, cache, sensors, grid)}"
    make_cache_folder(target)
    _compute_missing_files(files, target, sensors, grid, workers, progress)
    z_mm = np.concatenate([np.load(_height_file(target, file), mmap_mode="r") for file in files])
    ids, objects = np.array(table["id"].to_pylist()), np.array(read_name_column(table, "object", NO_OBJECT))
    return HeightWrenchPairs(ids[kept], z_mm[kept], wrench_array(table)[kept], objects[kept], names[kept])


def _require_calibrations(names: Shaped[Array, " n"], sensors: Mapping[str, CalibratedSensor]) -> None:
    """Refuse images of sensors without calibration."""
    if missing := sorted(set(names.tolist()) - set(sensors)):
        raise SensorCalibrationMissing(
            f"expected the calibration of every sensor, got none of {len(missing)} (such as {missing[0]!r}); give a folder that "
            "holds a sensor folder of each name"
        )


def _digest_inputs(files: Sequence[Path], cache: Path, sensors: Mapping[str, CalibratedSensor], grid: SkinGrid) -> str:
    """Return a digest of everything that the heights depend on."""
    calibrations = sorted((name, sensor.digest) for name, sensor in sensors.items())
    data = digest_files([*files, files[0].parents[1] / REFERENCES_FILE], cache)
    return blake2b(repr((data, calibrations, grid)).encode(), digest_size=6).hexdigest()


def _height_file(folder: Path, pair_file: Path) -> Path:
    return folder / f"{pair_file.stem}.npy"


def _compute_missing_files(
    files: Sequence[Path],
    target: Path,
    sensors: Mapping[str, CalibratedSensor],
    grid: SkinGrid,
    workers: int,
    progress: bool,
) -> None:
    """Compute the files that no earlier run computed, in several processes."""
    from tqdm import tqdm

    missing = [file for file in files if not _height_file(target, file).is_file()]
    jobs = [(file, _height_file(target, file), _select_sensors(file, sensors), grid) for file in missing]
    with tqdm(total=len(files), initial=len(files) - len(missing), unit="file", disable=not progress) as bar:
        for _ in run_jobs(_compute_height_file, jobs, workers):
            bar.update()


def _select_sensors(file: Path, sensors: Mapping[str, CalibratedSensor]) -> dict[str, CalibratedSensor]:
    """Return the calibrations of the sensors in one file, so that a process receives no others."""
    names = {row["sensor"] or "" for row in iterate_rows(file, ["sensor"])}
    return {name: sensors[name] for name in names if name in sensors}


def _compute_height_file(file: Path, target: Path, sensors: Mapping[str, CalibratedSensor], grid: SkinGrid) -> None:
    """Write the heights of one Parquet file; they are zero for sensors that are not given.

    Raises `DatasetDamaged`, `SensorCalibrationMissing`, `FileNotWritten`.
    """
    reader = FileDepthReader(file, sensors, read_file_references(file))
    rows = list(iterate_rows(file, READ_COLUMNS))
    z_mm = np.zeros((len(rows), grid.rows, grid.cols), np.float16)
    for number, row in enumerate(rows):
        if (row["sensor"] or "") in sensors:
            z_mm[number] = orthorectified_heights(reader.read(row).height, grid)
    content = BytesIO()
    np.save(content, z_mm)
    write_file_atomically(target, content.getbuffer())
