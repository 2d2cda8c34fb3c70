"""Calibrations of a data set's sensors: read from given sensor folders, or computed for its simulated sensors.

`load_dataset_sensors` returns the calibration of every sensor by name, and the reason for each simulated sensor that could not be
calibrated. Heights and wrenches of the data set are computed with these calibrations.
"""

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array
from tqdm import tqdm

from ninedtact.atomic_write import write_file_atomically
from ninedtact.calibration.drift.reference_check import load_reference_image_checker
from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.save import save_sensor
from ninedtact.calibration.sensor_folder import SENSOR_FILE, load_sensor
from ninedtact.errors import CalibrationError, NinedtactError
from ninedtact.force.estimator_and_scale import read_force_scales
from ninedtact.force.traction.estimator import TractionForce
from ninedtact.parallel_jobs import Workers, run_writing_jobs
from ninedtact.quantities import Frame
from ninedtact.simulation.calibration_images import GUIDED_FRAMES, simulate_calibration_images
from ninedtact_train.dataset.calibrated_readings import DatasetSensorCalibration
from ninedtact_train.dataset.folder import (
    REFERENCES_FILE,
    SENSOR_FOLDERS,
    find_sensor_folders,
    read_sensor_parameters,
    sensor_parameters_damage,
)
from ninedtact_train.dataset.parquet_files import (
    StoredImageUnreadable,
    decode_stored_image,
    iterate_rows_at,
    read_columns,
)
from ninedtact_train.population.sensor_population import SampledSensor, sampled_sensor_from_json

_REFUSAL_FILE = "refused.txt"


@dataclass(frozen=True)
class DatasetSensors:
    """The calibrations of a data set's sensors."""

    by_name: dict[str, DatasetSensorCalibration]
    refused: dict[str, str]
    """Reason for each simulated sensor that could not be calibrated, by name; the pairs of these sensors are left out."""
    notices: tuple[str, ...] = ()
    """A sentence about each calibration to be distrusted, and about each sensor whose pairs are left out."""


def load_simulated_sensors(data: Path) -> dict[str, SampledSensor]:
    """Read the simulated sensors of a data set by name; a data set of real sensors has none. Raises `FileFormatError`."""
    tables = read_sensor_parameters(data)
    try:
        return {table["name"]: sampled_sensor_from_json(table) for table in tables}
    except (ValueError, TypeError, NinedtactError) as trouble:
        raise sensor_parameters_damage(data, trouble) from trouble


def find_dataset_sensor_folders(data: Path, given: Path | None = None) -> list[Path]:
    """Return the sensor folders in a given folder, by default those that a data set carries."""
    return find_sensor_folders(data / SENSOR_FOLDERS if given is None else given)


def load_dataset_sensors(data: Path, given: Path | None, workers: Workers, progress: bool) -> DatasetSensors:
    """Read the calibration of every sensor of a data set.

    given: a folder with a sensor folder for each sensor, by name; where None, the calibrations that the recordings of the data set
    carried are read, or its simulated sensors are calibrated. workers: number of processes that calibrate, or a cluster. Raises
    `CalibrationError`, `SensorFolderDamaged`, `FileFormatError`.
    """
    require_sensor_calibrations(data, given)
    refused: dict[str, str] = {}
    if given is None:
        members = load_simulated_sensors(data)
        refused = calibrate_simulated_sensors(members, data / SENSOR_FOLDERS, workers, progress)
        if members and len(refused) == len(members):
            raise CalibrationError(
                f"expected simulated sensors that can be calibrated, got none of {data}: {next(iter(refused.values()))}"
            )
    by_name = {path.name: _load_calibrated_sensor(path) for path in find_dataset_sensor_folders(data, given)}
    left_out = (f"pairs of {name} are left out, it could not be calibrated: {why}" for name, why in refused.items())
    return DatasetSensors(by_name, refused, (*find_calibration_doubts(data, given), *left_out))


