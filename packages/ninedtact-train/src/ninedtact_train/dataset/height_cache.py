"""The skin's heights in the images of a data set on a network's grid, and what physics finds in them, computed once with the
calibration of each sensor.

    cache/heights-<digest>/train-00000-of-00040.npz …      float16, one file for each Parquet file

The digest is that of the data, the grid, the calibrations and the version of ninedtact. Every file appears whole or not at all,
so that a computation that was stopped continues.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import blake2b
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float16, Float32, Shaped
from numpy import ndarray as Array

from ninedtact._version import __version__
from ninedtact.atomic_write import write_file_atomically
from ninedtact.bounds_and_checked_reading import NPY_READ_ERRORS
from ninedtact.design import Gel
from ninedtact.force.network_input import tractions_over_shear_modulus
from ninedtact.force.traction.estimator import TractionForce, build_traction_force
from ninedtact.parallel_jobs import run_jobs
from ninedtact.quantities import NO_OBJECT
from ninedtact.reading import Reading
from ninedtact.shape.orthorectification import SkinGrid, orthorectified_heights
from ninedtact_train.dataset.calibrated_readings import (
    READ_COLUMNS,
    DatasetSensorCalibration,
    RowReadingComputer,
    read_file_references,
    require_calibrations,
)
from ninedtact_train.dataset.folder import REFERENCES_FILE, find_pair_files
from ninedtact_train.dataset.image_cache import digest_files_with_cache, make_cache_folder
from ninedtact_train.dataset.parquet_files import iterate_rows, wrench_array
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
    tractions: Float16[Array, "n 3 rows cols"] | None = None
    """Pressure and shear over the shear modulus that physics finds; None where only heights were asked for."""
    physics: Float32[Array, "n 6"] | None = None
    """The wrench by physics for a gel of the design's shear modulus, N and N·m; zero where it finds no contact."""

    def select(self, chosen: Shaped[Array, " n"]) -> "HeightWrenchPairs":
        """Return the chosen pairs."""
        return replace(self, **{name: part[chosen] for name, part in vars(self).items() if part is not None})


def load_height_pairs(
    folder: Path,
    sensors: Mapping[str, DatasetSensorCalibration],
    grid: SkinGrid,
    cache: Path | None = None,
    workers: int = 1,
    *,
    with_physics: bool = False,
    left_out: Collection[str] = (),
    progress: bool = False,
) -> HeightWrenchPairs:
    """Return all height grids of a data set without those of the sensors that are left out; missing ones are computed now.

    with_physics: whether to compute tractions and wrenches by physics too. Raises `FileFormatError`, `CalibrationError`,
    `FileNotWritten`, `ForceEstimationError`.
    """
    table = read_pair_columns(folder)
    names = read_name_column(table, "sensor")
    kept = ~np.isin(names, list(left_out))
    require_calibrations(set(names[kept].tolist()), sensors)
    files = find_pair_files(folder)
    cache = folder / "cache" if cache is None else cache
    kind = "physics" if with_physics else "heights"
    target = cache / f"{kind}-{_digest_inputs(files, cache, sensors, grid)}"
    make_cache_folder(target)
    cached = _CachedFields(grid, with_physics)
    _compute_missing_files(files, target, cached, sensors, workers, progress)
    if None in (stored := [_read_fields(_cache_file(target, file), cached) for file in files]):
        _compute_missing_files(files, target, cached, sensors, workers, progress)
        stored = [_read_fields(_cache_file(target, file), cached) for file in files]
    whole = [one for one in stored if one is not None]
    fields = {name: np.concatenate([one[name] for one in whole]) for name in whole[0]}
    ids, objects = read_name_column(table, "id"), read_name_column(table, "object", NO_OBJECT)
    return HeightWrenchPairs(ids, wrenches=wrench_array(table), objects=objects, sensors=names, **fields).select(kept)


