"""Augmentation of training examples: random geometric transforms of image and wrench, and random perturbations of the image.

Geometric augmentation transforms image and wrench together. A point X of the skin is mapped to s·R·M·X + t: M mirrors, R rotates
about the skin's centre, t shifts, s scales. A force becomes R·M·F. A torque rotates as a force does and changes its sign with every
mirror, because it is an axial vector; the shift adds t × F to it. The scale s stands for an error of the calibration, so it changes
the image alone.

Perturbations change the image alone: they simulate errors of a height map, or of light and camera.

All functions work on batches on their own device, before the network's channels are computed, and take their random numbers from
the generator that is passed to them.
"""

from dataclasses import dataclass, replace
from math import ceil, radians

import torch
import torch.nn.functional as nnf
from torch import Generator, Tensor

from ninedtact_train.training.examples import TrainingBatch
from ninedtact_train.training.settings import (
    Augmentation,
    GeometricAugmentation,
    HeightPerturbations,
    PhotometricPerturbations,
)


def augment_batch(
    settings: Augmentation, batch: TrainingBatch, mm_per_px: float, generator: Generator
) -> TrainingBatch:
    """Return another batch of the same contacts, randomly changed: moved, then with errors of heights or of images."""
    transforms = sample_transforms(settings.geometric, len(batch.wrench), generator)
    transformed = transform_training_batch(batch, transforms, mm_per_px)
    if transformed.references is None:
        return perturb_heights(settings.heights, transformed, mm_per_px, generator)
    return perturb_light(settings.photometric, transformed, generator)


def sample_transforms(settings: GeometricAugmentation, n: int, generator: Generator) -> "GeometricTransforms":
    """Sample n transforms from the generator."""
    device = generator.device

    def uniform(*shape: int) -> Tensor:
        return 2 * torch.rand(n, *shape, generator=generator, device=device) - 1

    chosen = (torch.rand(n, generator=generator, device=device) < settings.transformed_share).float()
    mirror = uniform(2).sign() if settings.mirror else torch.ones(n, 2, device=device)
    rotation = chosen * uniform() * radians(settings.max_rotation_deg)
    shift = chosen[:, None] * uniform(2) * settings.max_shift_mm
    scale = 1 + chosen * settings.scale_std * torch.randn(n, generator=generator, device=device)
    return GeometricTransforms(mirror, rotation, shift, scale)


@dataclass(frozen=True)
class GeometricTransforms:
    """Transforms of n images: signs (n, 2) along x and y, angles (n) from x to y, shifts (n, 2) in mm, scales (n)."""

    mirror: Tensor
    rotation_rad: Tensor
    shift_mm: Tensor
    scale: Tensor

    @property
    def linear_part(self) -> Tensor:
        """The matrices R·M, (n, 2, 2)."""
        cos, sin = self.rotation_rad.cos(), self.rotation_rad.sin()
        rotation = torch.stack([torch.stack([cos, -sin], 1), torch.stack([sin, cos], 1)], 1)
        return rotation * self.mirror[:, None, :]


def transform_training_batch(batch: TrainingBatch, transform: GeometricTransforms, mm_per_px: float) -> TrainingBatch:
    """Return the batch with images, references and wrenches transformed."""
    grid = _sampling_grid(transform, batch.images.shape, mm_per_px)
    references = None if batch.references is None else _resample(batch.references, grid)
    return replace(
        batch,
        images=_resample(batch.images, grid),
        references=references,
        wrench=_transform_wrench(transform, batch.wrench),
    )


def _transform_wrench(transform: GeometricTransforms, wrench: Tensor) -> Tensor:
    sign = transform.mirror.prod(1, keepdim=True)
    linear = transform.linear_part
    force, torque = wrench[:, :3], wrench[:, 3:]
    force_xy = torch.einsum("nij,nj->ni", linear, force[:, :2])
    torque_xy = sign * torch.einsum("nij,nj->ni", linear, torque[:, :2])
    force = torch.cat([force_xy, force[:, 2:]], 1)
    torque = torch.cat([torque_xy, sign * torque[:, 2:]], 1)
    arm_m = nnf.pad(transform.shift_mm, (0, 1)) / 1e3
    return torch.cat([force, torque + torch.linalg.cross(arm_m, force)], 1)


