"""Training of a force model: examples and settings go in, one folder with the model comes out (`train_network`).

settings.json              the settings, and a digest of the examples
checkpoints/               the best and the last epoch
metrics.csv, curves.png    losses and errors of every epoch
tensorboard/               the same metrics for TensorBoard
model.onnx                 the model with its card, written last
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
import torch
from lightning import Callback, LightningDataModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import TensorBoardLogger
from numpy import ndarray as Array
from torch.utils.data import DataLoader
from tqdm import tqdm

from ninedtact.atomic_write import write_file_atomically
from ninedtact.force.onnx_model import ForceModel
from ninedtact_train.dataset.folder import begin_or_resume_folder
from ninedtact_train.dataset.split import SplitRows
from ninedtact_train.evaluation import WrenchEvaluation
from ninedtact_train.evaluation.report import plot_training_curves
from ninedtact_train.training.compute_settings import ComputeSettings
from ninedtact_train.training.error_scale_and_model_card import TrainedNetwork
from ninedtact_train.training.examples import (
    SeededBatchSampler,
    TrainingBatch,
    TrainingExamples,
    make_data_loader,
    move_examples_to_torque_point,
    require_trainable_examples,
)
from ninedtact_train.training.onnx_export import export_model
from ninedtact_train.training.settings import TrainingSettings
from ninedtact_train.training.training_module import (
    MONITORED_METRIC,
    AtomicCheckpointIO,
    ForceTrainingModule,
    MetricsHistory,
    TrainingProgressBar,
    fit_label_scaling,
    interrupt_as_training_stopped,
    load_checkpoint,
    resumable_checkpoint,
    silence_lightning,
)

MODEL_FILE, _CURVES_FILE, _METRICS_FILE = "model.onnx", "curves.png", "metrics.csv"
CHECKPOINT_FOLDER, _TENSORBOARD_FOLDER = "checkpoints", "tensorboard"
_BEST_CHECKPOINT, _LAST_CHECKPOINT = "best", "last"
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
    `ForceEstimationError`, `FileFormatError`, `FileNotWritten`.
    """
    require_trainable_examples(examples, rows, settings.input)
    begin_or_resume_folder(out, {**settings.to_json_dict(), "examples": _digest_examples(examples, rows), "name": name})
    examples = move_examples_to_torque_point(examples, settings.about_mm)
    module = ForceTrainingModule(settings, fit_label_scaling(examples.labels[rows.train], settings))
    fitted = fit_network(module, examples, rows, out, machine, progress)
    if not fitted.trainer.is_global_zero:
        return None
    network = module.model.to(fitted.trainer.strategy.root_device).eval()
    trained = TrainedNetwork(network, examples, rows, settings)
    trained.calibrate_scale()
    evaluation = trained.evaluate_held_out()
    card = trained.build_card(evaluation, fitted.history, name, licence)
    curves = plot_training_curves(fitted.history.epochs, MONITORED_METRIC, trained.median_mae, card.training.best_epoch)
    write_file_atomically(out / _CURVES_FILE, curves)
    return TrainingResult(out / MODEL_FILE, export_model(out / MODEL_FILE, network, card), evaluation)


