"""The loop of a training: loss and optimisation steps, validation after every epoch, checkpoints, metrics and the progress bar.

Lightning Fabric runs it on any device, in several processes and at any precision. Checkpoints are written atomically and read
without running code in them; a training continues after the last one and then learns the same as without a stop.
"""

import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from time import monotonic
from typing import Any, cast
from warnings import catch_warnings, filterwarnings

import numpy as np
import torch
from jaxtyping import Float32
from lightning.fabric import Fabric
from numpy import ndarray as Array
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter
from tqdm import tqdm

from ninedtact.atomic_write import write_file_atomically
from ninedtact.csv_table import to_csv
from ninedtact.errors import FileFormatError
from ninedtact.quantities import WRENCH_AXES
from ninedtact_train.dataset.split import SplitRows
from ninedtact_train.training.augmentation import augment_batch
from ninedtact_train.training.examples import (
    TrainingBatch,
    TrainingExamples,
    move_torques_from_skin_centre,
    rows_of_batches,
)
from ninedtact_train.training.networks import LabelScale, WrenchNetwork
from ninedtact_train.training.settings import ComputeSettings, TrainingSettings
from ninedtact_train.training.weights_file import load_weights

MONITORED_METRIC = "val_loss"
"""Metric by which the best epoch is chosen: the mean absolute error on held-out pairs, in units of the labels."""
CHECKPOINT_FOLDER = "checkpoints"
_BEST_FILE, _LAST_FILE, _METRICS_FILE, _TENSORBOARD_FOLDER = "best.ckpt", "last.ckpt", "metrics.csv", "tensorboard"
_SMALLEST_UNIT = 1e-9
_WARM_UP_SHARE = 0.1
"""Part of all training steps in which the learning rate of one cycle rises."""

EpochMetrics = dict[str, float]


def fit_label_scaling(wrench: Float32[Array, "n 6"], settings: TrainingSettings) -> LabelScale:
    """Return unit and offset of each axis of the network's output.

    wrench: those of the training pairs, N and N·m about the skin's centre.
    """
    wrench = move_torques_from_skin_centre(wrench, settings.about_mm)
    if settings.labels == "ranges":
        low, high = wrench.min(0), wrench.max(0)
        unit, offset = high - low, low
    else:
        unit, offset = np.abs(wrench - np.median(wrench, axis=0)).mean(0), np.zeros(6)
    kept = np.maximum(unit, _SMALLEST_UNIT)
    return LabelScale(tuple(kept.astype(float).tolist()), tuple(offset.astype(float).tolist()))


@dataclass
class TrainingHistory:
    """The metrics of all epochs so far."""

    epochs: list[EpochMetrics] = field(default_factory=list)
    seconds: float = 0.0
    """Duration of the training, without the time between runs."""

    @property
    def best_epoch(self) -> EpochMetrics:
        """The metrics of the best epoch."""
        return min(self.epochs, key=lambda metrics: metrics[MONITORED_METRIC])


