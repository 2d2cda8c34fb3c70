"""Evaluation of a force estimator on a data set: its wrenches beside the true ones, and the tables of a model card.

`predict_dataset` estimates the wrench of every image with the calibration of the image's own sensor.
`calibrate_on_simulated_loads` gives a simulated sensor a force scale. `evaluate_per_mechanics_kind` scores a model on simulated
sensors by the mechanics of their gels.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from msgspec import Meta
from tqdm import tqdm

from ninedtact.bounds import checks_arguments
from ninedtact.calibration.force_calibration import estimated_load_n
from ninedtact.calibration.gel_fit_to_known_loads import ForceScaleImpossible, KnownLoadPress, fit_known_loads
from ninedtact.design import ForceTorqueMount
from ninedtact.force.estimator_and_scale import (
    MODULUS_KNOWN,
    ForceEstimator,
    ForceScale,
    ScaledForceEstimator,
    select_force_scale,
)
from ninedtact.force.estimator_loading import PHYSICS, build_estimator, model_file_of_spec, without_contact_detection
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.parallel_jobs import DaskCluster, Workers, run_jobs
from ninedtact.quantities import Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact_train.dataset.calibrated_readings import (
    DatasetSensorCalibration,
    RowsWithReferences,
    iterate_rows_with_references,
)
from ninedtact_train.dataset.folder import find_pair_files
from ninedtact_train.dataset.reader import read_pair_columns
from ninedtact_train.evaluation import ErrorDistribution, WrenchPredictions, evaluate_predictions
from ninedtact_train.population.sensor_population import SampledSensor
from ninedtact_train.workflows.dataset_calibrations import load_dataset_sensors, load_simulated_sensors

_Value = TypeVar("_Value")
_MECHANICS_LABELS = {
    "layered": "neo-Hookean gel on a base that yields",
    "rigid_base": "neo-Hookean gel on a rigid base",
    "linear": "linear gel on a rigid base",
}
"""Descriptions of the mechanics of simulated sensors, as in the model card."""
_KEYS_NOT_IN_CARD = ("published", "by_object", "by_sensor", "axes", "units")
"""Keys of an evaluation that are not stored in a card."""
_PHYSICS_LABEL = ", by physics"
_BALL_RADIUS_MM, _START_DEPTH_MM = 5.0, 0.8
"""Radius of the simulated ball, and the depth at which the search for a load begins."""
_SIMULATED_PRESSES = ((0.0, 0.0, 1.0), (2.5, 1.5, 1.0), (0.0, 0.0, 2.5), (-2.5, -1.5, 5.0), (2.0, -1.5, 5.0))
"""Position x and y in mm and load in N of each simulated press; the loads are about 100 to 500 g."""
_PITCH_MM = 0.3
"""Pitch of the grid on which simulated presses are solved; a coarse one is enough, because a ball is smooth."""
_PRESS_STD = 0.08
"""Relative error of one estimate."""
_REFERENCE_FRAMES = 8


@checks_arguments
@dataclass(frozen=True)
class DatasetEvaluationSettings:
    """The estimator that is evaluated, and how its sensors are calibrated."""

    force: str = PHYSICS
    """Estimator: physics, a force model (.onnx) or the original project's weights (.pt)."""
    sensors: Path | None = None
    """Folder with a sensor folder for each sensor of the data, by name.
    By default the sensors of a simulated data set are calibrated from their own simulated images."""
    modulus: Literal["true", "design", "calibrated"] = "true"
    """Shear modulus assumed for simulated gels: true (the simulated one), design (the nominal one), or calibrated.
    calibrated: the nominal one, and a factor from five simulated loads of 100 to 500 g."""
    every: Annotated[int, Meta(ge=1)] = 1
    """Evaluate one of every n pairs; which one varies."""
    without_contact_detection: bool = False
    """Use a network's estimate also where no contact is detected; otherwise it is zero there."""


