"""Pipeline that makes a force model from simulation alone: data generation, training and validation.

A `ForceModelRecipe` with numbers of pairs, sensors and epochs goes in; a folder with the model and its model card comes out
(`make_force_model`). Validation uses sensors and objects that were not trained on.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import msgspec

from ninedtact.atomic_write import write_file_atomically
from ninedtact.design import SensorDesign
from ninedtact.force.onnx_model import ModelCard, read_force_model
from ninedtact.simulation.objects.catalogue import PAPER_COUNT, generated_object_names
from ninedtact_train.dataset.generation.generate import generate_dataset
from ninedtact_train.dataset.generation.settings import GenerationSettings, PressSettings
from ninedtact_train.dataset.split import HeldOutSettings
from ninedtact_train.evaluation.model_card_markdown import format_model_card
from ninedtact_train.training.onnx_export import rewrite_card
from ninedtact_train.training.settings import DEFAULT_TRAINING, ComputeSettings
from ninedtact_train.training.train import MODEL_FILE
from ninedtact_train.workflows.dataset_calibrations import find_dataset_sensor_folders
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
_TRAINING_SEED, _VALIDATION_SEED = 0, 2
"""Seeds of the sampled sensors, different for each data set."""
TRAINING_DATA_FOLDER, VALIDATION_DATA_FOLDER, _TRAINING_FOLDER = "training_data", "validation_data", "training"
_MODEL_FILE, _CARD_FILE = "model.onnx", "model_card.md"


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
class ForceModelResult:
    """The files of a force model made from simulation, and its card."""

    model: Path
    card_file: Path
    sensor: Path
    """Sensor folder of one of the simulated sensors that the model was validated on, to try it with."""
    card: ModelCard


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
    notify(f"1 of 3: simulate {recipe.pairs} pairs for training and {recipe.validation_pairs} for validation")
    for folder, settings in (
        (TRAINING_DATA_FOLDER, recipe.training_data),
        (VALIDATION_DATA_FOLDER, recipe.validation_data),
    ):
        generate_dataset(out / folder, settings, workers, progress=progress, device="auto")
    notify("2 of 3: calibrate every simulated sensor and train the network")
    train_on_dataset(
        out / TRAINING_DATA_FOLDER,
        out / _TRAINING_FOLDER,
        match_input_width_to_dataset(replace(DEFAULT_TRAINING, epochs=recipe.epochs), out / TRAINING_DATA_FOLDER),
        HeldOutSettings(recipe.held_out),
        workers=workers,
        name=name,
        machine=ComputeSettings(precision=recipe.precision),
        progress=progress,
        notify=notify,
    )
    notify("3 of 3: validate on sensors and objects that were not trained on")
    trained = out / _TRAINING_FOLDER / MODEL_FILE
    card = read_force_model(trained).card
    tables = evaluate_per_mechanics_kind(trained, out / VALIDATION_DATA_FOLDER, workers, progress, notify)
    card = msgspec.structs.replace(card, evaluation={**card.evaluation, **tables})
    rewrite_card(trained, card, out / _MODEL_FILE)
    write_file_atomically(out / _CARD_FILE, format_model_card(card).encode())
    sensor = find_dataset_sensor_folders(out / VALIDATION_DATA_FOLDER)[0]
    return ForceModelResult(out / _MODEL_FILE, out / _CARD_FILE, sensor, card)