class ForceTraining:
    """A network in training: its loss and its optimiser."""

    def __init__(self, settings: TrainingSettings, labels: LabelScale) -> None:
        self.settings = settings
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.model = WrenchNetwork(settings.network, settings.input, labels, with_scale=settings.scale_weight > 0)
        self.model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def loss(self, network: Any, batch: TrainingBatch, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Return the loss of a batch, randomly changed, and its mean absolute error in units of the labels.

        The loss is the sum of absolute errors, as in the paper, and the weighted negative log-likelihood of the predicted Laplace
        scale, up to a constant, without a gradient to the predicted wrench. network: the model, as it is run on its device.
        """
        settings, unit = self.settings, self.model.unit
        with torch.no_grad():
            augmented = self.augment(batch.to_float(), generator)
            shown = augmented.network_input(settings.input.channels)
        wrench, *scales = network(shown)
        error = ((wrench - augmented.wrench) / unit).abs()
        total = error.sum()
        for scale in scales:
            relative = scale / unit
            total = total + settings.scale_weight * (error.detach() / relative + relative.log()).sum()
        return total, error.detach().mean()

    def augment(self, batch: TrainingBatch, generator: torch.Generator) -> TrainingBatch:
        """Return the batch, randomly changed, with torques about the settings' point."""
        changed = augment_batch(self.settings.augmentation, batch, self.settings.input.mm_per_px, generator)
        return changed.about(self.settings.about_mm)

    def validation_errors(self, network: Any, batch: TrainingBatch) -> Tensor:
        """Return mean absolute errors: over all axes in units of the labels, and by axis in N and N·m."""
        batch = batch.to_float().about(self.settings.about_mm)
        shown = batch.network_input(self.settings.input.channels)
        error = ((network(shown)[0] - batch.wrench) / self.model.unit).abs()
        return torch.cat([error.mean()[None], error.mean(0) * self.model.unit])

    def build_optimiser(self, steps: int) -> tuple[torch.optim.Optimizer, torch.optim.lr_scheduler.LRScheduler]:
        """Return the optimiser and its learning-rate schedule over this many steps."""
        settings = self.settings
        kind = torch.optim.AdamW if settings.optimiser == "adamw" else torch.optim.Adam
        optimiser = kind(self.model.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay)
        if settings.schedule == "constant":
            return optimiser, torch.optim.lr_scheduler.ConstantLR(optimiser, factor=1.0)
        # OneCycleLR divides by zero where the rise takes exactly one step.
        warm_up_share = _WARM_UP_SHARE if _WARM_UP_SHARE * steps != 1 else 1.1 * _WARM_UP_SHARE
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, settings.learning_rate, steps, pct_start=warm_up_share
        )
        return optimiser, schedule


def launch_fabric(machine: ComputeSettings) -> Fabric:
    """Return what runs a training on this hardware, its other processes started."""
    with silence_loggers("lightning.fabric", "lightning.pytorch", warnings_of="lightning"):
        fabric = Fabric(
            accelerator=machine.accelerator,
            strategy=machine.strategy,
            devices=machine.devices,
            num_nodes=machine.nodes,
            precision=machine.precision,
        )
        fabric.launch()
    return fabric


def fit_network(
    fabric: Fabric,
    training: ForceTraining,
    examples: TrainingExamples,
    rows: SplitRows,
    out: Path,
    *,
    progress: bool = False,
) -> TrainingHistory:
    """Optimise the network, from the start or from the last checkpoint in `out`, and load its best weights into it.

    Raises `FileFormatError`, `FileNotWritten`.
    """
    settings, processes = training.settings, (fabric.global_rank, fabric.world_size)

    def train_rows(epoch: int) -> list[Array]:
        return rows_of_batches(rows.train, settings.batch, (settings.seed, epoch), *processes)

    held_out_rows = rows_of_batches(rows.test, settings.batch, None, *processes)
    steps = len(train_rows(0))
    run = _TrainingRun(fabric, training, steps * settings.epochs, out)
    with (
        _subnormal_numbers_as_zero(),
        tqdm(total=run.steps, initial=run.first_epoch * steps, unit="batch", disable=not progress) as bar,
        SummaryWriter(str(out / _TENSORBOARD_FOLDER)) as tensorboard,
    ):
        for epoch in range(run.first_epoch, settings.epochs):
            metrics = {
                **run.train(epoch, map(examples.batch, train_rows(epoch)), bar),
                **run.validate(map(examples.batch, held_out_rows)),
            }
            bar.set_postfix({"epoch": epoch + 1, **{name: metrics[name] for name in ("train_loss", MONITORED_METRIC)}})
            run.end_epoch({"epoch": epoch + 1, **metrics}, tensorboard)
    if fabric.is_global_zero:
        training.model.load_state_dict(load_checkpoint(run.checkpoints / _BEST_FILE)["network"])
    return run.history