def predict_dataset(
    data: Path,
    settings: DatasetEvaluationSettings = DatasetEvaluationSettings(),
    workers: Workers = 2,
    *,
    progress: bool = False,
    notify: Callable[[str], None] = lambda _: None,
) -> WrenchPredictions:
    """Return the estimator's wrenches for a data set beside the true ones, torques about the skin's centre.

    workers: number of processes that calibrate simulated sensors and estimate, or a cluster. notify: receives a sentence about each
    calibration to be distrusted, about each sensor whose pairs are left out, and about images from which nothing is estimated.
    Raises what estimators and data sets raise, as training does for wrenches that are not finite and pairs without a reference
    image.
    """
    read_pair_columns(data)
    _build_estimator.cache_clear()  # a model file may have been written anew since the last evaluation in this process
    known = load_dataset_sensors(data, settings.sensors, workers, progress)
    for notice in known.notices:
        notify(notice)
    members = load_simulated_sensors(data)
    sensors = dict(known.by_name)
    for name in sensors.keys() & members.keys() if settings.modulus == "true" else ():
        gel = replace(sensors[name].gel, shear_modulus_mpa=members[name].gel.shear_modulus_mpa)
        sensors[name] = replace(sensors[name], gel=gel)
    jobs = (
        (rows, _select(rows.sensors, sensors), _select(rows.sensors, members), settings, _read_model(settings, workers))
        for rows in iterate_rows_with_references(find_pair_files(data), settings.every, known.refused)
    )
    groups: dict[int, list[_EstimatedPair]] = {}
    with tqdm(unit="pair", disable=not progress) as bar:
        for number, group in run_jobs(_estimate_pairs, jobs, workers):
            groups[number] = group
            bar.update(len(group))
    pairs = [pair for number in sorted(groups) for pair in groups[number]]
    truth, wrenches, std, objects, names, refused = zip(*pairs, strict=True) if pairs else ((),) * 6
    if any(refused):
        notify(
            f"nothing is estimated from {sum(refused)} of {len(pairs)} images, which no press can cause; they count as zero"
        )
    six = [np.array(column, float).reshape(-1, 6) for column in (truth, wrenches, std)]
    distribution = ErrorDistribution.GAUSSIAN if settings.force == PHYSICS else ErrorDistribution.LAPLACE
    claimed = np.where(np.isfinite(six[2]), six[2], np.nan)
    return WrenchPredictions(six[0], six[1], claimed, distribution, objects, names, (0.0, 0.0, 0.0))


_EstimatedPair = tuple[Any, Any, Any, str, str, bool]
"""A true wrench with its estimate and the standard deviations of it, N and N·m about the skin's centre; object and sensor; and
whether no press can cause the image, so that nothing is estimated from it."""


def _select(names: Collection[str], all_of: Mapping[str, _Value]) -> dict[str, _Value]:
    """Return the entries of these names, so that a worker receives no others."""
    return {name: all_of[name] for name in names if name in all_of}


def _read_model(settings: DatasetEvaluationSettings, workers: Workers) -> bytes | None:
    """Return the file of the force model for the workers of a cluster, which may not have it; None where they need none."""
    path = model_file_of_spec(settings.force) if isinstance(workers, DaskCluster) else None
    return path.read_bytes() if path is not None and path.is_file() else None


def _estimate_pairs(
    rows: RowsWithReferences,
    sensors: dict[str, DatasetSensorCalibration],
    members: dict[str, SampledSensor],
    settings: DatasetEvaluationSettings,
    model: bytes | None,
) -> list[_EstimatedPair]:
    pairs = []
    for pair in rows.readings(sensors):
        estimator = _build_estimator(settings, sensors[pair.sensor], members.get(pair.sensor), model)
        estimator.forget()
        estimate = estimator.estimate(pair.reading)
        is_refused = bool(pair.reading.image_warnings)
        pairs.append((pair.wrench, estimate.wrench.six, estimate.std, pair.object, pair.sensor, is_refused))
    return pairs