def find_calibration_doubts(data: Path, given: Path | None) -> Iterator[str]:
    """Yield why calibrations are to be distrusted: those that were edited, and those of another sensor than the one that a
    reference image of the data set shows.

    given: as for `load_dataset_sensors`; where None, simulated sensors, calibrated from their own images, are not compared. Raises
    `SensorFolderDamaged`, `FileFormatError`.
    """
    folders = {path.name: load_sensor(path) for path in find_dataset_sensor_folders(data, given)}
    for folder in folders.values():
        yield from folder.notices
    own = load_simulated_sensors(data) if given is None else {}
    for name, reference in _read_first_references(data, folders.keys() - own.keys()):
        checker = load_reference_image_checker(folders[name]).on_skin_grid()
        if checker.known is None or reference.shape == checker.known.depth_image.shape:
            for fault in checker.find_faults([Frame(reference)]):
                yield f"the reference images of {name} in {data} are not of the sensor in {folders[name].path}; {fault}"


def _read_first_references(data: Path, names: Collection[str]) -> Iterator[tuple[str, UInt8[Array, "rows cols 3"]]]:
    """Yield the first reference image of each of these sensors with its name; one that cannot be read fails where it is used."""
    path = data / REFERENCES_FILE
    if not path.is_file():
        return
    first: dict[str, int] = {}
    for number, name in enumerate(read_columns([path], ["sensor"])["sensor"].to_pylist()):
        if name in names:
            first.setdefault(name, number)
    for row in iterate_rows_at(path, first.values()):
        with suppress(StoredImageUnreadable):
            yield row["sensor"], np.asarray(cv2.cvtColor(decode_stored_image(row["image"]), cv2.COLOR_GRAY2BGR))


def require_sensor_calibrations(data: Path, given: Path | None, otherwise: str = "") -> None:
    """Raise `CalibrationError` where a data set has no calibrations and none can be made; this takes no time.

    otherwise: what can be done without calibrations, as the end of the sentence.
    """
    if data.is_dir() and given is None and not find_dataset_sensor_folders(data) and not load_simulated_sensors(data):
        raise CalibrationError(
            expected=f"the calibrations of the sensors of {data}",
            got="none",
            remedy=f"give --sensors, a folder that holds a sensor folder of each name{otherwise}",
        )


def calibrate_simulated_sensors(
    members: Mapping[str, SampledSensor], folder: Path, workers: Workers, progress: bool
) -> dict[str, str]:
    """Calibrate each simulated sensor from its own board and ball images, unless it was tried before.

    Returns the reason for each sensor that could not be calibrated.
    """
    tried = {name for name in members for file in (SENSOR_FILE, _REFUSAL_FILE) if (folder / name / file).is_file()}
    jobs = [(name, member) for name, member in members.items() if name not in tried]
    with tqdm(total=len(jobs), unit="sensor", disable=not (progress and jobs)) as bar:
        for _ in run_writing_jobs(calibrate_simulated_sensor, folder, jobs, workers):
            bar.update()
    refusals = {name: folder / name / _REFUSAL_FILE for name in members}
    return {name: path.read_text() for name, path in refusals.items() if path.is_file()}


def calibrate_simulated_sensor(folder: Path, name: str, member: SampledSensor) -> None:
    """Write the sensor folder of a simulated sensor into a folder, or the reason why it could not be calibrated."""
    out = folder / name
    images = simulate_calibration_images(member.twin(), member.design, presses=member.presses, frames=GUIDED_FRAMES)
    try:
        made = calibrate(CalibrationImages(**vars(images)), member.design, sensor_id=member.name)
    except NinedtactError as refusal:
        out.mkdir(parents=True, exist_ok=True)
        write_file_atomically(out / _REFUSAL_FILE, str(refusal).encode())
    else:
        save_sensor(out, made)


def _load_calibrated_sensor(folder: Path) -> DatasetSensorCalibration:
    sensor = load_sensor(folder)
    digest = sha256((folder / SENSOR_FILE).read_bytes()).hexdigest()
    scales, of_gel = dict(read_force_scales(folder).scales), sensor.gel_force_scale
    if of_gel is not None and (of_gel.presses or TractionForce.name not in scales):
        scales[TractionForce.name] = of_gel
    return DatasetSensorCalibration(sensor.shape, sensor.gel, digest, tuple(scales.items()))