def _digest_examples(examples: TrainingExamples, rows: SplitRows) -> dict[str, Any]:
    """Return the number of pairs and digests, by which a training is continued only with the same examples.

    Of images, references and tractions, which may be large, at most `_MAX_DIGESTED_IMAGES` each are read.
    """
    wrenches = (examples.wrench, rows.train, rows.test)
    inputs = (examples.images, examples.references, examples.tractions)
    sampled = (part if part is None else part[:: -(-len(part) // _MAX_DIGESTED_IMAGES)] for part in inputs)
    others = (*sampled, examples.reference_of, examples.sensor_features, examples.physics)
    return {"pairs": len(examples), "wrenches": _digest_arrays(wrenches), "inputs": _digest_arrays(others)}


def _digest_arrays(arrays: Iterable[Array | None]) -> str:
    """Return a digest of the numbers of arrays, of which some may be missing."""
    digest = blake2b(digest_size=8)
    for array in arrays:
        digest.update(b"" if array is None else np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


@dataclass(frozen=True)
class _FitResult:
    """Lightning's trainer after the last epoch, and the metrics of all epochs."""

    trainer: Trainer
    history: MetricsHistory


def fit_network(
    module: ForceTrainingModule,
    examples: TrainingExamples,
    rows: SplitRows,
    out: Path,
    machine: ComputeSettings,
    progress: bool = False,
) -> _FitResult:
    """Optimise the network, from the start or from the last checkpoint in `out`, and load its best weights into `module`.

    Raises `ForceEstimationError`, `FileFormatError`.
    """
    folder = out / CHECKPOINT_FOLDER
    history = MetricsHistory(out / _METRICS_FILE)
    last = folder / f"{_LAST_CHECKPOINT}.ckpt"
    with (
        interrupt_as_training_stopped(out),
        silence_lightning(),
        _subnormal_numbers_as_zero(),
        tqdm(unit="batch", disable=not progress) as bar,
    ):
        trainer = _build_trainer(module, [history, TrainingProgressBar(bar)], out, machine)
        data = _ExamplesDataModule(module.settings, examples, rows, machine.loader_workers)
        trainer.fit(module, datamodule=data, ckpt_path=resumable_checkpoint(last), weights_only=True)
    module.load_state_dict(load_checkpoint(folder / f"{_BEST_CHECKPOINT}.ckpt")["state_dict"])
    return _FitResult(trainer, history)


@contextmanager
def _subnormal_numbers_as_zero() -> Iterator[None]:
    """Have the processor take numbers for zero that are too small to be normal.

    Gradients of skin that nothing touches underflow, and processors multiply such numbers many times more slowly.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


def _build_trainer(
    module: ForceTrainingModule, callbacks: Sequence[Callback], out: Path, machine: ComputeSettings
) -> Trainer:
    """Return a Lightning trainer that writes to `out` alone."""
    checkpoints = _MovableModelCheckpoint(
        out / CHECKPOINT_FOLDER,
        filename=_BEST_CHECKPOINT,
        monitor=MONITORED_METRIC,
        save_last=True,
        enable_version_counter=False,
        save_on_train_epoch_end=True,
    )
    return Trainer(
        accelerator=machine.accelerator,
        devices=machine.devices,
        num_nodes=machine.nodes,
        strategy=machine.strategy,
        precision=machine.precision,
        max_epochs=module.settings.epochs,
        logger=TensorBoardLogger(str(out), name=_TENSORBOARD_FOLDER, version=""),
        callbacks=[*callbacks, checkpoints],
        plugins=[AtomicCheckpointIO()],
        default_root_dir=str(out),
        use_distributed_sampler=False,
        num_sanity_val_steps=0,
        enable_progress_bar=False,
        enable_model_summary=False,
    )


class _MovableModelCheckpoint(ModelCheckpoint):
    """Lightning's checkpoints of the best and the last epoch, in a folder that may be moved or copied between two runs.

    Lightning itself forgets which epoch was the best when the path of the folder differs.
    """

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore what a checkpoint says of the best epoch, with the paths that its files have now."""
        paths = ("best_model_path", "kth_best_model_path", "last_model_path")
        moved = {name: self._present_path(state_dict[name]) for name in paths}
        scores = {self._present_path(path): score for path, score in state_dict["best_k_models"].items()}
        super().load_state_dict({**state_dict, **moved, "best_k_models": scores, "dirpath": self.dirpath})

    def _present_path(self, path: str) -> str:
        """Return the path in the present folder of a checkpoint that was written with another path; empty paths stay empty."""
        return str(Path(self.dirpath or "", Path(path).name)) if path else path


class _ExamplesDataModule(LightningDataModule):
    """The examples of a training as Lightning's data module; each process loads its own share."""

    def __init__(self, settings: TrainingSettings, examples: TrainingExamples, rows: SplitRows, workers: int) -> None:
        super().__init__()
        self.settings, self.examples, self.rows, self.workers = settings, examples, rows, workers

    def train_dataloader(self) -> DataLoader[TrainingBatch]:
        """Return the shuffled training batches of this process."""
        return self._make_loader(self.rows.train, self.settings.seed)

    def val_dataloader(self) -> DataLoader[TrainingBatch]:
        """Return the validation batches of this process, in order."""
        return self._make_loader(self.rows.test, None)

    def _make_loader(self, rows: Any, seed: int | None) -> DataLoader[TrainingBatch]:
        """Return a loader of this process's share of the rows."""
        assert self.trainer is not None
        rank, world = self.trainer.global_rank, self.trainer.world_size
        sampler = SeededBatchSampler(rows, self.settings.batch, seed, rank, world)
        return make_data_loader(self.examples, sampler, self.workers)
