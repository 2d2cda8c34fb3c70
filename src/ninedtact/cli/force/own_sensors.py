"""The calibrations that a data set's heights are read by: sensor folders that were given, or made by its twins of themselves."""

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ninedtact.atomic_write import write_file_atomically
from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.dataset.calibrated_readings import CalibratedSensor
    from ninedtact.simulation.sensor_population import SampledSensor

REFUSED = "refused.txt"
OWN = "sensors"
"""Folder in the data set."""


class SensorsNotKnown(NinedtactError):
    """A data set whose sensors have no calibration."""


def members_of(data: Path) -> dict[str, "SampledSensor"]:
    """The twins of a data set that was simulated, by name; none of another."""
    from ninedtact.dataset.folder import SENSORS_FILE
    from ninedtact.simulation.sensor_population import sampled_sensor_from_json

    if not (data / SENSORS_FILE).is_file():
        return {}
    tables: list[dict[str, Any]] = json.loads((data / SENSORS_FILE).read_text())
    return {table["name"]: sampled_sensor_from_json(table) for table in tables}


@dataclass(frozen=True)
class KnownSensors:
    """The calibrations of a data set's sensors."""

    by_name: "dict[str, CalibratedSensor]"
    refused: dict[str, str]
    """Twins that no calibration was possible of, each with the reason: their pairs are left out."""


def sensors_for(data: Path, given: Path | None, workers: int, progress: bool) -> KnownSensors:
    """Raises `SensorsNotKnown`, `SensorFolderDamaged`."""
    refused: dict[str, str] = {}
    if given is None and not (members := members_of(data)):
        raise SensorsNotKnown(
            f"expected the calibrations of the sensors of {data}, got none; give --sensors, a folder that holds a sensor folder "
            "of each name, or train on images: --channels deformation"
        )
    if given is None:
        given = data / OWN
        refused = calibrate_twins(members, given, workers, progress)
        if len(refused) == len(members):
            raise SensorsNotKnown(
                f"expected twins that can be calibrated, got none of {data}: {next(iter(refused.values()))}"
            )
    return KnownSensors({path.parent.name: read(path.parent) for path in sorted(given.glob("*/sensor.toml"))}, refused)


def calibrate_twins(
    members: Mapping[str, "SampledSensor"], folder: Path, workers: int, progress: bool
) -> dict[str, str]:
    """Each from its own board and ball, as a person would, those that are there already apart; why some could not be."""
    from tqdm import tqdm

    from ninedtact.dataset.worker_pool import run_in_processes

    jobs = [(member, folder / name) for name, member in members.items() if not is_tried(folder / name)]
    with tqdm(total=len(jobs), unit="sensor", disable=not (progress and jobs)) as bar:
        for _ in run_in_processes(calibrate_twin, jobs, workers):
            bar.update()
    return {name: (folder / name / REFUSED).read_text() for name in members if (folder / name / REFUSED).is_file()}


def tell_refused(refused: Mapping[str, str]) -> None:
    """One line on standard error for each."""
    for name, reason in refused.items():
        print(
            f"ninedtact: pairs of {name} are left out, it could not be calibrated: {reason}",
            file=sys.stderr,
            flush=True,
        )


def is_tried(folder: Path) -> bool:
    """Whether a sensor was calibrated there, or could not be."""
    return any((folder / name).is_file() for name in ("sensor.toml", REFUSED))


def calibrate_twin(member: "SampledSensor", out: Path) -> None:
    """A sensor folder of it, or the reason why there can be none."""
    from ninedtact.calibration.procedure import CalibrationImages, calibrate
    from ninedtact.calibration.save import save_sensor
    from ninedtact.simulation.calibration_images import GUIDED_BOARD_MM, GUIDED_FRAMES, simulate_calibration_images

    images = simulate_calibration_images(
        member.twin(), member.design, board_depth_mm=GUIDED_BOARD_MM, frames=GUIDED_FRAMES
    )
    try:
        made = calibrate(CalibrationImages(**vars(images)), member.design, sensor_id=member.name)
    except NinedtactError as refusal:
        out.mkdir(parents=True, exist_ok=True)
        write_file_atomically(out / REFUSED, str(refusal).encode())
    else:
        save_sensor(out, made)


def read(folder: Path) -> "CalibratedSensor":
    """What heights are read by; raises `SensorFolderDamaged`."""
    from ninedtact.calibration.sensor_folder import SENSOR_FILE, load_sensor
    from ninedtact.cli.force.estimators import gel_of
    from ninedtact.dataset.calibrated_readings import CalibratedSensor

    sensor = load_sensor(folder)
    return CalibratedSensor(sensor.shape, gel_of(sensor), sha256((folder / SENSOR_FILE).read_bytes()).hexdigest())
