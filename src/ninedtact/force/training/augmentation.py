"""The same touch seen otherwise, so that its label stays right: `geometry` changes image and wrench, `disturbance` the image.

Works on batches on their own device, before channels are made of them, and draws from the generator that it is given.
"""

from dataclasses import dataclass

import torch

from ninedtact.force.training.batches import TouchBatch
from ninedtact.force.training.disturbance import HeightErrors, LightErrors
from ninedtact.force.training.geometry import Moves


@dataclass(frozen=True)
class Augmentation:
    """How much is changed; every image of a batch for itself."""

    moves: Moves = Moves()
    heights: HeightErrors = HeightErrors()
    """Done to heights."""
    light: LightErrors = LightErrors()
    """Done to images."""

    def __call__(self, batch: TouchBatch, mm_per_px: float, generator: torch.Generator) -> TouchBatch:
        """Another batch of the same touches."""
        moved = self.moves(batch, mm_per_px, generator)
        if moved.references is None:
            return self.heights(moved, mm_per_px, generator)
        return self.light(moved, generator)


NOTHING_CHANGED = Augmentation(
    Moves(False, 0.0, 0.0, 0.0, 0.0), HeightErrors(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), LightErrors(0.0, 0.0, 0.0)
)
