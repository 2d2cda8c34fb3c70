"""The Lightning module of a force model's training (augmentation, the network, its loss and its optimiser), and adaptations of
Lightning: checkpoints, metrics, progress bar, interrupts and log messages.

Checkpoints are written atomically and read without running code in them. Ctrl-C raises `ForceEstimationError`. The metrics of every
epoch are kept in a CSV file, one progress bar covers all epochs, and Lightning's advice is suppressed.
"""

import csv
import logging
import signal
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from io import BytesIO, StringIO
from pathlib import Path
from time import monotonic
from typing import Any
from warnings import catch_warnings, filterwarnings

import lightning
import numpy as np
import torch
from jaxtyping import Float32
from lightning import Callback, LightningModule, Trainer
from lightning.fabric.plugins.io.torch_io import TorchCheckpointIO
from numpy import ndarray as Array
from torch import Tensor

from ninedtact.atomic_write import write_file_atomically
from ninedtact.errors import FileFormatError, ForceEstimationError
from ninedtact.quantities import WRENCH_AXES
from ninedtact_train.training.examples import TrainingBatch
from ninedtact_train.training.networks import LabelScale, WrenchNetwork
from ninedtact_train.training.settings import TrainingSettings

MONITORED_METRIC = "val_loss"
"""Metric by which the best epoch is chosen: the mean absolute error on held-out pairs, in units of the labels."""
_SMALLEST_UNIT = 1e-9
_WARM_UP_SHARE = 0.1
"""Part of all training steps in which the learning rate of one cycle rises."""


def fit_label_scaling(wrench: Float32[Array, "n 6"], settings: TrainingSettings) -> LabelScale:
    """Return unit and offset of each axis of the network's output, from the wrenches (N, N·m) of the training pairs."""
    if settings.labels == "ranges":
        low, high = wrench.min(0), wrench.max(0)
        unit, offset = high - low, low
    else:
        unit, offset = np.abs(wrench - np.median(wrench, axis=0)).mean(0), np.zeros(6)
    kept = np.maximum(unit, _SMALLEST_UNIT)
    return LabelScale(tuple(kept.astype(float).tolist()), tuple(offset.astype(float).tolist()))


@dataclass(frozen=True)
class _BatchLoss:
    """Loss of each example and axis of a batch, in units of the labels."""

    absolute_error: Tensor
    """Absolute errors of the predicted wrenches (n, 6)."""
    scale_loss: Tensor | None
    """Negative log-likelihood (n, 6) of the predicted Laplace scale, up to a constant, without a gradient to the predicted wrench;
    None for networks that predict no scale."""

    def total(self, scale_weight: float) -> Tensor:
        """The sum of absolute errors, as in the paper, plus the weighted loss of the scale."""
        total = self.absolute_error.sum()
        return total if self.scale_loss is None else total + scale_weight * self.scale_loss.sum()


def compute_batch_loss(prediction: tuple[Tensor, ...], wrench: Tensor, unit: Tensor) -> _BatchLoss:
    """Return the loss of predicted wrenches, and of their scales where they are predicted, for the true wrenches (N, N·m)."""
    absolute_error = ((prediction[0] - wrench) / unit).abs()
    if len(prediction) == 1:
        return _BatchLoss(absolute_error, None)
    scale = prediction[1] / unit
    return _BatchLoss(absolute_error, absolute_error.detach() / scale + scale.log())


class ForceTrainingModule(lightning.LightningModule):
    """The network in training, with its loss and optimiser."""

    def __init__(self, settings: TrainingSettings, labels: LabelScale) -> None:
        super().__init__()
        self.settings = settings
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.model = WrenchNetwork(settings.network, settings.input, labels, with_scale=settings.scale_weight > 0)
        self.model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def training_step(self, batch: TrainingBatch, number: int) -> Tensor:
        """Return the loss of a batch, which is augmented with a random generator of its own."""
        settings = self.settings
        # Labels, and the positions that pixels are resampled from, need full precision.
        with torch.no_grad(), torch.autocast(self.device.type, enabled=False):
            augmented = self.augment(batch.to_float(), self._batch_generator(number))
            shown = augmented.network_input(settings.input.channels)
        loss = compute_batch_loss(self.model(shown), augmented.wrench, self.model.unit)
        self.log(
            "train_loss",
            loss.absolute_error.mean(),
            on_step=False,
            on_epoch=True,
            batch_size=len(batch.wrench),
            sync_dist=True,
        )
        return loss.total(settings.scale_weight)

    def validation_step(self, batch: TrainingBatch, number: int) -> None:
        """Log mean absolute errors: over all axes in units of the labels, and by axis in N and N·m."""
        shown = batch.to_float().network_input(self.settings.input.channels)
        loss = compute_batch_loss(self.model(shown), batch.wrench, self.model.unit)
        by_axis = (loss.absolute_error.mean(0) * self.model.unit).unbind()
        metrics = {f"mae_{axis}": mae for axis, mae in zip(WRENCH_AXES, by_axis, strict=True)}
        self.log_dict(
            {MONITORED_METRIC: loss.absolute_error.mean(), **metrics}, batch_size=len(batch.wrench), sync_dist=True
        )

    def augment(self, batch: TrainingBatch, generator: torch.Generator) -> TrainingBatch:
        """Return the batch, randomly changed. Torques are moved to the skin's centre for it, about which images are mirrored."""
        settings = self.settings
        x, y, z = settings.about_mm
        changed = settings.augmentation(batch.about((-x, -y, -z)), settings.input.mm_per_px, generator)
        return changed.about(settings.about_mm)

    def _batch_generator(self, number: int) -> torch.Generator:
        """Return the random generator of one batch; its seed is the same when a training is resumed."""
        seeds = np.random.SeedSequence([self.settings.seed, self.current_epoch, number, self.global_rank])
        return torch.Generator(self.device).manual_seed(int(seeds.generate_state(1)[0]))

    def configure_optimizers(self) -> Any:
        """Return the optimiser and the learning-rate schedule of the settings."""
        settings = self.settings
        kind = torch.optim.AdamW if settings.optimiser == "adamw" else torch.optim.Adam
        optimiser = kind(self.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay)
        if settings.schedule == "constant":
            return optimiser
        steps = int(self.trainer.estimated_stepping_batches)
        # OneCycleLR divides by zero where the rise takes exactly one step.
        warm_up_share = _WARM_UP_SHARE if _WARM_UP_SHARE * steps != 1 else 1.1 * _WARM_UP_SHARE
        rate = torch.optim.lr_scheduler.OneCycleLR(optimiser, settings.learning_rate, steps, pct_start=warm_up_share)
        return {"optimizer": optimiser, "lr_scheduler": {"scheduler": rate, "interval": "step"}}


