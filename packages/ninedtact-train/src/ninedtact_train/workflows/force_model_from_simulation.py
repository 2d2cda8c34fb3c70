"""Pipeline that makes a force model from simulation alone: data generation, training, validation and a demonstration.

A `ForceModelRecipe` with numbers of pairs, sensors and epochs goes in; a folder with the model, its model card and the sensor
folder of the demonstration comes out (`make_force_model`). Validation uses sensors and objects that were not trained on.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import radians
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.design import SensorDesign
from ninedtact.force.estimator_loading import build_estimator
from ninedtact.force.onnx_model import ModelCard, read_force_model
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.reference_images import ReferenceImages
from ninedtact.sensor import Sensor
from ninedtact.shape.calibrated_shape import REFERENCE_FRAMES
from ninedtact.simulation.objects.catalogue import PAPER_COUNT, generated_object_names, indenter_from_name
from ninedtact.simulation.press_sequence import ObjectTrajectory, PressSequence
from ninedtact.simulation.simulated_sources import SimulatedCamera
from ninedtact.simulation.trajectory import press_trajectory
from ninedtact.simulation.twin import Twin
from ninedtact_train.dataset.generation.generate import generate_dataset
from ninedtact_train.dataset.generation.settings import GenerationSettings, PressSettings
from ninedtact_train.dataset.held_out import HeldOutSettings
from ninedtact_train.evaluation.model_card_markdown import format_model_card
from ninedtact_train.population.mechanics_shares import NonidealMechanicsShares
from ninedtact_train.population.sensor_population import sample_sensor
from ninedtact_train.training.compute_settings import ComputeSettings
from ninedtact_train.training.onnx_export import rewrite_card
from ninedtact_train.training.settings import CORRECTOR_TRAINING
from ninedtact_train.training.train import MODEL_FILE
from ninedtact_train.workflows.dataset_calibrations import calibrate_simulated_sensor
from ninedtact_train.workflows.dataset_evaluation import evaluate_per_mechanics_kind
from ninedtact_train.workflows.dataset_training import match_input_width_to_dataset, train_on_dataset

_HELD_OUT_FAMILIES = frozenset(
    (
        *("cells", "dial", "saddle", "profile_bar", "pyramid", "foam", "spring", "ring", "punch"),
        *("letter", "puzzle", "molar", "blob", "ball", "caltrop", "cylinder", "dots", "spiral"),
        *("hook", "leaf", "ellipsoid", "gear", "crescent", "spanner", "coin", "paw", "pyramids", "chain", "button"),
    )
)
"""A third of the families of objects, sampled once. They are never used for training, so that validation objects are new."""
_LOAD_N, _LOAD_RANGE_N = (4.0, 3.5), (0.3, 12.0)
"""Mean and standard deviation of the loads of training presses, and their range: wider than what hands do."""
_TRAINING_SEED, _VALIDATION_SEED, _DEMONSTRATION_SEED = 0, 2, 3
"""Seeds of the sampled sensors, different for each data set."""
TRAINING_DATA_FOLDER, VALIDATION_DATA_FOLDER, _TRAINING_FOLDER = "training_data", "validation_data", "training"
SENSOR_FOLDER, _MODEL_FILE, _CARD_FILE = "sensor", "model.onnx", "model_card.md"

_OBJECT, _DEPTH_MM, _DRAG_MM, _TWIST_DEG = "ball:5", 1.1, (0.8, 0.3), 8.0
_MAX_DEPTH_FRACTION = 0.5
"""Largest depth of the demonstration, as a fraction of the gel's thickness."""
_RATE_HZ, _EVERY = 20.0, 8


@dataclass(frozen=True)
class ForceModelRecipe:
    """Numbers of pairs, sensors and epochs with which a model is made."""

    pairs: int
    sensors: int
    epochs: int
    validation_pairs: int
    validation_sensors: int
    held_out: Literal["sensor_and_object", "object", "sensor", "standard"] | None = None
    """Kind of held-out pairs by which the best epoch is chosen; None: sensors and objects that are not trained on."""
    precision: Literal["32-true", "bf16-mixed", "16-mixed"] = "32-true"
    pitch_mm: float = 0.2
    validation_pitch_mm: float = 0.2
    """Pitch of the grids on which contacts are solved."""
    design: SensorDesign = SensorDesign()
    """The design of all simulated sensors."""

    @property
    def training_data(self) -> GenerationSettings:
        """Settings of the training data: sensors of all mechanics, objects that are not held out, loads down to light touches."""
        return GenerationSettings(
            self.pairs,
            sensors=self.sensors,
            object_names=_object_names(held_out=False),
            seed=_TRAINING_SEED,
            pitch_mm=self.pitch_mm,
            design=self.design,
            press=PressSettings(load_n=_LOAD_N, load_range_n=_LOAD_RANGE_N),
        )

    @property
    def validation_data(self) -> GenerationSettings:
        """Settings of the validation data: held-out objects on other sensors, most with the mechanics that estimators assume."""
        return GenerationSettings(
            self.validation_pairs,
            sensors=self.validation_sensors,
            object_names=_object_names(held_out=True),
            seed=_VALIDATION_SEED,
            mechanics=NonidealMechanicsShares(compliant_base=0.15, finite_strain=0.15),
            pitch_mm=self.validation_pitch_mm,
            design=self.design,
        )


