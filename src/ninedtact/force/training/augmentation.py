"""Mirrored, turned, shifted and scaled: images and wrenches alike.

A point X of the skin goes to scale·R·M·X + t: M mirrors, R turns about the skin's centre, t shifts. A force goes to R·M·F; a torque
turns as a force does and changes its sign with every mirror, for it is an axial vector; a shifted force has another arm,
T + t × F. The scale is an error of the calibration: the image alone has it.

What spoils an image and leaves the wrench as it is: errors of a height map, and of light and camera.

The same touch seen otherwise, so that its label stays right: `geometry` changes image and wrench, `disturbance` the image.

Works on batches on their own device, before channels are made of them, and draws from the generator that it is given.
"""

from dataclasses import dataclass, replace
from math import ceil, radians

import torch
import torch.nn.functional as nnf
from torch import Generator, Tensor

from ninedtact.force.training.examples import TrainingBatch


@dataclass(frozen=True)
class GeometricAugmentation:
    """How far."""

    mirror: bool = True
    """Along x, along y, both or neither, as often."""
    moved_share: float = 0.5
    """Part of the images that are turned, shifted and scaled; the others stay sharp."""
    turn_most_deg: float = 10.0
    shift_most_mm: float = 0.6
    scale: float = 0.005
    """Standard deviation."""

    def __call__(self, batch: TrainingBatch, mm_per_px: float, generator: torch.Generator) -> TrainingBatch:
        """Every image by its own move."""
        return apply_transform(batch, self.drawn(len(batch.wrench), generator), mm_per_px)

    def drawn(self, n: int, generator: torch.Generator) -> "GeometricTransform":
        """One move for each image."""
        device = generator.device

        def even(*shape: int) -> Tensor:
            return 2 * torch.rand(n, *shape, generator=generator, device=device) - 1

        chosen = (torch.rand(n, generator=generator, device=device) < self.moved_share).float()
        mirror = even(2).sign() if self.mirror else torch.ones(n, 2, device=device)
        turn = chosen * even() * radians(self.turn_most_deg)
        shift = chosen[:, None] * even(2) * self.shift_most_mm
        scale = 1 + chosen * self.scale * torch.randn(n, generator=generator, device=device)
        return GeometricTransform(mirror, turn, shift, scale)


@dataclass(frozen=True)
class GeometricTransform:
    """Of n images: signs (n, 2) along x and y, angles (n) from x to y, shifts (n, 2) in mm, scales (n)."""

    mirror: Tensor
    turn_rad: Tensor
    shift_mm: Tensor
    scale: Tensor

    @property
    def linear(self) -> Tensor:
        """R·M, (n, 2, 2)."""
        cos, sin = self.turn_rad.cos(), self.turn_rad.sin()
        turn = torch.stack([torch.stack([cos, -sin], 1), torch.stack([sin, cos], 1)], 1)
        return turn * self.mirror[:, None, :]


def apply_transform(batch: TrainingBatch, move: GeometricTransform, mm_per_px: float) -> TrainingBatch:
    """Images, references and wrenches after it."""
    grid = _sampling_grid(move, batch.images.shape, mm_per_px)
    references = None if batch.references is None else _resample(batch.references, grid)
    return replace(
        batch,
        images=_resample(batch.images, grid),
        references=references,
        wrench=_transform_wrench(move, batch.wrench),
    )


def _transform_wrench(move: GeometricTransform, wrench: Tensor) -> Tensor:
    """(n, 6), N and N·m about the skin's centre."""
    sign = move.mirror.prod(1, keepdim=True)
    linear = move.linear
    force, torque = wrench[:, :3], wrench[:, 3:]
    f_plane = torch.einsum("nij,nj->ni", linear, force[:, :2])
    t_plane = sign * torch.einsum("nij,nj->ni", linear, torque[:, :2])
    force = torch.cat([f_plane, force[:, 2:]], 1)
    torque = torch.cat([t_plane, sign * torque[:, 2:]], 1)
    arm_m = nnf.pad(move.shift_mm, (0, 1)) / 1e3
    return torch.cat([force, torque + torch.linalg.cross(arm_m, force)], 1)


def _sampling_grid(move: GeometricTransform, shape: torch.Size, mm_per_px: float) -> Tensor:
    """For every pixel of the moved images, the place in the old ones, as `grid_sample` counts: (n, rows, cols, 2)."""
    n, rows, cols = shape
    # From the centre to the centre of the last pixel.
    half_mm = torch.tensor([(cols - 1) / 2, (rows - 1) / 2], device=move.shift_mm.device) * mm_per_px
    back = torch.linalg.inv(move.linear * move.scale[:, None, None])
    start = -torch.einsum("nij,nj->ni", back, move.shift_mm)
    theta = torch.cat([back * half_mm / half_mm[:, None], (start / half_mm)[..., None]], 2)
    return nnf.affine_grid(theta, [n, 1, rows, cols], align_corners=True)


def _resample(fields: Tensor, grid: Tensor) -> Tensor:
    """Fields (n, rows, cols) at those places; beyond the border they repeat."""
    found = nnf.grid_sample(fields[:, None], grid, mode="bicubic", padding_mode="border", align_corners=True)
    return found[:, 0]