@dataclass(frozen=True)
class _CachedFields:
    """What is computed of every image."""

    grid: SkinGrid
    with_physics: bool

    def __call__(self, reading: Reading, physics: TractionForce | None) -> dict[str, Array]:
        """Return the fields of `HeightWrenchPairs` of one image."""
        z_mm = orthorectified_heights(reading.height, self.grid).astype(np.float16)
        if physics is None:
            return {"z_mm": z_mm}
        physics.forget()
        estimate = physics.estimate(reading)
        tractions = np.zeros((3, *z_mm.shape), np.float16)
        if estimate.traction is not None:
            tractions[:] = tractions_over_shear_modulus(estimate.traction, physics.gel.shear_modulus_mpa, self.grid)
        return {"z_mm": z_mm, "tractions": tractions, "physics": estimate.wrench.six.astype(np.float32)}

    def empty(self) -> dict[str, Array]:
        """Return the fields of an image whose sensor is left out: zeros."""
        z_mm = np.zeros((self.grid.rows, self.grid.cols), np.float16)
        if not self.with_physics:
            return {"z_mm": z_mm}
        return {"z_mm": z_mm, "tractions": np.stack([z_mm] * 3), "physics": np.zeros(6, np.float32)}

    def physics_of(self, sensor: DatasetSensorCalibration) -> TractionForce | None:
        """Return the estimator by physics of a sensor whose gel has the design's shear modulus, where it is needed."""
        if not self.with_physics:
            return None
        gel = replace(sensor.gel, shear_modulus_mpa=Gel().shear_modulus_mpa)
        return build_traction_force(sensor.shape, gel)


def _digest_inputs(
    files: Sequence[Path], cache: Path, sensors: Mapping[str, DatasetSensorCalibration], grid: SkinGrid
) -> str:
    """Return a digest of everything that the heights depend on."""
    calibrations = sorted((name, sensor.digest) for name, sensor in sensors.items())
    data = digest_files_with_cache([*files, files[0].parents[1] / REFERENCES_FILE], cache)
    return blake2b(repr((__version__, data, calibrations, grid)).encode(), digest_size=6).hexdigest()


def _cache_file(folder: Path, pair_file: Path) -> Path:
    return folder / f"{pair_file.stem}.npz"


def _read_fields(file: Path, fields: _CachedFields) -> dict[str, Array] | None:
    """Return the arrays of one file of the cache; remove a file that is damaged, and return None."""
    try:
        with np.load(file) as stored:
            found = {name: stored[name] for name in stored.files}
    except NPY_READ_ERRORS:
        found = {}
    expected = {name: (part.dtype, part.shape) for name, part in fields.empty().items()}
    if {name: (part.dtype, part.shape[1:]) for name, part in found.items()} == expected:
        return found
    file.unlink(missing_ok=True)
    return None


def _compute_missing_files(
    files: Sequence[Path],
    target: Path,
    fields: _CachedFields,
    sensors: Mapping[str, DatasetSensorCalibration],
    workers: int,
    progress: bool,
) -> None:
    from tqdm import tqdm

    missing = [file for file in files if not _cache_file(target, file).is_file()]
    jobs = [(file, _cache_file(target, file), _select_sensors(file, sensors), fields) for file in missing]
    with tqdm(total=len(files), initial=len(files) - len(missing), unit="file", disable=not progress) as bar:
        for _ in run_jobs(_compute_cache_file, jobs, workers):
            bar.update()


def _select_sensors(file: Path, sensors: Mapping[str, DatasetSensorCalibration]) -> dict[str, DatasetSensorCalibration]:
    """Return the calibrations of the sensors in one file, so that a process receives no others."""
    names = {row["sensor"] or "" for row in iterate_rows(file, ["sensor"])}
    return {name: sensors[name] for name in names if name in sensors}


def _compute_cache_file(
    file: Path, target: Path, sensors: Mapping[str, DatasetSensorCalibration], fields: _CachedFields
) -> None:
    """Write the fields of one Parquet file; they are zero for sensors that are not given.

    Raises `FileFormatError`, `CalibrationError`, `FileNotWritten`, `ForceEstimationError`.
    """
    reader = RowReadingComputer(file, sensors, read_file_references(file))
    physics = {name: fields.physics_of(sensor) for name, sensor in sensors.items()}
    rows = []
    for row in iterate_rows(file, READ_COLUMNS):
        name = row["sensor"] or ""
        rows.append(fields(reader.read(row), physics[name]) if name in sensors else fields.empty())
    content = BytesIO()
    fields_of_file: dict[str, Any] = {name: np.stack([one[name] for one in rows]) for name in rows[0]}
    np.savez(content, **fields_of_file)
    write_file_atomically(target, content.getvalue())
