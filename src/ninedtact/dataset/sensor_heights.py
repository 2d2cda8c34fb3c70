"""One file of a data set: its images as heights, each read by its own sensor's calibration."""

from collections.abc import Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.dataset.columns import DataSetDamaged, bytes_of, rows_of
from ninedtact.dataset.rows import NotAImage, decoded
from ninedtact.dataset.sources.table import REFERENCES, TWINS_WIDTH_MM
from ninedtact.design import Gel
from ninedtact.errors import NinedtactError
from ninedtact.force.places import PlaceGrid, heights_at_places
from ninedtact.quantities import Rectified
from ninedtact.shape.calibrated import CalibratedShape
from ninedtact.shape.depth import DepthReader

COLUMNS = ("image", "reference", "sensor", "mm_per_px")


class SensorMissing(NinedtactError):
    """Images of a sensor that nobody gave the calibration of, or of another size."""


@dataclass(frozen=True)
class CalibratedSensor:
    """What heights are read by."""

    shape: CalibratedShape
    gel: Gel
    digest: str
    """Unlike that of any other calibration."""


def read_file(file: Path, target: Path, sensors: Mapping[str, CalibratedSensor], grid: PlaceGrid) -> None:
    """Heights of one Parquet file, zero for sensors that are not given.

    Raises `DataSetDamaged`, `SensorMissing`, `FileNotWritten`.
    """
    untouched = untouched_of(file)
    readers: dict[tuple[str, str], DepthReader] = {}
    rows = list(rows_of(file, COLUMNS))
    found = np.zeros((len(rows), grid.rows, grid.cols), np.float16)
    for number, row in enumerate(rows):
        key = row["sensor"] or "", row["reference"]
        if key[0] not in sensors:
            continue
        image = grey(row, file)
        if key not in readers:
            readers[key] = reader_for(sensors[key[0]], grey({**row, "image": untouched[key[1]]}, file), key[0])
        if image.grey.shape != readers[key].reference.grey.shape:
            raise other_size(key[0], image, readers[key].reference)
        found[number] = heights_at_places(readers[key](image), grid)
    content = BytesIO()
    np.save(content, found)
    write_file_atomically(target, content.getbuffer())


def untouched_of(file: Path) -> dict[str, object]:
    """The untouched images that a file's rows name, as they are stored."""
    wanted = {row["reference"] for row in rows_of(file, ["reference"])}
    references = file.parents[1] / REFERENCES
    return {row["reference"]: row["image"] for row in rows_of(references) if row["reference"] in wanted}


def reader_for(sensor: CalibratedSensor, reference: Rectified, name: str) -> DepthReader:
    """Bound to this untouched skin; raises `SensorMissing` where the calibration is of another grid."""
    calibrated = sensor.shape.rectify.coverage.shape
    if reference.grey.shape != calibrated:
        raise SensorMissing(
            f"expected images of {calibrated[1]} x {calibrated[0]}, as sensor {name!r} was calibrated with, got "
            f"{reference.grey.shape[1]} x {reference.grey.shape[0]}; make the data set at that size"
        )
    return sensor.shape.reader_against(reference)


def other_size(name: str, image: Rectified, reference: Rectified) -> DataSetDamaged:
    """The refusal of an image that its reference does not fit."""
    return DataSetDamaged(
        f"expected images of sensor {name!r} as large as its reference, {reference.grey.shape}, got {image.grey.shape}; leave "
        "them out: ninedtact dataset build --drop"
    )


def grey(row: Mapping[str, object], file: Path) -> Rectified:
    """A stored image with its scale; raises `DataSetDamaged`."""
    try:
        image = decoded(bytes_of(row["image"])).astype(np.float32)
    except NotAImage as trouble:
        raise DataSetDamaged(
            f"{trouble} (in {file}); leave it out: ninedtact dataset build --drop --out NEW {file.parents[1]}"
        ) from trouble
    stored = row.get("mm_per_px")
    return Rectified(image, float(stored) if isinstance(stored, float) else TWINS_WIDTH_MM / image.shape[1])
