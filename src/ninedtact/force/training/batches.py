"""Some examples at a time, in an order that the seed and the epoch decide, whatever was drawn before."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from jaxtyping import Int
from numpy import ndarray as Array
from torch import Tensor
from torch.utils.data import DataLoader, Dataset, Sampler

from ninedtact.force.inputs import Channels, height_channels, image_channels
from ninedtact.force.training.examples import Examples
from ninedtact.force.traits import USUAL


@dataclass(frozen=True)
class TouchBatch:
    """Some examples on one device; numbers as they are stored until `floating`."""

    images: Tensor
    """(n, rows, cols) heights in mm, or grey levels."""
    wrench: Tensor
    references: Tensor | None
    traits: Tensor
    """(n, 5) of their sensors."""

    def to(self, device: torch.device, **options: Any) -> "TouchBatch":
        """The same on another device; Lightning calls it."""
        moved = {name: part.to(device, **options) for name, part in vars(self).items() if part is not None}
        return replace(self, **moved)

    def floating(self) -> "TouchBatch":
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


class ExampleBatches(Dataset[TouchBatch]):
    """Examples asked for by many rows at once."""

    def __init__(self, examples: Examples) -> None:
        self.examples = examples

    def __getitem__(self, rows: Int[Array, " b"]) -> TouchBatch:
        """In memory of their own."""
        examples, references = self.examples, None
        if examples.references is not None and examples.reference_of is not None:
            references = copied(examples.references[examples.reference_of[rows]])
        traits = np.tile(USUAL.row, (len(rows), 1)) if examples.traits is None else examples.traits[rows]
        return TouchBatch(copied(examples.images[rows]), copied(examples.wrench[rows]), references, copied(traits))


def copied(array: Array) -> Tensor:
    """Whatever file it is mapped from."""
    return torch.from_numpy(np.array(array))


class Order(Sampler[Any]):
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


def loader(examples: Examples, order: Order, workers: int) -> DataLoader[TouchBatch]:
    """Batches of examples in an order."""
    return DataLoader(
        ExampleBatches(examples),
        batch_size=None,
        sampler=order,
        num_workers=workers,
        persistent_workers=workers > 0,
    )
