"""Evaluation of a force estimator on a data set: its wrenches beside the true ones, and the tables of a model card.

`predict_dataset` estimates the wrench of every image with the calibration of the image's own sensor. `evaluate_per_mechanics_kind`
scores a model on simulated sensors by the mechanics of their gels.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from tqdm import tqdm

from ninedtact.dataset.calibrated_readings import CalibratedSensor, iterate_readings
from ninedtact.force.estimator_interface import ForceEstimator
from ninedtact.force.estimator_loading import BOTH, PHYSICS, build_estimator, without_contact_detection
from ninedtact.force.evaluation import ErrorDistribution, WrenchPredictions, evaluate_predictions
from ninedtact.simulation.sensor_population import SampledSensor
from ninedtact.workflows.dataset_sensors import load_dataset_sensors, load_simulated_sensors
from ninedtact.workflows.force_calibration import calibrate_on_simulated_loads

_PAPER_TORQUE_POINT_MM = (0.0, 0.0, -35.0)
_MECHANICS_LABELS = {
    "bonded": "rigid substrate, small strains (as the calibration assumes)",
    "finite_strain": "rigid substrate, finite-strain (neo-Hookean) gel",
    "compliant_base": "compliant substrate",
}
"""Descriptions of the mechanics of simulated sensors, as in the model card."""
_FUSED_LABEL = ", network and physics fused"
_KEYS_NOT_IN_CARD = ("published", "by_object", "by_sensor", "axes", "units")
"""Keys of an evaluation that are not stored in a card."""


@dataclass(frozen=True)
class DatasetEvaluationSettings:
    """The estimator that is evaluated, and how its sensors are calibrated."""

    force: str = PHYSICS
    """Name or path of the estimator, as for the option `--force`."""
    sensors: Path | None = None
    """Folder with a sensor folder for each sensor of the data, by name; where None, simulated sensors are calibrated."""
    modulus: Literal["true", "design", "calibrated"] = "true"
    """Shear modulus assumed for simulated gels: the true one, the design's, or by force calibration with five simulated loads."""
    every: int = 1
    """Evaluate every n-th pair."""
    workers: int = 2
    """Number of processes that calibrate simulated sensors."""
    contact_detection: bool = True
    """Whether a network's estimate is zero where no contact is detected."""


def predict_dataset(
    data: Path,
    settings: DatasetEvaluationSettings = DatasetEvaluationSettings(),
    *,
    progress: bool = False,
    notify: Callable[[str], None] = lambda _: None,
) -> WrenchPredictions:
    """Return the estimator's wrenches for a data set beside the true ones, torques about the skin's centre.

    notify: receives a sentence about each sensor whose pairs are left out. Raises what estimators and data sets raise.
    """
    known = load_dataset_sensors(data, settings.sensors, settings.workers, progress)
    for notice in known.exclusion_notices():
        notify(notice)
    members = load_simulated_sensors(data)
    sensors = known.by_name
    if settings.modulus == "true":
        sensors = {name: _with_true_modulus(sensor, members.get(name)) for name, sensor in sensors.items()}
    estimators: dict[str, ForceEstimator] = {}
    truth, predicted, std, objects, names = [], [], [], [], []
    for pair in tqdm(iterate_readings(data, sensors, settings.every, known.refused), unit="pair", disable=not progress):
        if pair.sensor not in estimators:
            estimators[pair.sensor] = _build_estimator(settings, sensors[pair.sensor], members.get(pair.sensor))
        estimator = estimators[pair.sensor]
        estimator.forget()
        estimate = estimator.estimate(pair.reading)
        truth.append(pair.wrench)
        predicted.append(estimate.wrench.six)
        std.append(estimate.std)
        objects.append(pair.object)
        names.append(pair.sensor)
    six = [np.array(rows, float).reshape(-1, 6) for rows in (truth, predicted, std)]
    is_gaussian = settings.force.partition(":")[0] in (PHYSICS, BOTH)
    distribution = ErrorDistribution.GAUSSIAN if is_gaussian else ErrorDistribution.LAPLACE
    claimed = np.where(np.isfinite(six[2]), six[2], np.nan)
    return WrenchPredictions(six[0], six[1], claimed, distribution, objects, names, (0.0, 0.0, 0.0))


def _with_true_modulus(sensor: CalibratedSensor, member: SampledSensor | None) -> CalibratedSensor:
    """Return the calibration of a simulated sensor with the gel's true shear modulus, that of a real sensor as it is."""
    if member is None:
        return sensor
    return replace(sensor, gel=replace(sensor.gel, shear_modulus_mpa=member.gel.shear_modulus_mpa))


def _build_estimator(
    settings: DatasetEvaluationSettings, sensor: CalibratedSensor, member: SampledSensor | None
) -> ForceEstimator:
    """Build the estimator for one sensor."""
    estimator = build_estimator(settings.force, sensor.shape, sensor.gel)
    if not settings.contact_detection:
        estimator = without_contact_detection(estimator)
    if member is None or settings.modulus != "calibrated":
        return estimator
    return calibrate_on_simulated_loads(estimator, member, sensor.shape)


def evaluate_per_mechanics_kind(
    model: Path, data: Path, workers: int, progress: bool, notify: Callable[[str], None] = lambda _: None
) -> dict[str, dict[str, Any]]:
    """Evaluate a model on a data set of simulated sensors for its card: one table for each kind of mechanics, and one for all.

    Every sensor is calibrated from its own images and its force with five simulated loads. The network is evaluated alone, fused
    with physics, and without contact detection where there is no contact.
    """
    settings = DatasetEvaluationSettings(str(model), modulus="calibrated", workers=workers)
    mechanics = {name: member.kind for name, member in load_simulated_sensors(data).items()}
    tables: dict[str, dict[str, Any]] = {}
    for force, label in ((str(model), ""), (f"{BOTH}:{model}", _FUSED_LABEL)):
        predictions = predict_dataset(data, replace(settings, force=force), progress=progress, notify=notify)
        for words, part in _split_by_mechanics(predictions, mechanics):
            tables[words + label] = _card_table(part)
    undetected = replace(settings, modulus="true", contact_detection=False)
    without_detection = evaluate_predictions(predict_dataset(data, undetected, progress=progress))
    tables["all"]["no_contact_without_detection"] = without_detection.to_json_dict()["no_contact"]
    return tables


def _split_by_mechanics(
    predictions: WrenchPredictions, mechanics: Mapping[str, str]
) -> Iterator[tuple[str, WrenchPredictions]]:
    """Yield the predictions for sensors of each kind of mechanics that occurs, then all."""
    assert predictions.sensors is not None
    kinds = [mechanics[name] for name in predictions.sensors]
    for kind, words in _MECHANICS_LABELS.items():
        if kind in kinds:
            yield words, predictions.select([one == kind for one in kinds])
    yield "all", predictions


def _card_table(predictions: WrenchPredictions) -> dict[str, Any]:
    """Return the scores about the skin's centre, and the skill with torques about the paper's point."""
    scores = evaluate_predictions(predictions).to_json_dict()
    skill = evaluate_predictions(predictions.about(_PAPER_TORQUE_POINT_MM)).scores.skill
    kept = {key: value for key, value in scores.items() if key not in _KEYS_NOT_IN_CARD}
    return {**kept, "skill_35_mm_below": skill.tolist()}