@dataclass(frozen=True)
class HeightPerturbations:
    """Of a depth calibration and of its image; standard deviations but where it says most."""

    gain: float = 0.03
    """Of what is pressed in and, apart from it, of what bulges."""
    offset_mm: float = 0.004
    tilt: float = 0.0005
    """mm per mm, along x and along y."""
    noise_most_mm: float = 0.012
    noise_width_most_mm: float = 0.6
    """Of the Gaussian that makes noise smooth."""
    traits: float = 0.05
    """Of what is known of the sensor's light; its gel's thickness stays."""

    def __call__(self, batch: TrainingBatch, mm_per_px: float, generator: Generator) -> TrainingBatch:
        """Heights in mm, each with errors of its own."""
        z_mm = batch.images
        pressed, bulging = (1 + self.gain * _normal_samples(generator, len(z_mm), 1, 1) for _ in range(2))
        gained = torch.where(z_mm < 0, z_mm * pressed, z_mm * bulging)
        return replace(
            batch,
            images=gained + self.plane(z_mm, mm_per_px, generator) + self.noise(z_mm, mm_per_px, generator),
            traits=self.doubtful(batch.traits, generator),
        )

    def doubtful(self, traits: Tensor, generator: Generator) -> Tensor:
        """Another calibration would have told others."""
        off = 1 + self.traits * _normal_samples(generator, *traits.shape)
        return torch.cat([traits[:, :1], (traits * off)[:, 1:]], 1)

    def plane(self, z_mm: Tensor, mm_per_px: float, generator: Generator) -> Tensor:
        """Offset and tilt."""
        n, rows, cols = z_mm.shape
        x, y = (
            (torch.arange(side, device=z_mm.device) - (side - 1) / 2) * (mm_per_px * self.tilt) for side in (cols, rows)
        )
        offset, along_x, along_y = (_normal_samples(generator, n, 1, 1) for _ in range(3))
        return self.offset_mm * offset + along_x * x + along_y * y[:, None]

    def noise(self, z_mm: Tensor, mm_per_px: float, generator: Generator) -> Tensor:
        """As smooth in all images of a batch, in each as strong as chance has it."""
        if self.noise_most_mm == 0:
            return torch.zeros_like(z_mm)
        width_px = self.noise_width_most_mm / mm_per_px * torch.rand((), generator=generator, device=z_mm.device)
        strength = self.noise_most_mm * torch.rand(len(z_mm), 1, 1, generator=generator, device=z_mm.device)
        most_px = ceil(3 * self.noise_width_most_mm / mm_per_px)
        return strength * _smooth_noise(_normal_samples(generator, *z_mm.shape), width_px, most_px)


@dataclass(frozen=True)
class PhotometricPerturbations:
    """Of light and camera; standard deviations but where it says most."""

    gain: float = 0.05
    """Of image and reference: another lamp."""
    drift: float = 0.004
    """Of the reference against the image: the lamp has warmed up since."""
    noise_most_grey: float = 0.7

    def __call__(self, batch: TrainingBatch, generator: Generator) -> TrainingBatch:
        """Grey levels, each image and its reference with errors of their own."""
        assert batch.references is not None
        n = len(batch.images)
        gain, drift = (1 + part * _normal_samples(generator, n, 1, 1) for part in (self.gain, self.drift))
        strength = self.noise_most_grey * torch.rand(n, 1, 1, generator=generator, device=generator.device)
        images = batch.images * gain + strength * _normal_samples(generator, *batch.images.shape)
        return replace(batch, images=images.clamp(0, 255), references=(batch.references * gain * drift).clamp(0, 255))


def _normal_samples(generator: Generator, *shape: int) -> Tensor:
    """Normal numbers on the generator's device."""
    return torch.randn(*shape, generator=generator, device=generator.device)


def _smooth_noise(noise: Tensor, width_px: Tensor, most_px: int) -> Tensor:
    """White noise (n, rows, cols) through a Gaussian of this standard deviation, its own left at one."""
    reach = torch.arange(-most_px, most_px + 1, device=noise.device)
    kernel = torch.exp(-0.5 * (reach / width_px.clamp(min=1e-3)) ** 2)
    kernel = kernel / kernel.norm()
    across = nnf.conv2d(nnf.pad(noise[:, None], (most_px,) * 4, mode="circular"), kernel[None, None, None, :])
    return nnf.conv2d(across, kernel[None, None, :, None])[:, 0]


@dataclass(frozen=True)
class Augmentation:
    """How much is changed; every image of a batch for itself."""

    moves: GeometricAugmentation = GeometricAugmentation()
    heights: HeightPerturbations = HeightPerturbations()
    """Done to heights."""
    light: PhotometricPerturbations = PhotometricPerturbations()
    """Done to images."""

    def __call__(self, batch: TrainingBatch, mm_per_px: float, generator: torch.Generator) -> TrainingBatch:
        """Another batch of the same touches."""
        moved = self.moves(batch, mm_per_px, generator)
        if moved.references is None:
            return self.heights(moved, mm_per_px, generator)
        return self.light(moved, generator)


NO_AUGMENTATION = Augmentation(
    GeometricAugmentation(False, 0.0, 0.0, 0.0, 0.0),
    HeightPerturbations(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    PhotometricPerturbations(0.0, 0.0, 0.0),
)