EpochMetrics = dict[str, float]


class AtomicCheckpointIO(TorchCheckpointIO):
    """Lightning plugin that writes checkpoints atomically."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Write the checkpoint; raises `FileNotWritten`."""
        content = BytesIO()
        torch.save(checkpoint, content)
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        write_file_atomically(path, content.getvalue())


def resumable_checkpoint(path: Path) -> str | None:
    """Return the path of the last checkpoint of an earlier run, None without one; raises `FileFormatError`."""
    if not path.is_file():
        return None
    load_checkpoint(path)
    return str(path)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint, plain values and weights alone, without running code in it; raises `FileFormatError`."""
    try:
        return dict(torch.load(path, map_location="cpu", weights_only=True))
    except Exception as trouble:  # torch raises many kinds of error for a damaged file
        reason = (str(trouble).splitlines() or [""])[0]
        raise FileFormatError(
            f"expected a checkpoint of this program in {path}, got: {reason}; remove it to begin again"
        ) from trouble


@contextmanager
def interrupt_as_training_stopped(out: Path) -> Iterator[None]:
    """Raise `ForceEstimationError` at Ctrl-C; Lightning itself would end the whole program and ignore further signals."""
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    except (SystemExit, KeyboardInterrupt):
        raise ForceEstimationError(
            f"stopped by Ctrl-C; the last complete epoch is kept in {out}; run the command again to continue"
        ) from None
    finally:
        if signal.getsignal(signal.SIGINT) is not before:
            signal.signal(signal.SIGINT, before)


@contextmanager
def silence_loggers(*names: str, warnings_of: str) -> Iterator[None]:
    """Suppress the messages of these loggers, and the warnings of modules that match `warnings_of`, while the block runs."""
    loggers = [logging.getLogger(name) for name in names]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with catch_warnings():
            filterwarnings("ignore", module=warnings_of)
            yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def silence_lightning() -> AbstractContextManager[None]:
    """Suppress Lightning's advice and warnings."""
    return silence_loggers("lightning.pytorch", "lightning.fabric", warnings_of="lightning")


class MetricsHistory(Callback):
    """Lightning callback that keeps the metrics of every epoch, writes them to a CSV file, and resumes with a checkpoint."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.epochs: list[EpochMetrics] = []
        self._earlier_s, self._started_s = 0.0, monotonic()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Add the epoch's metrics and write the file; raises `FileNotWritten`."""
        metrics = {name: float(value) for name, value in trainer.callback_metrics.items()}
        rate = trainer.optimizers[0].param_groups[0]["lr"]
        epoch = trainer.current_epoch + 1
        self.epochs.append({"epoch": epoch, **metrics, "learning_rate": rate, "seconds": self.seconds})
        if trainer.is_global_zero:
            write_file_atomically(self.path, _metrics_csv(self.epochs))

    @property
    def seconds(self) -> float:
        """Duration of the training so far, without the time between runs."""
        return self._earlier_s + monotonic() - self._started_s

    @property
    def best_epoch(self) -> EpochMetrics:
        """The metrics of the best epoch."""
        return min(self.epochs, key=lambda metrics: metrics[MONITORED_METRIC])

    def state_dict(self) -> dict[str, Any]:
        """Return the history for a checkpoint."""
        return {"epochs": self.epochs, "seconds": self.seconds}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the history from a checkpoint."""
        self.epochs, self._earlier_s = list(state_dict["epochs"]), float(state_dict["seconds"])
        self._started_s = monotonic()


def _metrics_csv(epochs: list[EpochMetrics]) -> bytes:
    """Return a CSV table with a header and a row for every epoch."""
    text = StringIO()
    table = csv.DictWriter(text, list(epochs[0]), lineterminator="\n")
    table.writeheader()
    table.writerows({name: f"{value:.6g}" for name, value in metrics.items()} for metrics in epochs)
    return text.getvalue().encode()


class TrainingProgressBar(Callback):
    """Lightning callback that advances one bar over all epochs, with the remaining time."""

    def __init__(self, bar: Any) -> None:
        self.bar = bar

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Begin the bar, advanced by the epochs of an earlier run."""
        batches = int(trainer.num_training_batches)
        self.bar.reset((trainer.max_epochs or 0) * batches)
        self.bar.update(trainer.current_epoch * batches)

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        """Advance the bar by one batch."""
        self.bar.update()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Show the losses of the epoch."""
        losses = {name: f"{float(trainer.callback_metrics[name]):.3f}" for name in ("train_loss", MONITORED_METRIC)}
        self.bar.set_postfix(epoch=trainer.current_epoch + 1, **losses)
