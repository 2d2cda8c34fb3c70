"""Training of a force model on a data set: reading of its examples, the split into training and held-out pairs, and the training.

A data set, training settings and a fraction to hold out go in; the folder of `train_network` with the model comes out.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.design import Gel, SensorDesign
from ninedtact.force.network_input import NetworkInputSettings, scale_input_settings_to_width, sensor_features_of
from ninedtact_train.dataset.height_cache import load_height_pairs
from ninedtact_train.dataset.reader import load_dataset, read_pair_columns
from ninedtact_train.dataset.split import HeldOutSettings, SplitRows, read_split
from ninedtact_train.training.examples import TrainingExamples
from ninedtact_train.training.settings import ComputeSettings, TrainingSettings
from ninedtact_train.training.train import TrainingResult, train_network
from ninedtact_train.workflows.dataset_calibrations import (
    find_calibration_doubts,
    find_dataset_sensor_folders,
    load_dataset_sensors,
    load_simulated_sensors,
)


def train_on_dataset(
    data: Path,
    out: Path,
    settings: TrainingSettings,
    held_out: HeldOutSettings = HeldOutSettings(),
    *,
    sensors: Path | None = None,
    workers: int = 1,
    name: str = "network",
    licence: str = "MIT",
    machine: ComputeSettings = ComputeSettings(),
    progress: bool = False,
    notify: Callable[[str], None] = lambda _: None,
) -> TrainingResult | None:
    """Train a force model on a data set and write it to `out`; None in all processes of a training but the first.

    sensors: a folder with a sensor folder for each sensor of the data, by name; where None, simulated sensors are calibrated.
    workers: number of processes that read images. notify: receives a sentence about each calibration to be distrusted, about
    each sensor whose pairs are left out, and about the number of pairs that are used and left out.
    Raises what `load_dataset_sensors`, the data set, the split and `train_network` raise.
    """
    examples, ids = read_training_examples(data, settings.input, sensors, workers, progress, notify)
    all_ids = read_pair_columns(data)["id"].to_pylist()
    rows = held_out.rows(ids, examples.objects, examples.sensors, all_ids)
    notify(_describe_use_of_pairs(rows, ids, len(all_ids), held_out))
    return train_network(examples, rows, settings, out, name=name, licence=licence, machine=machine, progress=progress)


def _describe_use_of_pairs(rows: SplitRows, ids: Sequence[str], total: int, held_out: HeldOutSettings) -> str:
    """Return how many pairs are trained on, held out and left out, and why, as a sentence.

    ids: of the examples that could be read. total: number of pairs of the data set.
    """
    of_file = len(ids) if held_out.split is None else len(set(read_split(held_out.split).train) & set(ids))
    reasons = {
        "of sensors that could not be calibrated": total - len(ids),
        "that the split file does not train on": len(ids) - of_file,
        "whose sensor or object is held out, but not both": of_file - len(rows.train) - len(rows.test),
    }
    left_out = ", ".join(f"{count} {why}" for why, count in reasons.items() if count)
    use = (
        f"of {total} pairs, {len(rows.train)} are trained on and {len(rows.test)} are held out to choose the best epoch"
    )
    return f"{use}; left out are {left_out}" if left_out else use


def read_training_examples(
    data: Path,
    grid: NetworkInputSettings,
    sensors: Path | None = None,
    workers: int = 1,
    progress: bool = False,
    notify: Callable[[str], None] = lambda _: None,
) -> tuple[TrainingExamples, Sequence[str]]:
    """Read examples and their ids; wrenches are scaled from the shear modulus of each sensor's gel to that of the design."""
    if grid.channels.of_heights:
        known = load_dataset_sensors(data, sensors, workers, progress)
        for notice in known.notices:
            notify(notice)
        heights = load_height_pairs(
            data, known.by_name, grid.grid, workers=workers, left_out=known.refused, progress=progress
        )
        features = {name: sensor_features_of(sensor.shape, sensor.gel).row for name, sensor in known.by_name.items()}
        ids, names = heights.ids, (heights.objects.tolist(), heights.sensors.tolist())
        each = np.array([features[name] for name in names[1]])
        examples = TrainingExamples(heights.z_mm, heights.wrenches, *names, sensor_features=each)
    else:
        for doubt in find_calibration_doubts(data, sensors):
            notify(doubt)
        pairs = load_dataset(data, (grid.cols, grid.rows), threads=workers, progress=progress)
        ids, decoded, names = pairs.ids, pairs.decoded, (pairs.objects.tolist(), pairs.sensors.tolist())
        examples = TrainingExamples(decoded.images, pairs.wrenches, *names, decoded.references, pairs.reference_rows)
    moduli = {name: gel.shear_modulus_mpa for name, (gel, _) in _read_gels_and_designs(data, sensors).items()}
    usual = Gel().shear_modulus_mpa
    return examples.scale_to_design_modulus(
        np.array([moduli.get(name, usual) for name in examples.sensors])
    ), ids.tolist()


def _read_gels_and_designs(data: Path, sensors: Path | None) -> dict[str, tuple[Gel, SensorDesign]]:
    """Return gel and design of each sensor: the true ones of a simulated sensor, those of its sensor folder for a real one.

    A force model multiplies by the modulus of the sensor folder, so that a real sensor's wrenches are divided by it first.
    """
    found = {name: (member.gel, member.design) for name, member in load_simulated_sensors(data).items()}
    for folder in find_dataset_sensor_folders(data, sensors):
        if folder.name not in found:
            sensor = load_sensor(folder)
            found[folder.name] = sensor.gel, sensor.record.design
    return found


def match_input_width_to_dataset(
    settings: TrainingSettings, data: Path, sensors: Path | None = None
) -> TrainingSettings:
    """Return the settings with the input's grid as wide as the designed sensing area of the data set's sensors.

    sensors: a folder with a sensor folder for each real sensor, by name; where None, those that the data set carries. Settings for
    a data set without simulated sensors and sensor folders stay as they are. Raises `SensorFolderDamaged`.
    """
    widths = [design.sensing_area.width_mm for _, design in _read_gels_and_designs(data, sensors).values()]
    return replace(settings, input=scale_input_settings_to_width(settings.input, max(widths))) if widths else settings
