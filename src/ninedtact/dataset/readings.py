"""Images of a data set as a sensor would have read them: what estimators of force are judged on."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.dataset.columns import rows_of
from ninedtact.dataset.sensor_heights import COLUMNS, CalibratedSensor, SensorMissing, grey, reader_for, untouched_of
from ninedtact.dataset.sources.table import NO_OBJECT, pair_files
from ninedtact.quantities import Frame
from ninedtact.reading import Reading
from ninedtact.shape.depth import DepthReader

ASKED = (*COLUMNS, "id", "wrench", "object", "kind")


@dataclass(frozen=True)
class JudgedPair:
    """One row, read."""

    reading: Reading
    wrench: Float32[Array, "6"]
    """True, N and N·m about the skin's centre."""
    object: str
    sensor: str
    kind: str


def readings(
    folder: Path, sensors: Mapping[str, CalibratedSensor], every: int = 1, left_out: Collection[str] = ()
) -> Iterator[JudgedPair]:
    """Every so many-th pair of a data set but those of sensors that are left out; raises `SensorMissing`, `DataSetDamaged`."""
    number = 0
    for file in pair_files(folder):
        untouched = untouched_of(file)
        bound: dict[tuple[str, str], DepthReader] = {}
        for row in rows_of(file, ASKED):
            number += 1
            if (number - 1) % every == 0 and row["sensor"] not in left_out:
                yield judged(row, untouched, sensors, bound, file)


def judged(
    row: dict[str, object],
    untouched: Mapping[str, object],
    sensors: Mapping[str, CalibratedSensor],
    bound: dict[tuple[str, str], DepthReader],
    file: Path,
) -> JudgedPair:
    """One row, read by its own sensor's calibration against its own untouched image."""
    sensor, reference = str(row["sensor"] or ""), str(row["reference"])
    if (sensor, reference) not in bound:
        if sensor not in sensors:
            raise SensorMissing(
                f"expected the calibration of every sensor, got none of {sensor!r}; give a folder that holds a sensor folder of "
                "each name"
            )
        bound[sensor, reference] = reader_for(
            sensors[sensor], grey({**row, "image": untouched[reference]}, file), sensor
        )
    reader, image = bound[sensor, reference], grey(row, file)
    nothing = Frame(np.zeros((1, 1, 3), np.uint8))
    reading = Reading(nothing, image, reader(image), reference=reader.reference)
    wrench = np.asarray(row["wrench"], np.float32)
    return JudgedPair(reading, wrench, str(row["object"] or NO_OBJECT), sensor, str(row["kind"] or ""))
