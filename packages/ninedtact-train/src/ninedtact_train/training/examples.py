"""Training examples (images or heights with wrenches), in memory or mapped from a file, and their batches in a seeded order."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int, Shaped
from numpy import ndarray as Array
from torch import Tensor

from ninedtact.design import Gel
from ninedtact.errors import ForceEstimationError
from ninedtact.force.network_input import (
    TYPICAL_FEATURES,
    InputChannels,
    NetworkInputSettings,
    stack_height_channels,
    stack_image_channels,
)
from ninedtact.quantities import WRENCH_AXES, Wrench
from ninedtact_train.dataset.split import SplitRows

_FEWEST_PAIRS = 2


@dataclass(frozen=True)
class TrainingExamples:
    """Images at the size of the network's input with their wrenches; raises `ForceEstimationError`. Arrays may be mapped files."""

    images: Shaped[Array, "n rows cols"]
    """Heights in mm on the network's grid (`orthorectified_heights`), or grey levels; of any numeric type."""
    wrench: Float32[Array, "n 6"]
    """N and N·m about the skin's centre."""
    objects: Sequence[str]
    sensors: Sequence[str]
    references: Shaped[Array, "m rows cols"] | None = None
    """Reference images (no contact); None for heights."""
    reference_of: Int[Array, " n"] | None = None
    """Row in `references` of each image's reference."""
    sensor_features: Float32[Array, "n features"] | None = None
    """Features of each example's sensor (`SensorParameterInputs.row`); typical ones where None."""

    def __post_init__(self) -> None:
        n = len(self.images)
        columns = {name: column for name, column in vars(self).items() if name not in ("images", "references")}
        if any(column is not None and len(column) != n for column in columns.values()) or self.wrench.shape != (
            n,
            len(WRENCH_AXES),
        ):
            raise ForceEstimationError(
                expected=f"a wrench of six, object, sensor and the rest for each of {n} images",
                got="columns of other lengths",
                remedy="give one of each for every image",
            )
        if not np.isfinite(self.wrench).all():
            bad = ~np.isfinite(self.wrench).all(1)
            raise ForceEstimationError(
                expected="wrenches of six finite numbers",
                got=f"{bad.sum()} of {n} that are not, the first in row {int(bad.argmax())}",
                remedy="leave those pairs out",
            )

    def scale_to_design_modulus(self, modulus_mpa: Float64[Array, " n"]) -> "TrainingExamples":
        """Return the examples with wrenches as a gel of the design's shear modulus would have given them.

        modulus_mpa: shear modulus of the gel with which each example was recorded.
        """
        factor = (Gel().shear_modulus_mpa / modulus_mpa)[:, None]
        return replace(self, wrench=(self.wrench * factor).astype(np.float32))

    def __len__(self) -> int:
        return len(self.images)

    def batch(self, rows: Int[Array, " b"]) -> "TrainingBatch":
        """Return the batch of these rows, copied into memory."""
        references = None
        if self.references is not None and self.reference_of is not None:
            references = torch.tensor(self.references[self.reference_of[rows]])
        features = self.sensor_features
        features = np.tile(TYPICAL_FEATURES.row, (len(rows), 1)) if features is None else features[rows]
        images, wrench = torch.tensor(self.images[rows]), torch.tensor(self.wrench[rows])
        return TrainingBatch(images, wrench, references, torch.tensor(features))


