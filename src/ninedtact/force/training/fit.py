"""All steps of learning, by Lightning: kept after every epoch, gone on with after a stop."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lightning import LightningDataModule, Trainer
from lightning.pytorch.callbacks import ModelCheckpoint
from lightning.pytorch.loggers import TensorBoardLogger
from torch.utils.data import DataLoader

from ninedtact.force.splits import Rows
from ninedtact.force.training.batches import Order, TouchBatch, loader
from ninedtact.force.training.checkpoints import WholeFiles, checkpoint, resumable
from ninedtact.force.training.examples import Examples
from ninedtact.force.training.history import History, Progress
from ninedtact.force.training.learner import BEST, Learner
from ninedtact.force.training.manners import quiet, stopped_politely
from ninedtact.force.training.settings import Machine

CHECKPOINTS, BEST_FILE, LAST_FILE = "checkpoints", "best", "last"
METRICS, BOARD = "metrics.csv", "tensorboard"


@dataclass(frozen=True)
class Fitted:
    """What Lightning leaves."""

    trainer: Trainer
    history: History


def fit(
    learner: Learner, examples: Examples, rows: Rows, out: Path, machine: Machine, progress: bool = False
) -> Fitted:
    """Learn, from the start or from where an earlier run in `out` was stopped, and leave the best weights in `learner`.

    Raises `TrainingStopped`, `CheckpointDamaged`.
    """
    folder = out / CHECKPOINTS
    history = History(out / METRICS)
    trainer = trainer_for(learner, history, out, machine, progress)
    before = folder / f"{LAST_FILE}.ckpt"
    with stopped_politely(out), quiet():
        data = Data(learner, examples, rows, machine.workers)
        trainer.fit(learner, datamodule=data, ckpt_path=resumable(before), weights_only=True)
    learner.load_state_dict(checkpoint(folder / f"{BEST_FILE}.ckpt")["state_dict"])
    return Fitted(trainer, history)


def trainer_for(learner: Learner, history: History, out: Path, machine: Machine, progress: bool) -> Trainer:
    """Lightning's, writing below `out` alone."""
    kept = ModelCheckpoint(
        out / CHECKPOINTS,
        filename=BEST_FILE,
        monitor=BEST,
        save_last=True,
        enable_version_counter=False,
        save_on_train_epoch_end=True,
    )
    with quiet():
        return Trainer(
            accelerator=machine.accelerator,
            devices=machine.devices,
            num_nodes=machine.nodes,
            strategy=machine.strategy,
            precision=machine.precision,
            max_epochs=learner.settings.epochs,
            logger=TensorBoardLogger(str(out), name=BOARD, version=""),
            callbacks=[history, kept, *([Progress()] if progress else [])],
            plugins=[WholeFiles()],
            default_root_dir=str(out),
            use_distributed_sampler=False,
            num_sanity_val_steps=0,
            enable_progress_bar=False,
            enable_model_summary=False,
        )


class Data(LightningDataModule):
    """Examples as Lightning asks for them."""

    def __init__(self, learner: Learner, examples: Examples, rows: Rows, workers: int) -> None:
        super().__init__()
        self.settings, self.examples, self.parts, self.workers = learner.settings, examples, rows, workers

    def train_dataloader(self) -> DataLoader[TouchBatch]:
        """Shuffled, this process's share."""
        return loader(self.examples, self.order(self.parts.train, self.settings.seed), self.workers)

    def val_dataloader(self) -> DataLoader[TouchBatch]:
        """In order, this process's share."""
        return loader(self.examples, self.order(self.parts.test, None), self.workers)

    def order(self, rows: Any, seed: int | None) -> Order:
        """Of this process."""
        assert self.trainer is not None
        return Order(rows, self.settings.batch, seed, self.trainer.global_rank, self.trainer.world_size)
