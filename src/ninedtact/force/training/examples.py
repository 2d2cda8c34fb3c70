"""What is learnt from: images or heights with the wrench of each, in memory or mapped from a file.

Some examples at a time, in an order that the seed and the epoch decide, whatever was drawn before.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32, Float64, Int, Shaped
from numpy import ndarray as Array
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from ninedtact.design import Gel
from ninedtact.errors import NinedtactError
from ninedtact.force.inputs import Channels, InputSettings, height_channels, image_channels
from ninedtact.force.splits import Rows
from ninedtact.force.traits import USUAL

AXES = 6
_FEWEST_PAIRS = 2


class ExamplesUnusable(NinedtactError):
    """TrainingExamples that nothing can be learnt from."""


@dataclass(frozen=True)
class TrainingExamples:
    """Pairs at the size of the network's input; raises `ExamplesUnusable`. What is large may be mapped from a file."""

    images: Shaped[Array, "n rows cols"]
    """Heights in mm on the network's grid (`inputs.heights_at_places`), or grey levels; of any type of number."""
    wrench: Float32[Array, "n 6"]
    """N and N·m about the skin's centre."""
    objects: Sequence[str]
    sensors: Sequence[str]
    references: Shaped[Array, "m rows cols"] | None = None
    """Untouched images; none for heights."""
    reference_of: Int[Array, " n"] | None = None
    """Which of them each image is held against."""
    traits: Float32[Array, "n traits"] | None = None
    """Of the sensor of each (`Traits.row`); usual ones where nothing is said."""

    def __post_init__(self) -> None:
        n = len(self.images)
        columns = (self.wrench, self.objects, self.sensors, self.reference_of, self.traits)
        if any(column is not None and len(column) != n for column in columns) or self.wrench.shape != (n, AXES):
            raise ExamplesUnusable(
                f"expected a wrench of six, object, sensor and the rest for each of {n} images, got columns of other "
                "lengths; give one of each for every image"
            )
        if not np.isfinite(self.wrench).all():
            bad = ~np.isfinite(self.wrench).all(1)
            raise ExamplesUnusable(
                f"expected wrenches of six finite numbers, got {bad.sum()} of {n} that are not, the first in row "
                f"{int(bad.argmax())}; leave those pairs out"
            )

    def at_modulus(self, of_each_mpa: Float64[Array, " n"]) -> "TrainingExamples":
        """Wrenches as a gel of the design's modulus would have given them, those of each sensor's gel given."""
        softer = (Gel().shear_modulus_mpa / of_each_mpa)[:, None]
        return replace(self, wrench=(self.wrench * softer).astype(np.float32))

    def __len__(self) -> int:
        return len(self.images)


def require_trainable(examples: TrainingExamples, rows: Rows, settings: InputSettings) -> None:
    """Refuse what would train nothing, or something else; raises `ExamplesUnusable`."""
    if min(len(rows.train), len(rows.test)) < _FEWEST_PAIRS:
        raise ExamplesUnusable(
            f"expected at least {_FEWEST_PAIRS} pairs to learn from and others to check with, got {len(rows.train)} and "
            f"{len(rows.test)}; hold out more or less, or record more"
        )
    size = examples.images.shape[1:]
    if size != (settings.rows, settings.cols):
        raise ExamplesUnusable(
            f"expected images of {settings.cols} x {settings.rows}, got {size[1]} x {size[0]}; read the data at that size"
        )
    if settings.channels.of_heights != (examples.references is None) or (examples.reference_of is None) != (
        examples.references is None
    ):
        given = "heights" if examples.references is None else "images with references"
        raise ExamplesUnusable(
            f"expected examples for the channels {settings.channels.value!r}, got {given}; give the others, or ask for other "
            "channels"
        )