def require_trainable_examples(examples: TrainingExamples, rows: SplitRows, settings: NetworkInputSettings) -> None:
    """Raise `ForceEstimationError` where examples cannot be trained on.

    These are too few pairs, wrenches that were not measured on all axes, and examples that do not fit the network's input.
    """
    if min(len(rows.train), len(rows.test)) < _FEWEST_PAIRS:
        raise ForceEstimationError(
            expected=f"at least {_FEWEST_PAIRS} pairs for training and for validation",
            got=f"{len(rows.train)} and {len(rows.test)}",
            remedy="hold out more or less, or record more",
        )
    unmeasured = [
        name for name, values in zip(WRENCH_AXES, examples.wrench[rows.train].T, strict=True) if not np.ptp(values)
    ]
    if unmeasured:
        raise ForceEstimationError(
            expected="wrenches that vary on all six axes",
            got=f"the same {', '.join(unmeasured)} in all {len(rows.train)} training pairs, as of a sensor that "
            "does not measure it",
            remedy="give wrenches that were measured on all axes",
        )
    size = examples.images.shape[1:]
    if size != (settings.rows, settings.cols):
        raise ForceEstimationError(
            expected=f"images of {settings.cols} x {settings.rows}",
            got=f"{size[1]} x {size[0]}",
            remedy="read the data at that size",
        )
    are_heights = examples.references is None
    if are_heights != settings.channels.of_heights or are_heights != (examples.reference_of is None):
        raise ForceEstimationError(
            expected=f"examples for the channels {settings.channels.value!r}",
            got="heights" if are_heights else "images with references",
            remedy="give the other kind, or choose other channels",
        )


def move_torques_from_skin_centre(
    wrenches: Float32[Array, "n 6"], point_mm: tuple[float, float, float]
) -> Float32[Array, "n 6"]:
    """Return wrenches about the skin's centre with torques about another point."""
    shift = Wrench(np.zeros(3), np.zeros(3)).shift_matrix(np.array(point_mm))
    return (wrenches @ shift.T).astype(np.float32)


@dataclass(frozen=True)
class TrainingBatch:
    """A batch of examples on one device; arrays keep their stored type until `to_float`."""

    images: Tensor
    """(n, rows, cols) heights in mm, or grey levels."""
    wrench: Tensor
    """(n, 6) wrenches in N and N·m."""
    references: Tensor | None
    sensor_features: Tensor
    """(n, 5) features of each example's sensor."""

    def to(self, device: torch.device, **options: Any) -> "TrainingBatch":
        """Return the batch on another device."""
        moved = {name: part.to(device, **options) for name, part in vars(self).items() if part is not None}
        return replace(self, **moved)

    def to_float(self) -> "TrainingBatch":
        """Return the batch as float32; called on the training's device, because small integers are transferred faster."""
        converted = {name: part.float() for name, part in vars(self).items() if part is not None}
        return replace(self, **converted)

    def about(self, point_mm: tuple[float, float, float]) -> "TrainingBatch":
        """Return the batch with torques about another point, given from the skin's centre, as `Wrench.about` moves them."""
        force_n, torque_nm = self.wrench[:, :3], self.wrench[:, 3:]
        arm_m = (torch.tensor(point_mm).to(force_n) / 1e3).expand_as(force_n)
        return replace(self, wrench=torch.cat([force_n, torque_nm - torch.linalg.cross(arm_m, force_n)], 1))

    def network_input(self, channels: InputChannels) -> Tensor:
        """Return the network's input (n, channels, rows, cols)."""
        if self.references is None:
            stacked: Tensor = stack_height_channels(self.images, self.sensor_features, channels)
        else:
            stacked = stack_image_channels(self.images, self.references, channels)
        return stacked.contiguous(memory_format=torch.channels_last)


def rows_of_batches(
    rows: Int[Array, " n"], batch: int, seed: tuple[int, int] | None, rank: int = 0, world: int = 1
) -> list[Int[Array, " b"]]:
    """Return the rows of every batch of one process in one epoch, equally many in all processes.

    seed: that of the training and the number of the epoch. With it the rows are shuffled, and those that do not fill the last batch
    are left out; without it they keep their order. Some rows repeat where they do not divide evenly among the processes.
    """
    order = rows if seed is None else np.random.default_rng(seed).permutation(rows)
    own = np.resize(order, -(-len(order) // world) * world)[rank::world]
    count = -(-len(own) // batch) if seed is None else max(len(own) // batch, 1)
    # Sorted, because mapped files are read fastest in their own order.
    return [np.sort(own[number * batch : (number + 1) * batch]) for number in range(count)]
