"""The folder of a training: begun once, and known again.

settings.json    what was asked for     metrics.csv, curves.png    every epoch     tensorboard/    the same for TensorBoard
checkpoints/     best and last epoch    model.onnx                 what comes of it, last of all

All steps of learning, by Lightning: kept after every epoch, gone on with after a stop.

Examples → a force model in one file: learn, set the errors right, export, say how good it is on what was held out.
"""

import json
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

import numpy as np
from lightning import LightningDataModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import TensorBoardLogger
from torch.utils.data import DataLoader

from ninedtact.atomic_write import FileNotWritten, write_file_atomically
from ninedtact.errors import NinedtactError
from ninedtact.force.evaluation import WrenchEvaluation
from ninedtact.force.evaluation.plots import plot_training_curves
from ninedtact.force.model_file import ForceModel
from ninedtact.force.splits import Rows
from ninedtact.force.training.examples import (
    SeededBatchSampler,
    TrainingBatch,
    TrainingExamples,
    make_data_loader,
    move_torque_reference,
    require_trainable,
)
from ninedtact.force.training.lightning_compat import (
    AtomicCheckpointIO,
    MetricsHistory,
    ProgressBar,
    interrupt_as_training_stopped,
    load_checkpoint,
    resumable_checkpoint,
    silence_lightning,
)
from ninedtact.force.training.onnx_export import export_model
from ninedtact.force.training.settings import ComputeSettings, TrainingSettings
from ninedtact.force.training.trained_network import TrainedNetwork
from ninedtact.force.training.training_module import MONITORED_METRIC, ForceTrainingModule, fit_label_scaling

_SETTINGS_FILE, MODEL_FILE, _CURVES_FILE = "settings.json", "model.onnx", "curves.png"


class TrainingFolderTaken(NinedtactError):
    """A folder that holds something else, or another training."""


def _begin_training_folder(out: Path, asked: dict[str, Any]) -> None:
    """Make the folder, or see that it holds an earlier run of the same; raises `TrainingFolderTaken`, `FileNotWritten`."""
    wanted = json.loads(json.dumps(asked))
    if (out / _SETTINGS_FILE).is_file():
        _require_same_training(out, wanted)
        return
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise TrainingFolderTaken(
            f"expected an empty folder or a training to go on with, got {out}, which holds something else; give another"
        )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as trouble:
        raise FileNotWritten(
            f"expected to make the folder {out}, got: {trouble.strerror or trouble}; correct the path or its permissions"
        ) from trouble
    write_file_atomically(out / _SETTINGS_FILE, json.dumps(wanted, indent=1).encode())


def _require_same_training(out: Path, wanted: dict[str, Any]) -> None:
    """Refuse to go on with something else."""
    try:
        found = json.loads((out / _SETTINGS_FILE).read_text())
    except (OSError, ValueError):
        found = {}
    differing = sorted(name for name in {*found, *wanted} if found.get(name) != wanted.get(name))
    if differing:
        raise TrainingFolderTaken(
            f"expected the training that {out} was begun with, got another {', '.join(differing)}; give the same data and "
            "options to go on, or another folder"
        )


CHECKPOINT_FOLDER, BEST_FILE, LAST_FILE = "checkpoints", "best", "last"
METRICS, BOARD = "metrics.csv", "tensorboard"


@dataclass(frozen=True)
class FitResult:
    """What Lightning leaves."""

    trainer: Trainer
    history: MetricsHistory


def fit_network(
    learner: ForceTrainingModule,
    examples: TrainingExamples,
    rows: Rows,
    out: Path,
    machine: ComputeSettings,
    progress: bool = False,
) -> FitResult:
    """Learn, from the start or from where an earlier run in `out` was stopped, and leave the best weights in `learner`.

    Raises `TrainingStopped`, `CheckpointDamaged`.
    """
    folder = out / CHECKPOINT_FOLDER
    history = MetricsHistory(out / METRICS)
    trainer = _build_trainer(learner, history, out, machine, progress)
    before = folder / f"{LAST_FILE}.ckpt"
    with interrupt_as_training_stopped(out), silence_lightning():
        data = _ExamplesDataModule(learner, examples, rows, machine.workers)
        trainer.fit(learner, datamodule=data, ckpt_path=resumable_checkpoint(before), weights_only=True)
    learner.load_state_dict(load_checkpoint(folder / f"{BEST_FILE}.ckpt")["state_dict"])
    return FitResult(trainer, history)