@lru_cache(maxsize=32)
def _build_estimator(
    settings: DatasetEvaluationSettings,
    sensor: DatasetSensorCalibration,
    member: SampledSensor | None,
    model: bytes | None,
) -> ForceEstimator:
    """Build the estimator for one sensor, with this content of its model's file where it was sent along; the last ones are kept.

    A real sensor has the force scale of its folder, as in live use; that of a simulated one follows from `settings.modulus`.
    """
    path = model_file_of_spec(settings.force)
    if model is None or path is None:
        estimator = build_estimator(settings.force, sensor.shape, sensor.gel)
    else:
        with TemporaryDirectory(prefix="ninedtact") as folder:
            copy = Path(folder) / path.name
            copy.write_bytes(model)
            estimator = build_estimator(str(copy), sensor.shape, sensor.gel)
    if settings.without_contact_detection:
        estimator = without_contact_detection(estimator)
    if member is None:
        return ScaledForceEstimator(estimator, select_force_scale(estimator, dict(sensor.force_scales)))
    if settings.modulus != "calibrated":
        return ScaledForceEstimator(estimator, MODULUS_KNOWN) if settings.force == PHYSICS else estimator
    return calibrate_on_simulated_loads(estimator, member, sensor.shape)


def calibrate_on_simulated_loads(
    estimator: ForceEstimator, member: SampledSensor, shape: CalibratedShape
) -> ForceEstimator:
    """Return the estimator with the force scale from five simulated presses of a ball with known loads.

    Where the estimator detects no contact in one of the presses, it is returned without a scale.
    """
    presses = []
    try:
        for reading, load_n in _simulate_presses(member, shape):
            estimator.forget()
            reading = reading.with_force(estimator.estimate(reading))
            presses.append(KnownLoadPress("a ball", load_n, (estimated_load_n(reading),), _PRESS_STD))
        fit = fit_known_loads(presses)
        return ScaledForceEstimator(estimator, ForceScale(fit.factor, fit.error, len(presses)))
    except ForceScaleImpossible:
        return estimator


def _simulate_presses(member: SampledSensor, shape: CalibratedShape) -> Iterator[tuple[Reading, float]]:
    """Yield the sensor's reading of every simulated press, and its load in N."""
    twin = member.twin(_PITCH_MM)
    depth_reader = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(-_REFERENCE_FRAMES, 0)))
    for number, (x, y, load_n) in enumerate(_SIMULATED_PRESSES):
        pose = Pose(x, y, _START_DEPTH_MM)
        ball = Ball(_BALL_RADIUS_MM)
        press = twin.press(None, ball, pose, load_n)
        reading = read_frame(Frame(twin.renderer(press.corrected, number)), shape, depth_reader)
        yield reading, float(press.load_n)


def evaluate_per_mechanics_kind(
    model: Path, data: Path, workers: int, progress: bool, notify: Callable[[str], None] = lambda _: None
) -> dict[str, dict[str, Any]]:
    """Evaluate a model, and physics beside it, on a data set of simulated sensors for the model's card: one table for each kind
    of mechanics, and one for all.

    Every sensor is calibrated from its own images and its force with five simulated loads.
    """
    mechanics = {name: member.kind for name, member in load_simulated_sensors(data).items()}
    tables: dict[str, dict[str, Any]] = {}
    for force, label in ((str(model), ""), (PHYSICS, _PHYSICS_LABEL)):
        settings = DatasetEvaluationSettings(force, modulus="calibrated")
        predictions = predict_dataset(data, settings, workers, progress=progress, notify=notify)
        kinds = [mechanics[name] for name in predictions.sensors or ()]
        for kind, words in _MECHANICS_LABELS.items():
            if kind in kinds:
                tables[words + label] = _card_table(predictions.select([one == kind for one in kinds]))
        tables["all" + label] = _card_table(predictions)
    return tables


def _card_table(predictions: WrenchPredictions) -> dict[str, Any]:
    """Return the scores about the skin's centre, and the skill with torques about the paper's point."""
    scores = evaluate_predictions(predictions).to_json_dict()
    skill = evaluate_predictions(predictions.about(ForceTorqueMount().origin_mm)).scores.skill
    kept = {key: value for key, value in scores.items() if key not in _KEYS_NOT_IN_CARD}
    return {**kept, "skill_35_mm_below": skill.tolist()}
