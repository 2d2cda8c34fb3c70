"""Calibrated readings of a data set: every stored image, measured with the calibration of the sensor that took it."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.errors import CalibrationError, FileFormatError
from ninedtact.force.estimator_and_scale import ForceScale
from ninedtact.quantities import NO_OBJECT, Frame, Rectified
from ninedtact.reading import Reading
from ninedtact.shape.calibrated_shape import CalibratedShape, DepthReader
from ninedtact_train.dataset.folder import REFERENCES_FILE
from ninedtact_train.dataset.parquet_files import (
    StoredImageUnreadable,
    decode_stored_image,
    decode_stored_wrench,
    iterate_rows,
)

_COLUMNS = ("image", "reference_id", "sensor", "mm_per_px", "wrench", "object")
_ROWS_PER_GROUP = 64
"""Rows that are read together, some 4 MB of images."""


@dataclass(frozen=True)
class DatasetSensorCalibration:
    """The calibration of one sensor of a data set; two of the same digest, gel and force scales are equal."""

    shape: CalibratedShape = field(compare=False)
    gel: Gel
    digest: str
    """A digest that differs between any two calibrations of shape and gel."""
    force_scales: tuple[tuple[str, ForceScale], ...] = ()
    """Names of estimators and the force scales of the sensor folder for them."""


def require_calibrations(names: Collection[str], sensors: Mapping[str, DatasetSensorCalibration]) -> None:
    """Raise `CalibrationError` for images of sensors without calibration."""
    if missing := sorted(name for name in names if name not in sensors):
        raise CalibrationError(
            expected="the calibration of every sensor",
            got=f"none of {len(missing)} (such as {missing[0]!r})",
            remedy="give a folder that holds a sensor folder of each name",
        )


@dataclass(frozen=True)
class ReadingWithWrench:
    """A reading with the wrench that belongs to it."""

    reading: Reading
    wrench: Float32[Array, "6"]
    """The measured or simulated wrench, N and N·m about the skin's centre."""
    object: str
    sensor: str


@dataclass(frozen=True)
class RowsWithReferences:
    """Some rows of one file of a data set with their reference images: all that is needed to read them elsewhere."""

    file: Path
    rows: list[dict[str, Any]]
    references: dict[str, Any]
    """Values of the column `image` of the reference images by their id."""

    @property
    def sensors(self) -> set[str]:
        """The names of the sensors that took the images."""
        return {row["sensor"] or "" for row in self.rows}

    def readings(self, sensors: Mapping[str, DatasetSensorCalibration]) -> Iterator[ReadingWithWrench]:
        """Yield each row as a reading whose raw frame is empty; an image of unknown scale has that of the calibration.

        Raises `CalibrationError`, `FileFormatError`.
        """
        require_calibrations(self.sensors, sensors)
        readers: dict[tuple[str, str], DepthReader] = {}
        for row in self.rows:
            name, reference_id = row["sensor"] or "", row["reference_id"]
            shape = sensors[name].shape
            mm_per_px = row["mm_per_px"] or shape.rectify.mm_per_px
            image = self._decode_rectified(row["image"], mm_per_px)
            if (name, reference_id) not in readers:
                reference = self._decode_rectified(self.references[reference_id], mm_per_px)
                readers[name, reference_id] = _bind_depth_reader(shape, name, reference)
            reader = readers[name, reference_id]
            if image.grey.shape != reader.reference.grey.shape:
                raise FileFormatError(
                    expected=f"images of sensor {name!r} as large as its reference, {reader.reference.grey.shape}",
                    got=f"{image.grey.shape}",
                    remedy="leave them out: ninedtact dataset build --drop",
                )
            frame = Frame(np.zeros((1, 1, 3), np.uint8))
            checksum = shape.calibration_checksum
            reading = Reading(frame, image, reader(image), reader.reference, calibration_checksum=checksum)
            yield ReadingWithWrench(reading, decode_stored_wrench(row["wrench"]), str(row["object"] or NO_OBJECT), name)

    def _decode_rectified(self, stored: Any, mm_per_px: float) -> Rectified:
        try:
            return Rectified(decode_stored_image(stored).astype(np.float32), mm_per_px)
        except StoredImageUnreadable as error:
            advice = f"leave it out: ninedtact dataset build --drop --out NEW {self.file.parents[1]}"
            raise FileFormatError(f"{error} (in {self.file}); {advice}") from error


def _bind_depth_reader(shape: CalibratedShape, name: str, reference: Rectified) -> DepthReader:
    """Return the depth reader of a sensor for this reference image; raises `CalibrationError`."""
    calibrated = shape.rectify.height_source.shape
    if reference.grey.shape != calibrated:
        raise CalibrationError(
            expected=f"images of {calibrated[1]} x {calibrated[0]}, as sensor {name!r} was calibrated with",
            got=f"{reference.grey.shape[1]} x {reference.grey.shape[0]}",
            remedy="make the data set at that size",
        )
    return shape.reader_against(reference)


def iterate_rows_with_references(
    files: Sequence[Path], every: int = 1, left_out: Collection[str] = ()
) -> Iterator[RowsWithReferences]:
    """Yield one of every n pairs of some files of a data set in groups, without those of some sensors.

    Which one varies from one run of n pairs to the next, because sessions of simulated sensors begin with pairs without contact:
    equal steps would select far too many of these. The same data give the same pairs. Raises `FileFormatError`.
    """
    number = 0
    for file in files:
        references = _read_references(file)
        kept = []
        for row in iterate_rows(file, _COLUMNS):
            run, place = divmod(number, every)
            number += 1
            if place == _chosen_place(run, every) and (row["sensor"] or "") not in left_out:
                kept.append(row)
            if len(kept) == _ROWS_PER_GROUP:
                yield _with_references(file, kept, references)
                kept = []
        if kept:
            yield _with_references(file, kept, references)


@lru_cache(maxsize=2)
def _chosen_place(run: int, every: int) -> int:
    """Return which of the pairs of a run of `every` pairs is chosen, pseudo-random by the number of the run."""
    return int.from_bytes(blake2b(f"{every}/{run}".encode(), digest_size=8).digest()) % every


def _with_references(file: Path, rows: list[dict[str, Any]], references: Mapping[str, Any]) -> RowsWithReferences:
    ids = {row["reference_id"] for row in rows}
    return RowsWithReferences(file, rows, {name: image for name, image in references.items() if name in ids})


def _read_references(file: Path) -> dict[str, Any]:
    """Return the values of the column `image` of the reference images that a file names; raises `FileFormatError`."""
    ids = {row["reference_id"] for row in iterate_rows(file, ["reference_id"])}
    rows = iterate_rows(file.parents[1] / REFERENCES_FILE, ("reference_id", "image"))
    return {row["reference_id"]: row["image"] for row in rows if row["reference_id"] in ids}
