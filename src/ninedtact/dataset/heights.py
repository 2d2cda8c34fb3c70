"""The skin's heights in a data set's images, on a network's grid: each image read by its own sensor's calibration, once.

    cache/heights-<digest>/train-00000-of-00040.npy …      (n, rows, cols) float16 mm, a file for each Parquet file

The digest is of the data, the grid and the calibrations. Every file appears whole or not at all, so that a
reading that was stopped goes on.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

import numpy as np
from jaxtyping import Float16, Float32, Shaped
from numpy import ndarray as Array

from ninedtact.dataset.columns import rows_of
from ninedtact.dataset.decoded import digest_of, make_folder
from ninedtact.dataset.reader import codes_in, columns_of, ids_of, names_in, require_whole, six_of, words
from ninedtact.dataset.sensor_heights import CalibratedSensor, SensorMissing, read_file
from ninedtact.dataset.sources.table import NO_OBJECT, REFERENCES, pair_files
from ninedtact.dataset.workers import as_done
from ninedtact.force.places import PlaceGrid


@dataclass(frozen=True)
class HeightPairs:
    """Pairs of heights and wrench, in the order of the files."""

    ids: Shaped[Array, " n"]
    z_mm: Float16[Array, "n rows cols"]
    wrenches: Float32[Array, "n 6"]
    """N and N·m about the skin's centre."""
    objects: Shaped[Array, " n"]
    sensors: Shaped[Array, " n"]


def height_pairs(
    folder: Path,
    sensors: Mapping[str, CalibratedSensor],
    grid: PlaceGrid,
    cache: Path | None = None,
    workers: int = 1,
    *,
    left_out: Collection[str] = (),
    progress: bool = False,
) -> HeightPairs:
    """All heights of a data set but those of sensors that are left out, read now where they are not yet.

    Raises `DataSetDamaged`, `SensorMissing`, `FileNotWritten`.
    """
    files = pair_files(folder)
    table = columns_of(files)
    wrenches, names = six_of(table), np.array(words(table, "sensor"))
    require_whole(folder, wrenches, codes_in(names_in(folder / REFERENCES), table["reference"].to_pylist()))
    kept = ~np.isin(names, list(left_out))
    require_sensors(names[kept], sensors)
    cache = folder / "cache" if cache is None else cache
    place = cache / f"heights-{digest(files, cache, sensors, grid)}"
    make_folder(place)
    read_missing(files, place, sensors, grid, workers, progress)
    z_mm = np.concatenate([np.load(path_of(place, file), mmap_mode="r") for file in files])
    objects = np.array([name or NO_OBJECT for name in words(table, "object")])
    return HeightPairs(np.array(ids_of(table))[kept], z_mm[kept], wrenches[kept], objects[kept], names[kept])


def require_sensors(names: Shaped[Array, " n"], sensors: Mapping[str, CalibratedSensor]) -> None:
    """Refuse images that nothing is known about."""
    missing = sorted(set(names.tolist()) - set(sensors))
    if missing:
        raise SensorMissing(
            f"expected the calibration of every sensor, got none of {len(missing)} (such as {missing[0]!r}); give a folder that "
            "holds a sensor folder of each name"
        )


def digest(files: Sequence[Path], cache: Path, sensors: Mapping[str, CalibratedSensor], grid: PlaceGrid) -> str:
    """Of all that heights depend on."""
    calibrations = sorted((name, sensor.digest) for name, sensor in sensors.items())
    data = digest_of([*files, files[0].parents[1] / REFERENCES], cache)
    return blake2b(repr((data, calibrations, grid)).encode(), digest_size=6).hexdigest()


def path_of(place: Path, file: Path) -> Path:
    """Where the heights of a Parquet file are kept."""
    return place / f"{file.stem}.npy"


def read_missing(
    files: Sequence[Path],
    place: Path,
    sensors: Mapping[str, CalibratedSensor],
    grid: PlaceGrid,
    workers: int,
    progress: bool,
) -> None:
    """Read the files that no earlier run read, several at once."""
    from tqdm import tqdm

    missing = [file for file in files if not path_of(place, file).is_file()]
    jobs = [(file, path_of(place, file), those_of(file, sensors), grid) for file in missing]
    with tqdm(total=len(files), initial=len(files) - len(missing), unit="file", disable=not progress) as bar:
        for _ in as_done(read_file, jobs, workers):
            bar.update()


def those_of(file: Path, sensors: Mapping[str, CalibratedSensor]) -> dict[str, CalibratedSensor]:
    """The sensors of one file that are known: a process is sent no others."""
    names = {row["sensor"] or "" for row in rows_of(file, ["sensor"])}
    return {name: sensors[name] for name in names if name in sensors}