def move_torque_reference(examples: TrainingExamples, point_mm: tuple[float, float, float]) -> TrainingExamples:
    """Torques about a point that is given from the one that they are about, as `Wrench.about` moves them."""
    force, torque = examples.wrench[:, :3], examples.wrench[:, 3:]
    moved = torque - np.cross(np.array(point_mm) / 1e3, force)
    return replace(examples, wrench=np.concatenate([force, moved], 1).astype(np.float32))


@dataclass(frozen=True)
class TrainingBatch:
    """Some examples on one device; numbers as they are stored until `floating`."""

    images: Tensor
    """(n, rows, cols) heights in mm, or grey levels."""
    wrench: Tensor
    references: Tensor | None
    traits: Tensor
    """(n, 5) of their sensors."""

    def to(self, device: torch.device, **options: Any) -> "TrainingBatch":
        """The same on another device; Lightning calls it."""
        moved = {name: part.to(device, **options) for name, part in vars(self).items() if part is not None}
        return replace(self, **moved)

    def floating(self) -> "TrainingBatch":
        """As float32: done where the batch is learnt from, for small integers travel sooner."""
        made = {name: part.float() for name, part in vars(self).items() if part is not None}
        return replace(self, **made)

    def channels(self, of: Channels) -> Tensor:
        """What the network is shown."""
        if self.references is None:
            made: Tensor = height_channels(self.images, self.traits, of)
        else:
            made = image_channels(self.images, self.references, of)
        return made.contiguous(memory_format=torch.channels_last)


class BatchDataset(Dataset[TrainingBatch]):
    """TrainingExamples asked for by many rows at once."""

    def __init__(self, examples: TrainingExamples) -> None:
        self.examples = examples

    def __getitem__(self, rows: Int[Array, " b"]) -> TrainingBatch:
        """In memory of their own."""
        examples, references = self.examples, None
        if examples.references is not None and examples.reference_of is not None:
            references = _copy_to_tensor(examples.references[examples.reference_of[rows]])
        traits = np.tile(USUAL.row, (len(rows), 1)) if examples.traits is None else examples.traits[rows]
        return TrainingBatch(
            _copy_to_tensor(examples.images[rows]),
            _copy_to_tensor(examples.wrench[rows]),
            references,
            _copy_to_tensor(traits),
        )


def _copy_to_tensor(array: Array) -> Tensor:
    """Whatever file it is mapped from."""
    return torch.from_numpy(np.array(array))


class SeededBatchSampler(Sampler[Any]):
    """Rows of every batch, divided among the processes of a training.

    With a seed: shuffled anew each epoch, and the rows that do not fill a last batch wait for another epoch.
    """

    def __init__(self, rows: Int[Array, " n"], batch: int, seed: int | None, rank: int = 0, world: int = 1) -> None:
        self.rows, self.batch, self.seed, self.rank, self.world, self.epoch = rows, batch, seed, rank, world, 0
        each = -(-len(rows) // world)
        self.batches = -(-each // batch) if seed is None else max(each // batch, 1)

    def set_epoch(self, epoch: int) -> None:
        """Lightning tells which begins."""
        self.epoch = epoch

    def __iter__(self) -> Iterator[Int[Array, " b"]]:
        own = self.own
        for number in range(self.batches):
            # Sorted, because mapped files are read soonest in their own order.
            yield np.sort(own[number * self.batch : (number + 1) * self.batch])

    @property
    def own(self) -> Int[Array, " m"]:
        """This process's rows of this epoch; as many for all, so some come twice where they do not divide."""
        order = self.rows
        if self.seed is not None:
            order = np.random.default_rng([self.seed, self.epoch]).permutation(self.rows)
        each = -(-len(order) // self.world)
        return np.resize(order, each * self.world)[self.rank :: self.world]

    def __len__(self) -> int:
        return self.batches


def make_data_loader(examples: TrainingExamples, order: SeededBatchSampler, workers: int) -> DataLoader[TrainingBatch]:
    """Batches of examples in an order."""
    return DataLoader(
        BatchDataset(examples),
        batch_size=None,
        sampler=order,
        num_workers=workers,
        persistent_workers=workers > 0,
    )