def _sampling_grid(transform: GeometricTransforms, shape: torch.Size, mm_per_px: float) -> Tensor:
    """Return where each pixel of the transformed images lies in the original ones, (n, rows, cols, 2) for `grid_sample`."""
    n, rows, cols = shape
    # Distance from the image's centre to the centre of the last pixel.
    half_mm = torch.tensor([(cols - 1) / 2, (rows - 1) / 2], device=transform.shift_mm.device) * mm_per_px
    back = torch.linalg.inv(transform.linear_part * transform.scale[:, None, None])
    start = -torch.einsum("nij,nj->ni", back, transform.shift_mm)
    theta = torch.cat([back * half_mm / half_mm[:, None], (start / half_mm)[..., None]], 2)
    return nnf.affine_grid(theta, [n, 1, rows, cols], align_corners=True)


def _resample(fields: Tensor, grid: Tensor) -> Tensor:
    """Interpolate fields (n, rows, cols) at the grid's points; beyond the border the border's values are repeated."""
    found = nnf.grid_sample(fields[:, None], grid, mode="bicubic", padding_mode="border", align_corners=True)
    return found[:, 0]


def perturb_heights(
    settings: HeightPerturbations, batch: TrainingBatch, mm_per_px: float, generator: Generator
) -> TrainingBatch:
    """Return the batch with independent errors added to each height map (mm)."""
    z_mm = batch.images
    indented, bulging = (1 + settings.gain * _normal_samples(generator, len(z_mm), 1, 1) for _ in range(2))
    gained = torch.where(z_mm < 0, z_mm * indented, z_mm * bulging)
    planes = _sample_planes(settings, z_mm, mm_per_px, generator)
    noise = _sample_noise(settings, z_mm, mm_per_px, generator)
    features = _perturb_features(settings, batch.sensor_features, generator)
    return replace(batch, images=gained + planes + noise, sensor_features=features)


def _perturb_features(settings: HeightPerturbations, features: Tensor, generator: Generator) -> Tensor:
    """Return the sensor features (n, features) with random errors, as repeated calibrations of the same sensors would have."""
    factor = 1 + settings.features * _normal_samples(generator, *features.shape)
    return torch.cat([features[:, :1], (features * factor)[:, 1:]], 1)


def _sample_planes(settings: HeightPerturbations, z_mm: Tensor, mm_per_px: float, generator: Generator) -> Tensor:
    n, rows, cols = z_mm.shape
    x, y = (
        (torch.arange(side, device=z_mm.device) - (side - 1) / 2) * (mm_per_px * settings.tilt) for side in (cols, rows)
    )
    offset, along_x, along_y = (_normal_samples(generator, n, 1, 1) for _ in range(3))
    return settings.offset_mm * offset + along_x * x + along_y * y[:, None]


def _sample_noise(settings: HeightPerturbations, z_mm: Tensor, mm_per_px: float, generator: Generator) -> Tensor:
    """Sample smooth noise, with one random width for the whole batch and a random strength for each height map."""
    if settings.max_noise_mm == 0:
        return torch.zeros_like(z_mm)
    width_px = settings.max_noise_width_mm / mm_per_px * torch.rand((), generator=generator, device=z_mm.device)
    strength = settings.max_noise_mm * torch.rand(len(z_mm), 1, 1, generator=generator, device=z_mm.device)
    max_reach_px = ceil(3 * settings.max_noise_width_mm / mm_per_px)
    return strength * _smooth_noise(_normal_samples(generator, *z_mm.shape), width_px, max_reach_px)


def perturb_light(settings: PhotometricPerturbations, batch: TrainingBatch, generator: Generator) -> TrainingBatch:
    """Return the batch with independent errors of each image and its reference (grey levels)."""
    assert batch.references is not None
    n = len(batch.images)
    gain, drift = (1 + std * _normal_samples(generator, n, 1, 1) for std in (settings.gain, settings.drift))
    strength = settings.max_noise_grey * torch.rand(n, 1, 1, generator=generator, device=generator.device)
    images = batch.images * gain + strength * _normal_samples(generator, *batch.images.shape)
    return replace(batch, images=images.clamp(0, 255), references=(batch.references * gain * drift).clamp(0, 255))


def _normal_samples(generator: Generator, *shape: int) -> Tensor:
    return torch.randn(*shape, generator=generator, device=generator.device)


def _smooth_noise(noise: Tensor, width_px: Tensor, max_reach_px: int) -> Tensor:
    """Filter white noise (n, rows, cols) by a Gaussian of this width; the standard deviation of the noise stays one."""
    reach = torch.arange(-max_reach_px, max_reach_px + 1, device=noise.device)
    kernel = torch.exp(-0.5 * (reach / width_px.clamp(min=1e-3)) ** 2)
    kernel = kernel / kernel.norm()
    across = nnf.conv2d(nnf.pad(noise[:, None], (max_reach_px,) * 4, mode="circular"), kernel[None, None, None, :])
    return nnf.conv2d(across, kernel[None, None, :, None])[:, 0]