def _object_names(held_out: bool) -> tuple[str, ...]:
    """Return the names of generated objects, as many as the paper has: those of held-out families, or all others."""
    names = generated_object_names(PAPER_COUNT)
    return tuple(name for name in names if (name.rsplit("_", 1)[0] in _HELD_OUT_FAMILIES) == held_out)


RECIPES = {
    "small": ForceModelRecipe(
        pairs=2400, sensors=12, epochs=12, validation_pairs=600, validation_sensors=6, validation_pitch_mm=0.3
    ),
    "large": ForceModelRecipe(
        pairs=40_000, sensors=120, epochs=20, validation_pairs=14_000, validation_sensors=48, precision="bf16-mixed"
    ),
}
"""Recipes by name. small demonstrates the pipeline in minutes; large takes an evening on two cores."""


@dataclass(frozen=True)
class TrueAndEstimatedWrench:
    """True and estimated wrench at one moment of a demonstration, N and N·m."""

    seconds: float
    true: np.ndarray
    estimated: np.ndarray


@dataclass(frozen=True)
class ForceModelResult:
    """The files of a force model made from simulation, its card, and a demonstration on one more simulated sensor."""

    model: Path
    card_file: Path
    sensor: Path
    """Sensor folder of the demonstration."""
    card: ModelCard
    demonstration: list[TrueAndEstimatedWrench]


def make_force_model(
    out: Path,
    recipe: ForceModelRecipe,
    *,
    name: str = "moments",
    workers: int = 2,
    progress: bool = False,
    notify: Callable[[str], None] = lambda _: None,
) -> ForceModelResult:
    """Make a force model in `out` by a recipe. Called again after an interruption, it continues.

    workers: number of processes that simulate and calibrate. notify: receives a sentence about each step and each sensor that is
    left out.
    """
    out.mkdir(parents=True, exist_ok=True)
    notify(f"1 of 4: simulate {recipe.pairs} pairs for training and {recipe.validation_pairs} for validation")
    for folder, settings in (
        (TRAINING_DATA_FOLDER, recipe.training_data),
        (VALIDATION_DATA_FOLDER, recipe.validation_data),
    ):
        generate_dataset(out / folder, settings, workers, progress=progress, device="auto")
    notify("2 of 4: calibrate every simulated sensor and train the network")
    train_on_dataset(
        out / TRAINING_DATA_FOLDER,
        out / _TRAINING_FOLDER,
        match_input_width_to_dataset(replace(CORRECTOR_TRAINING, epochs=recipe.epochs), out / TRAINING_DATA_FOLDER),
        HeldOutSettings(recipe.held_out),
        workers=workers,
        name=name,
        machine=ComputeSettings(precision=recipe.precision),
        progress=progress,
        notify=notify,
    )
    notify("3 of 4: validate on sensors and objects that were not trained on")
    trained = out / _TRAINING_FOLDER / MODEL_FILE
    card = read_force_model(trained).card
    tables = evaluate_per_mechanics_kind(trained, out / VALIDATION_DATA_FOLDER, workers, progress, notify)
    card = msgspec.structs.replace(card, evaluation={**card.evaluation, **tables})
    rewrite_card(trained, card, out / _MODEL_FILE)
    write_file_atomically(out / _CARD_FILE, format_model_card(card).encode())
    notify("4 of 4: demonstrate on one more simulated sensor")
    samples = list(_demonstrate_force_model(out / _MODEL_FILE, out / SENSOR_FOLDER, recipe.design))
    return ForceModelResult(out / _MODEL_FILE, out / _CARD_FILE, out / SENSOR_FOLDER, card, samples)


def _demonstrate_force_model(
    model: Path, sensor_folder: Path, design: SensorDesign = SensorDesign()
) -> Iterator[TrueAndEstimatedWrench]:
    """Yield samples of a press of a simulated sensor of this design, which is calibrated first into `sensor_folder`.

    Its gel has the true shear modulus, as a force calibration would give it.
    """
    simulated = sample_sensor(0, _DEMONSTRATION_SEED, design=design)
    calibrate_simulated_sensor(sensor_folder.parent, sensor_folder.name, simulated)
    folder, twin = load_sensor(sensor_folder), simulated.twin()
    gel = replace(folder.gel, shear_modulus_mpa=simulated.gel.shear_modulus_mpa)
    simulation = _simulate_press(twin, min(_DEPTH_MM, _MAX_DEPTH_FRACTION * design.gel.thickness_mm))
    reference = folder.shape.depth_reader(
        *(Frame(twin.renderer(None, number)) for number in range(-REFERENCE_FRAMES, 0))
    )
    estimator = build_estimator(str(model), folder.shape, gel)
    with Sensor(SimulatedCamera(simulation), folder.shape, ReferenceImages(reference), estimator) as sensor:
        for reading in sensor:
            if reading.frame.index % _EVERY == 0 and reading.force is not None:
                true = simulation.contact(reading.frame.index).wrench().six
                yield TrueAndEstimatedWrench(reading.frame.index / _RATE_HZ, true, reading.force.wrench.six)


def _simulate_press(twin: Twin, depth_mm: float) -> PressSequence:
    """Return a simulation of one press, drag and twist of a ball, in which no step is skipped."""
    motion = press_trajectory(Pose(depth_mm=depth_mm), drag_mm=_DRAG_MM, twist_rad=radians(_TWIST_DEG))
    return PressSequence(
        twin, [ObjectTrajectory(indenter_from_name(_OBJECT), motion)], hz=_RATE_HZ, real_time=False, rounds=1
    )
