"""The Lightning module of a force model's training: augmentation, the network, its loss and its optimiser."""

from dataclasses import dataclass
from typing import Any

import lightning
import numpy as np
import torch
from jaxtyping import Float32
from numpy import ndarray as Array
from torch import Tensor

from ninedtact.force.evaluation.predictions import AXES
from ninedtact.force.networks import LabelScale, WrenchNetwork
from ninedtact.force.training.examples import TrainingBatch
from ninedtact.force.training.settings import TrainingSettings

MONITORED_METRIC = "val_loss"
"""Metric by which the best epoch is chosen: the mean absolute error on held-out pairs, in units of the labels."""
_SMALLEST_UNIT = 1e-9


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
            augmented = settings.augmentation(batch.to_float(), settings.input.mm_per_px, self._batch_generator(number))
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
        metrics = {f"mae_{axis}": mae for axis, mae in zip(AXES, by_axis, strict=True)}
        self.log_dict(
            {MONITORED_METRIC: loss.absolute_error.mean(), **metrics}, batch_size=len(batch.wrench), sync_dist=True
        )

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
        rate = torch.optim.lr_scheduler.OneCycleLR(optimiser, settings.learning_rate, steps, pct_start=0.1)
        return {"optimizer": optimiser, "lr_scheduler": {"scheduler": rate, "interval": "step"}}