def _build_trainer(
    learner: ForceTrainingModule, history: MetricsHistory, out: Path, machine: ComputeSettings, progress: bool
) -> Trainer:
    """Lightning's, writing below `out` alone."""
    kept = ModelCheckpoint(
        out / CHECKPOINT_FOLDER,
        filename=BEST_FILE,
        monitor=MONITORED_METRIC,
        save_last=True,
        enable_version_counter=False,
        save_on_train_epoch_end=True,
    )
    with silence_lightning():
        return Trainer(
            accelerator=machine.accelerator,
            devices=machine.devices,
            num_nodes=machine.nodes,
            strategy=machine.strategy,
            precision=machine.precision,
            max_epochs=learner.settings.epochs,
            logger=TensorBoardLogger(str(out), name=BOARD, version=""),
            callbacks=[history, kept, *([ProgressBar()] if progress else [])],
            plugins=[AtomicCheckpointIO()],
            default_root_dir=str(out),
            use_distributed_sampler=False,
            num_sanity_val_steps=0,
            enable_progress_bar=False,
            enable_model_summary=False,
        )


class _ExamplesDataModule(LightningDataModule):
    """TrainingExamples as Lightning asks for them."""

    def __init__(self, learner: ForceTrainingModule, examples: TrainingExamples, rows: Rows, workers: int) -> None:
        super().__init__()
        self.settings, self.examples, self.parts, self.workers = learner.settings, examples, rows, workers

    def train_dataloader(self) -> DataLoader[TrainingBatch]:
        """Shuffled, this process's share."""
        return make_data_loader(self.examples, self.order(self.parts.train, self.settings.seed), self.workers)

    def val_dataloader(self) -> DataLoader[TrainingBatch]:
        """In order, this process's share."""
        return make_data_loader(self.examples, self.order(self.parts.test, None), self.workers)

    def order(self, rows: Any, seed: int | None) -> SeededBatchSampler:
        """Of this process."""
        assert self.trainer is not None
        return SeededBatchSampler(rows, self.settings.batch, seed, self.trainer.global_rank, self.trainer.world_size)


@dataclass(frozen=True)
class TrainingResult:
    """A model, and how good it is on what was held out."""

    path: Path
    model: ForceModel
    evaluation: WrenchEvaluation


def train_network(
    examples: TrainingExamples,
    rows: Rows,
    settings: TrainingSettings,
    out: Path,
    *,
    name: str = "network",
    licence: str = "MIT",
    machine: ComputeSettings = ComputeSettings(),
    progress: bool = False,
) -> TrainingResult | None:
    """Learn from `rows.train`, keep the epoch that is best on `rows.test`; begun again after a stop, it goes on.

    None on all processes of a training but the first. Raises `ExamplesUnusable`, `FolderTaken`, `TrainingStopped`,
    `CheckpointDamaged`, `FileNotWritten`.
    """
    require_trainable(examples, rows, settings.input)
    _begin_training_folder(
        out, {"settings": settings.as_table(), "examples": _examples_digest(examples, rows), "name": name}
    )
    learnt = move_torque_reference(examples, settings.about_mm)
    learner = ForceTrainingModule(settings, fit_label_scaling(learnt.wrench[rows.train], settings))
    fitted = fit_network(learner, learnt, rows, out, machine, progress)
    if not fitted.trainer.is_global_zero:
        return None
    lesson = TrainedNetwork(learner.model.to(fitted.trainer.strategy.root_device).eval(), learnt, rows, settings)
    lesson.set_errors_right()
    evaluation = lesson.evaluation
    card = lesson.card(evaluation, fitted.history, name, licence)
    curves = plot_training_curves(fitted.history.rows, MONITORED_METRIC, lesson.median_mae, card.training.best_epoch)
    write_file_atomically(out / _CURVES_FILE, curves)
    return TrainingResult(out / MODEL_FILE, export_model(out / MODEL_FILE, lesson.network, card), evaluation)


def _examples_digest(examples: TrainingExamples, rows: Rows) -> dict[str, Any]:
    """By which a stopped training knows its examples again."""
    told = blake2b(digest_size=8)
    for part in (examples.wrench, rows.train, rows.test):
        told.update(np.ascontiguousarray(part).tobytes())
    return {"pairs": len(examples), "wrenches": told.hexdigest()}
