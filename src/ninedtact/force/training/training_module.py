"""One step of learning: examples changed, shown, and what the answer costs."""

from dataclasses import dataclass
from typing import Any

import lightning
import numpy as np
import torch
from jaxtyping import Float32
from numpy import ndarray as Array
from torch import Tensor

from ninedtact.force.evaluation.predictions import AXES
from ninedtact.force.networks import Labels, WrenchNetwork
from ninedtact.force.training.examples import TrainingBatch
from ninedtact.force.training.settings import TrainingSettings

MONITORED_METRIC = "val_loss"
"""What the best epoch is best by: the mean absolute error in units of the labels."""
SMALLEST_UNIT = 1e-9


def fit_label_scaling(wrench: Float32[Array, "n 6"], settings: TrainingSettings) -> Labels:
    """What six numbers are counted in, of the wrenches that are learnt."""
    if settings.labels == "ranges":
        low, high = wrench.min(0), wrench.max(0)
        unit, offset = high - low, low
    else:
        unit, offset = np.abs(wrench - np.median(wrench, axis=0)).mean(0), np.zeros(6)
    kept = np.maximum(unit, SMALLEST_UNIT)
    return Labels(tuple(kept.astype(float).tolist()), tuple(offset.astype(float).tolist()))


@dataclass(frozen=True)
class BatchLoss:
    """Of a batch, in units of the labels."""

    off: Tensor
    """Absolute errors (n, 6)."""
    unlikely: Tensor | None
    """Minus the logarithm of the scale's likelihood (n, 6), up to a constant; the answer itself is not moved by it."""

    def total(self, scale_weight: float) -> Tensor:
        """The paper's sum of absolute errors, and a little of the other."""
        total = self.off.sum()
        return total if self.unlikely is None else total + scale_weight * self.unlikely.sum()


def compute_batch_loss(answer: tuple[Tensor, ...], wrench: Tensor, unit: Tensor) -> BatchLoss:
    """How far off the answer is, and how unlikely its own scale makes that."""
    off = ((answer[0] - wrench) / unit).abs()
    if len(answer) == 1:
        return BatchLoss(off, None)
    scale = answer[1] / unit
    return BatchLoss(off, off.detach() / scale + scale.log())


class ForceTrainingModule(lightning.LightningModule):
    """The network while it learns."""

    def __init__(self, settings: TrainingSettings, labels: Labels) -> None:
        super().__init__()
        self.settings = settings
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.model = WrenchNetwork(settings.network, settings.input, labels, with_scale=settings.scale_weight > 0)
        self.model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def training_step(self, batch: TrainingBatch, number: int) -> Tensor:
        """The cost of examples that were changed by chance of their own."""
        settings = self.settings
        # Labels, and where pixels come from, are not for half precision.
        with torch.no_grad(), torch.autocast(self.device.type, enabled=False):
            seen = settings.augmentation(batch.floating(), settings.input.mm_per_px, self.chance(number))
            channels = seen.channels(settings.input.channels)
        cost = compute_batch_loss(self.model(channels), seen.wrench, self.model.unit)
        self.log(
            "train_loss", cost.off.mean(), on_step=False, on_epoch=True, batch_size=len(batch.wrench), sync_dist=True
        )
        return cost.total(settings.scale_weight)

    def validation_step(self, batch: TrainingBatch, number: int) -> None:
        """Mean absolute errors, in units all together and by axis in N and N·m."""
        channels = batch.floating().channels(self.settings.input.channels)
        cost = compute_batch_loss(self.model(channels), batch.wrench, self.model.unit)
        by_axis = (cost.off.mean(0) * self.model.unit).unbind()
        told = {
            MONITORED_METRIC: cost.off.mean(),
            **{f"mae_{axis}": mae for axis, mae in zip(AXES, by_axis, strict=True)},
        }
        self.log_dict(told, batch_size=len(batch.wrench), sync_dist=True)

    def chance(self, number: int) -> torch.Generator:
        """Of one batch: the same after a stop."""
        drawn = np.random.SeedSequence([self.settings.seed, self.current_epoch, number, self.global_rank])
        return torch.Generator(self.device).manual_seed(int(drawn.generate_state(1)[0]))

    def configure_optimizers(self) -> Any:
        """As the settings name them."""
        settings = self.settings
        kind = torch.optim.AdamW if settings.optimiser == "adamw" else torch.optim.Adam
        optimiser = kind(self.parameters(), lr=settings.learning_rate, weight_decay=settings.weight_decay)
        if settings.schedule == "constant":
            return optimiser
        steps = int(self.trainer.estimated_stepping_batches)
        rate = torch.optim.lr_scheduler.OneCycleLR(optimiser, settings.learning_rate, steps, pct_start=0.1)
        return {"optimizer": optimiser, "lr_scheduler": {"scheduler": rate, "interval": "step"}}
