"""Training of a force model: examples and settings go in, one folder with the model comes out (`train_network`).

settings.json              the settings, and a digest of the examples
checkpoints/               the best and the last epoch
metrics.csv, curves.png    losses and errors of every epoch
tensorboard/               the same metrics for TensorBoard
model.onnx                 the model with its card, written last
"""

from collections.abc import Iterable
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray as Array

from ninedtact.atomic_write import write_file_atomically
from ninedtact.force.onnx_model import ForceModel
from ninedtact_train.dataset.folder import begin_or_resume_folder, interrupt_as_stopped
from ninedtact_train.dataset.split import SplitRows
from ninedtact_train.evaluation import WrenchEvaluation
from ninedtact_train.evaluation.report import plot_training_curves
from ninedtact_train.training.examples import TrainingExamples, require_trainable_examples
from ninedtact_train.training.onnx_export import export_model
from ninedtact_train.training.settings import ComputeSettings, TrainingSettings
from ninedtact_train.training.trained_network import TrainedNetwork
from ninedtact_train.training.training_loop import (
    MONITORED_METRIC,
    ForceTraining,
    fit_label_scaling,
    fit_network,
    launch_fabric,
)

MODEL_FILE, _CURVES_FILE = "model.onnx", "curves.png"
_MAX_DIGESTED_IMAGES = 1000
"""Largest number of images by which a training is recognised."""


@dataclass(frozen=True)
class TrainingResult:
    """A trained model and its evaluation on the held-out pairs."""

    path: Path
    model: ForceModel
    evaluation: WrenchEvaluation


def train_network(
    examples: TrainingExamples,
    rows: SplitRows,
    settings: TrainingSettings,
    out: Path,
    *,
    name: str = "network",
    licence: str = "MIT",
    machine: ComputeSettings = ComputeSettings(),
    progress: bool = False,
) -> TrainingResult | None:
    """Train on `rows.train`, select the epoch that is best on `rows.test`, and write the model and its curves to `out`.

    A training that was stopped continues after its last complete epoch when it is called again with the same arguments.
    Returns None in all processes of a distributed training but the first. Raises `ForceEstimationError`, `OutputError`,
    `DatasetError`, `FileFormatError`, `FileNotWritten`.
    """
    require_trainable_examples(examples, rows, settings.input)
    begin_or_resume_folder(out, {**settings.to_json_dict(), "examples": _digest_examples(examples, rows), "name": name})
    fabric = launch_fabric(machine)
    training = ForceTraining(settings, fit_label_scaling(examples.wrench[rows.train], settings))
    with interrupt_as_stopped(out):
        history = fit_network(fabric, training, examples, rows, out, progress=progress)
    if not fabric.is_global_zero:
        return None
    network = training.model.to(fabric.device).eval()
    trained = TrainedNetwork(network, examples, rows, settings)
    trained.calibrate_scale()
    evaluation = trained.evaluate_held_out()
    card = trained.build_card(evaluation, history, name, licence)
    curves = plot_training_curves(history.epochs, MONITORED_METRIC, trained.median_mae, card.training.best_epoch)
    write_file_atomically(out / _CURVES_FILE, curves)
    return TrainingResult(out / MODEL_FILE, export_model(out / MODEL_FILE, network, card), evaluation)


def _digest_examples(examples: TrainingExamples, rows: SplitRows) -> dict[str, Any]:
    """Return the number of pairs and digests, by which a training is continued only with the same examples.

    Of images and references, which may be large, at most `_MAX_DIGESTED_IMAGES` each are read.
    """
    wrenches = (examples.wrench, rows.train, rows.test)
    inputs = (examples.images, examples.references)
    sampled = (part if part is None else part[:: -(-len(part) // _MAX_DIGESTED_IMAGES)] for part in inputs)
    others = (*sampled, examples.reference_of, examples.sensor_features)
    return {"pairs": len(examples), "wrenches": _digest_arrays(wrenches), "inputs": _digest_arrays(others)}


def _digest_arrays(arrays: Iterable[Array | None]) -> str:
    digest = blake2b(digest_size=8)
    for array in arrays:
        digest.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