class _TrainingRun:
    """The state of a training in this process, of which every epoch leaves a checkpoint."""

    def __init__(self, fabric: Fabric, training: ForceTraining, steps: int, out: Path) -> None:
        self.fabric, self.training, self.steps, self.out = fabric, training, steps, out
        self.checkpoints = out / CHECKPOINT_FOLDER
        optimiser, self.schedule = training.build_optimiser(steps)
        self.network, self.optimiser = fabric.setup(training.model, optimiser)
        self.history = TrainingHistory()
        self._parts: dict[str, Any] = {
            "network": training.model,
            "optimiser": optimiser,
            "schedule": self.schedule,
            "precision": fabric.strategy.precision,
        }
        last = self.checkpoints / _LAST_FILE
        if last.is_file():
            checkpoint = load_checkpoint(last)
            self.history = TrainingHistory(**checkpoint["history"])
            for name, part in self._parts.items():
                part.load_state_dict(checkpoint[name])
        self.first_epoch = len(self.history.epochs)
        self._started_s = monotonic() - self.history.seconds

    def train(self, epoch: int, batches: Iterable[TrainingBatch], bar: Any) -> EpochMetrics:
        """Take the optimisation steps of one epoch."""
        self.network.train()
        errors, pairs = torch.zeros(1, device=self.fabric.device), 0
        for number, batch in enumerate(batches):
            generator = self._batch_generator(epoch, number)
            loss, error = self.training.loss(self.network, batch.to(self.fabric.device), generator)
            self.optimiser.zero_grad()
            self.fabric.backward(loss)
            self.optimiser.step()
            self.schedule.step()
            errors, pairs = errors + error * len(batch.wrench), pairs + len(batch.wrench)
            bar.update()
        return {"train_loss": self._mean_over_processes(errors, pairs).item()}

    @torch.no_grad()
    def validate(self, batches: Iterable[TrainingBatch]) -> EpochMetrics:
        """Return the errors on the held-out pairs."""
        self.network.eval()
        errors, pairs = torch.zeros(1 + len(WRENCH_AXES), device=self.fabric.device), 0
        for batch in batches:
            found = self.training.validation_errors(self.network, batch.to(self.fabric.device))
            errors, pairs = errors + found * len(batch.wrench), pairs + len(batch.wrench)
        names = (MONITORED_METRIC, *(f"mae_{axis}" for axis in WRENCH_AXES))
        return dict(zip(names, self._mean_over_processes(errors, pairs).tolist(), strict=True))

    def end_epoch(self, metrics: EpochMetrics, tensorboard: SummaryWriter) -> None:
        """Add the metrics of an epoch to the history; the first process writes them and the checkpoints."""
        self.history.seconds = monotonic() - self._started_s
        rate = self.optimiser.param_groups[0]["lr"]
        self.history.epochs.append({**metrics, "learning_rate": rate, "seconds": self.history.seconds})
        if not self.fabric.is_global_zero:
            return
        content = BytesIO()
        states = {name: part.state_dict() for name, part in self._parts.items()}
        torch.save({"history": vars(self.history), **states}, content)
        self.checkpoints.mkdir(parents=True, exist_ok=True)
        if self.history.best_epoch is self.history.epochs[-1]:
            write_file_atomically(self.checkpoints / _BEST_FILE, content.getvalue())
        # After the best one: a training that is stopped in between repeats this epoch.
        write_file_atomically(self.checkpoints / _LAST_FILE, content.getvalue())
        epochs = self.history.epochs
        rows = ([f"{value:.6g}" for value in metrics.values()] for metrics in epochs)
        write_file_atomically(self.out / _METRICS_FILE, to_csv(epochs[0], rows))
        for name, value in metrics.items():
            tensorboard.add_scalar(name, value, len(self.history.epochs))

    def _mean_over_processes(self, total: Tensor, pairs: int) -> Tensor:
        sums = torch.cat([total, torch.tensor([float(pairs)], device=self.fabric.device)])
        summed = cast(Tensor, self.fabric.all_reduce(sums, reduce_op="sum"))
        return summed[:-1] / summed[-1]

    def _batch_generator(self, epoch: int, number: int) -> torch.Generator:
        """Return the random generator of one batch; its seed is the same when a training is resumed."""
        seeds = np.random.SeedSequence([self.training.settings.seed, epoch, number, self.fabric.global_rank])
        return torch.Generator(self.fabric.device).manual_seed(int(seeds.generate_state(1)[0]))


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


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint, plain values and weights alone, without running code in it; raises `FileFormatError`."""
    try:
        return dict(load_weights(path))
    except Exception as trouble:  # torch raises many kinds of error for a damaged file
        reason = (str(trouble).splitlines() or [""])[0]
        raise FileFormatError(
            f"expected a checkpoint of this program in {path}, got: {reason}; remove it to begin again"
        ) from trouble


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
