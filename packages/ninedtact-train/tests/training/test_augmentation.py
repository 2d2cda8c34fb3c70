"""A touch seen otherwise keeps its label right: for a wrench that a law reads out of the image, moving the image and moving
the wrench come to the same."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from ninedtact.force.network_input import TYPICAL_FEATURES
from ninedtact_train.training.augmentation import (
    GeometricTransforms,
    augment_batch,
    perturb_light,
    transform_training_batch,
)
from ninedtact_train.training.examples import TrainingBatch
from ninedtact_train.training.settings import (
    NO_AUGMENTATION,
    HeightPerturbations,
    PhotometricPerturbations,
)

ROWS, COLS, MM_PER_PX = 60, 80, 0.3
X, Y = (MM_PER_PX * (torch.arange(side) - (side - 1) / 2) for side in (COLS, ROWS))


def usual(n: int) -> torch.Tensor:
    """Traits of sensors that are like others."""
    return torch.from_numpy(np.tile(TYPICAL_FEATURES.row, (n, 1)))


def images(n: int) -> Tensor:
    """Lopsided dents, each of three round ones of different depth, away from the border."""
    torch.manual_seed(0)
    z_mm = torch.zeros(n, ROWS, COLS)
    for _ in range(3):
        x, y = (reach * (2 * torch.rand(n, 1, 1) - 1) for reach in (4.0, 3.0))
        z_mm -= torch.rand(n, 1, 1) * torch.exp(-((X - x) ** 2 + (Y[:, None] - y) ** 2) / 2)
    return z_mm


def law(z_mm: Tensor) -> Tensor:
    """A wrench that a dent has whatever the axes: pressed by its volume at its middle, sheared there towards where it is
    lopsided, twisted by how that lies to its long side."""
    weight = -z_mm * MM_PER_PX**2
    volume = weight.sum((1, 2))
    middle = torch.stack([(weight * X).sum((1, 2)), (weight * Y[:, None]).sum((1, 2))], 1) / volume[:, None]
    off = torch.stack([X - middle[:, :1, None] + 0 * z_mm, Y[:, None] - middle[:, 1:, None] + 0 * z_mm], 1)
    lopsided = 0.1 * (weight[:, None] * off * (off**2).sum(1, keepdim=True)).sum((2, 3))
    spread = torch.einsum("nrc,nirc,njrc->nij", weight, off, off)
    twist = cross(lopsided, torch.einsum("nij,nj->ni", spread, lopsided)) * 1e-4
    press = -volume
    torque = [middle[:, 1] * press, -middle[:, 0] * press, cross(middle, lopsided)]
    return torch.stack([*lopsided.unbind(1), press, torque[0] / 1e3, torque[1] / 1e3, torque[2] / 1e3 + twist], 1)


def cross(a: Tensor, b: Tensor) -> Tensor:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def batch(n: int) -> TrainingBatch:
    z_mm = images(n)
    return TrainingBatch(z_mm, law(z_mm), None, usual(n))


def moves(**given: list[float] | list[list[float]]) -> GeometricTransforms:
    """As given for each of n images; nothing else is done to them."""
    n = len(next(iter(given.values())))
    nothing = {"mirror": torch.ones(n, 2), "rotation_rad": torch.zeros(n), "shift_mm": torch.zeros(n, 2)}
    return GeometricTransforms(
        **{**nothing, "scale": torch.ones(n), **{name: torch.tensor(value) for name, value in given.items()}}
    )


TILTED = [0.2, -0.3, 0.1]
MOVES = {
    "mirror": moves(mirror=[[-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]]),
    "turn": moves(rotation_rad=TILTED),
    "shift": moves(shift_mm=[[0.9, 0.0], [0.0, -0.7], [0.41, 0.37]]),
    "all": moves(mirror=[[-1.0, 1.0]] * 3, rotation_rad=TILTED, shift_mm=[[0.5, -0.8]] * 3),
}


@pytest.mark.parametrize("name", MOVES)
def test_moving_the_image_and_moving_the_wrench_come_to_the_same(name: str) -> None:
    before = batch(3)
    after = transform_training_batch(before, MOVES[name], MM_PER_PX)
    size = before.wrench.abs().amax(0)
    assert (size > 0).all() and ((after.wrench - before.wrench).abs() / size).amax() > 0.1
    # Between pixels, interpolation itself moves a dent by up to a hundredth of a mm.
    assert ((law(after.images) - after.wrench).abs() / size).max() < 0.04


def test_a_scaled_image_has_a_wider_dent_and_the_same_wrench() -> None:
    one = batch(1)
    wider = transform_training_batch(one, moves(scale=[1.1]), MM_PER_PX)
    assert torch.equal(wider.wrench, one.wrench)
    assert float(wider.images.sum() / one.images.sum()) == pytest.approx(1.21, rel=0.01)


def test_errors_of_heights_are_as_large_as_asked_for() -> None:
    flat = TrainingBatch(torch.zeros(500, 24, 32), torch.zeros(500, 6), None, usual(500))
    only = replace(NO_AUGMENTATION, heights=HeightPerturbations(0.0, 0.01, 0.001, 0.0, 0.0))
    z_mm = augment_batch(only, flat, 0.3, torch.Generator().manual_seed(0)).images
    assert float(z_mm.mean((1, 2)).std()) == pytest.approx(0.01, rel=0.1)
    assert float((z_mm[:, :, -1] - z_mm[:, :, 0]).mean(1).std()) == pytest.approx(31 * 0.3 * 0.001, rel=0.1)
    noisy = replace(NO_AUGMENTATION, heights=HeightPerturbations(0.0, 0.0, 0.0, 0.02, 0.6))
    noise = augment_batch(noisy, flat, 0.3, torch.Generator().manual_seed(0)).images
    assert float(noise.std((1, 2)).mean()) == pytest.approx(0.01, rel=0.1)
    neighbours = float((noise[:, :, 1:] * noise[:, :, :-1]).mean() / (noise**2).mean())
    assert 0.2 < neighbours < 0.98


def test_a_brighter_lamp_changes_image_and_reference_alike_and_drift_the_reference_alone() -> None:
    grey = torch.full((400, 8, 8), 100.0)
    lit = TrainingBatch(grey, torch.zeros(400, 6), grey, usual(400))
    lamp = perturb_light(PhotometricPerturbations(0.05, 0.0, 0.0), lit, torch.Generator().manual_seed(0))
    assert lamp.references is not None and torch.allclose(lamp.images, lamp.references)
    assert float(lamp.images.mean((1, 2)).std()) == pytest.approx(5, rel=0.15)
    drift = perturb_light(PhotometricPerturbations(0.0, 0.01, 0.0), lit, torch.Generator().manual_seed(0))
    assert drift.references is not None and torch.equal(drift.images, grey)
    assert float(drift.references.mean((1, 2)).std()) == pytest.approx(1, rel=0.15)
