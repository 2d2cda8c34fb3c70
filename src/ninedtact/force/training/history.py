"""What is noted of every epoch, in `metrics.csv` and for the curves; it goes on after a stop."""

import csv
from io import StringIO
from pathlib import Path
from time import monotonic
from typing import Any

from lightning import Callback, LightningModule, Trainer

from ninedtact.atomic_write import write_file_atomically
from ninedtact.force.training.learner import BEST

Row = dict[str, float]


class History(Callback):
    """A row for every epoch."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: list[Row] = []
        self.before_s, self.began_s = 0.0, monotonic()

    def on_train_epoch_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Note it; raises `FileNotWritten`."""
        told = {name: float(value) for name, value in trainer.callback_metrics.items()}
        rate = trainer.optimizers[0].param_groups[0]["lr"]
        row = {"epoch": trainer.current_epoch + 1, **told, "learning_rate": rate, "seconds": self.seconds}
        self.rows.append(row)
        if trainer.is_global_zero:
            write_file_atomically(self.path, as_csv(self.rows))

    @property
    def seconds(self) -> float:
        """Of training so far, pauses left out."""
        return self.before_s + monotonic() - self.began_s

    @property
    def best(self) -> Row:
        """The row of the best epoch."""
        return min(self.rows, key=lambda row: row[BEST])

    def state_dict(self) -> dict[str, Any]:
        """Into the checkpoint."""
        return {"rows": self.rows, "seconds": self.seconds}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Out of it."""
        self.rows, self.before_s = list(state_dict["rows"]), float(state_dict["seconds"])
        self.began_s = monotonic()


def as_csv(rows: list[Row]) -> bytes:
    """A table with a line of names."""
    text = StringIO()
    table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows({name: f"{value:.6g}" for name, value in row.items()} for row in rows)
    return text.getvalue().encode()


class Progress(Callback):
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
        told = {name: f"{float(trainer.callback_metrics[name]):.3f}" for name in ("train_loss", BEST)}
        self.bar.set_postfix(epoch=trainer.current_epoch + 1, **told)

    def on_train_end(self, trainer: Trainer, pl_module: LightningModule) -> None:
        """Leave it."""
        self.bar.close()

    def on_exception(self, trainer: Trainer, pl_module: LightningModule, exception: BaseException) -> None:
        """Leave it."""
        if hasattr(self, "bar"):
            self.bar.close()
