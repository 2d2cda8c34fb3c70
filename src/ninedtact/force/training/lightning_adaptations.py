"""Adaptations of Lightning for training: checkpoints, metrics, progress bar, interrupts and log messages.

Checkpoints are written atomically and read without running code in them. Ctrl-C raises `TrainingStopped`. The metrics of every
epoch are kept in a CSV file, one progress bar covers all epochs, and Lightning's advice is suppressed.
"""

import csv
import logging
import signal
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from io import BytesIO, StringIO
from pathlib import Path
from time import monotonic
from typing import Any
from warnings import catch_warnings, filterwarnings

import torch
from lightning import Callback, LightningModule, Trainer
from lightning.fabric.plugins.io.torch_io import TorchCheckpointIO

from ninedtact.atomic_write import write_file_atomically
from ninedtact.errors import FileFormatError, ForceError
from ninedtact.force.training.training_module import MONITORED_METRIC

EpochMetrics = dict[str, float]


class CheckpointDamaged(FileFormatError):
    """The checkpoint of an earlier run cannot be read."""


class TrainingStopped(ForceError):
    """Ctrl-C ended the training before its last epoch."""


class AtomicCheckpointIO(TorchCheckpointIO):
    """Lightning plugin that writes checkpoints atomically."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Write the checkpoint; raises `FileNotWritten`."""
        content = BytesIO()
        torch.save(checkpoint, content)
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        write_file_atomically(path, content.getbuffer())


def resumable_checkpoint(path: Path) -> str | None:
    """Return the path of the last checkpoint of an earlier run, None without one; raises `CheckpointDamaged`."""
    if not path.is_file():
        return None
    load_checkpoint(path)
    return str(path)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint, plain values and weights alone, without running code in it; raises `CheckpointDamaged`."""
    try:
        return dict(torch.load(path, map_location="cpu", weights_only=True))
    except Exception as trouble:  # torch raises many kinds of error for a damaged file
        reason = (str(trouble).splitlines() or [""])[0]
        raise CheckpointDamaged(
            f"expected a checkpoint of this program in {path}, got: {reason}; remove it to begin again"
        ) from trouble


@contextmanager
def interrupt_as_training_stopped(out: Path) -> Iterator[None]:
    """Raise `TrainingStopped` at Ctrl-C; Lightning itself would end the whole program and ignore further signals."""
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    except (SystemExit, KeyboardInterrupt):
        raise TrainingStopped(
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
    """Lightning callback that shows one bar over all epochs with the remaining time."""

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Show the bar, advanced by the epochs of an earlier run."""
        from tqdm import tqdm

        batches = int(trainer.num_training_batches)
        self.bar = tqdm(
            total=(trainer.max_epochs or 0) * batches, initial=trainer.current_epoch * batches, unit="batch"
        )

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        """Advance the bar by one batch."""
        self.bar.update()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Show the losses of the epoch."""
        losses = {name: f"{float(trainer.callback_metrics[name]):.3f}" for name in ("train_loss", MONITORED_METRIC)}
        self.bar.set_postfix(epoch=trainer.current_epoch + 1, **losses)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Close the bar at the end."""
        self.bar.close()

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        """Close the bar after an error."""
        if hasattr(self, "bar"):
            self.bar.close()
