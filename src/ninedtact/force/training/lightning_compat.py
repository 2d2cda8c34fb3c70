"""Checkpoints: written whole, read without running anything in them.

Lightning's manners, mended: a stop is a sentence, and advice is not given.

What is noted of every epoch, in `metrics.csv` and for the curves; it goes on after a stop.
"""

import csv
import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO, StringIO
from pathlib import Path
from time import monotonic
from typing import Any
from warnings import catch_warnings, filterwarnings

import torch
from lightning import Callback, LightningModule, Trainer
from lightning.fabric.plugins.io.torch_io import TorchCheckpointIO

from ninedtact.atomic_write import write_file_atomically
from ninedtact.errors import NinedtactError
from ninedtact.force.training.training_module import MONITORED_METRIC


class CheckpointDamaged(NinedtactError):
    """What an earlier run left cannot be gone on with."""


class AtomicCheckpointIO(TorchCheckpointIO):
    """Checkpoints appear whole or not at all."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        """Raises `FileNotWritten`."""
        content = BytesIO()
        torch.save(checkpoint, content)
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        write_file_atomically(path, content.getbuffer())


def resumable_checkpoint(path: Path) -> str | None:
    """The last checkpoint of an earlier run; raises `CheckpointDamaged`."""
    if not path.is_file():
        return None
    load_checkpoint(path)
    return str(path)


def load_checkpoint(path: Path) -> dict[str, Any]:
    """What a checkpoint holds: plain values and weights alone; raises `CheckpointDamaged`."""
    try:
        return dict(torch.load(path, map_location="cpu", weights_only=True))
    except Exception as trouble:  # whatever torch meets in a damaged file
        said = (str(trouble).splitlines() or [""])[0]
        raise CheckpointDamaged(
            f"expected a checkpoint of this program in {path}, got: {said}; remove it to begin again"
        ) from trouble


class TrainingStopped(NinedtactError):
    """Ctrl-C ended the training before its last epoch."""


@contextmanager
def interrupt_as_training_stopped(out: Path) -> Iterator[None]:
    """Ctrl-C as `TrainingStopped`: Lightning itself would end the whole program, deaf to further signals."""
    before = signal.getsignal(signal.SIGINT)
    try:
        yield
    except (SystemExit, KeyboardInterrupt):
        raise TrainingStopped(
            f"stopped by Ctrl-C; what was learnt up to the last whole epoch is kept in {out}; run the command again to go on"
        ) from None
    finally:
        if signal.getsignal(signal.SIGINT) is not before:
            signal.signal(signal.SIGINT, before)


@contextmanager
def silence_lightning() -> Iterator[None]:
    """Without Lightning's advice."""
    names = ("lightning.pytorch", "lightning.fabric")
    before = [logging.getLogger(name).level for name in names]
    for name in names:
        logging.getLogger(name).setLevel(logging.ERROR)
    try:
        with catch_warnings():
            filterwarnings("ignore", module="lightning")
            yield
    finally:
        for name, level in zip(names, before, strict=True):
            logging.getLogger(name).setLevel(level)


MetricsRow = dict[str, float]


class MetricsHistory(Callback):
    """A row for every epoch."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: list[MetricsRow] = []
        self.before_s, self.began_s = 0.0, monotonic()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Note it; raises `FileNotWritten`."""
        told = {name: float(value) for name, value in trainer.callback_metrics.items()}
        rate = trainer.optimizers[0].param_groups[0]["lr"]
        row = {"epoch": trainer.current_epoch + 1, **told, "learning_rate": rate, "seconds": self.seconds}
        self.rows.append(row)
        if trainer.is_global_zero:
            write_file_atomically(self.path, _metrics_csv(self.rows))

    @property
    def seconds(self) -> float:
        """Of training so far, pauses left out."""
        return self.before_s + monotonic() - self.began_s

    @property
    def best(self) -> MetricsRow:
        """The row of the best epoch."""
        return min(self.rows, key=lambda row: row[MONITORED_METRIC])

    def state_dict(self) -> dict[str, Any]:
        """Into the checkpoint."""
        return {"rows": self.rows, "seconds": self.seconds}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Out of it."""
        self.rows, self.before_s = list(state_dict["rows"]), float(state_dict["seconds"])
        self.began_s = monotonic()


def _metrics_csv(rows: list[MetricsRow]) -> bytes:
    """A table with a line of names."""
    text = StringIO()
    table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows({name: f"{value:.6g}" for name, value in row.items()} for row in rows)
    return text.getvalue().encode()


class ProgressBar(Callback):
    """A bar over all epochs, with the time that is left."""

    def on_train_start(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Draw it, as far as an earlier run came."""
        from tqdm import tqdm

        each = int(trainer.num_training_batches)
        self.bar = tqdm(total=(trainer.max_epochs or 0) * each, initial=trainer.current_epoch * each, unit="batch")

    def on_train_batch_end(self, trainer: Trainer, pl_module: LightningModule, *_: Any) -> None:
        """One more."""
        self.bar.update()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Say how good it is."""
        told = {name: f"{float(trainer.callback_metrics[name]):.3f}" for name in ("train_loss", MONITORED_METRIC)}
        self.bar.set_postfix(epoch=trainer.current_epoch + 1, **told)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Leave it."""
        self.bar.close()

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        """Leave it."""
        if hasattr(self, "bar"):
            self.bar.close()
