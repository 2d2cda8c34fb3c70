"""What spoils an image and leaves the wrench as it is: errors of a height map, and of light and camera."""

from dataclasses import dataclass, replace
from math import ceil

import torch
import torch.nn.functional as nnf
from torch import Generator, Tensor

from ninedtact.force.training.batches import TouchBatch


@dataclass(frozen=True)
class HeightErrors:
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

    def __call__(self, batch: TouchBatch, mm_per_px: float, generator: Generator) -> TouchBatch:
        """Heights in mm, each with errors of its own."""
        z_mm = batch.images
        pressed, bulging = (1 + self.gain * normal(generator, len(z_mm), 1, 1) for _ in range(2))
        gained = torch.where(z_mm < 0, z_mm * pressed, z_mm * bulging)
        return replace(
            batch,
            images=gained + self.plane(z_mm, mm_per_px, generator) + self.noise(z_mm, mm_per_px, generator),
            traits=self.doubtful(batch.traits, generator),
        )

    def doubtful(self, traits: Tensor, generator: Generator) -> Tensor:
        """Another calibration would have told others."""
        off = 1 + self.traits * normal(generator, *traits.shape)
        return torch.cat([traits[:, :1], (traits * off)[:, 1:]], 1)

    def plane(self, z_mm: Tensor, mm_per_px: float, generator: Generator) -> Tensor:
        """Offset and tilt."""
        n, rows, cols = z_mm.shape
        x, y = (
            (torch.arange(side, device=z_mm.device) - (side - 1) / 2) * (mm_per_px * self.tilt) for side in (cols, rows)
        )
        offset, along_x, along_y = (normal(generator, n, 1, 1) for _ in range(3))
        return self.offset_mm * offset + along_x * x + along_y * y[:, None]

    def noise(self, z_mm: Tensor, mm_per_px: float, generator: Generator) -> Tensor:
        """As smooth in all images of a batch, in each as strong as chance has it."""
        if self.noise_most_mm == 0:
            return torch.zeros_like(z_mm)
        width_px = self.noise_width_most_mm / mm_per_px * torch.rand((), generator=generator, device=z_mm.device)
        strength = self.noise_most_mm * torch.rand(len(z_mm), 1, 1, generator=generator, device=z_mm.device)
        most_px = ceil(3 * self.noise_width_most_mm / mm_per_px)
        return strength * smoothed(normal(generator, *z_mm.shape), width_px, most_px)


@dataclass(frozen=True)
class LightErrors:
    """Of light and camera; standard deviations but where it says most."""

    gain: float = 0.05
    """Of image and reference: another lamp."""
    drift: float = 0.004
    """Of the reference against the image: the lamp has warmed up since."""
    noise_most_grey: float = 0.7

    def __call__(self, batch: TouchBatch, generator: Generator) -> TouchBatch:
        """Grey levels, each image and its reference with errors of their own."""
        assert batch.references is not None
        n = len(batch.images)
        gain, drift = (1 + part * normal(generator, n, 1, 1) for part in (self.gain, self.drift))
        strength = self.noise_most_grey * torch.rand(n, 1, 1, generator=generator, device=generator.device)
        images = batch.images * gain + strength * normal(generator, *batch.images.shape)
        return replace(batch, images=images.clamp(0, 255), references=(batch.references * gain * drift).clamp(0, 255))


def normal(generator: Generator, *shape: int) -> Tensor:
    """Normal numbers on the generator's device."""
    return torch.randn(*shape, generator=generator, device=generator.device)


def smoothed(noise: Tensor, width_px: Tensor, most_px: int) -> Tensor:
    """White noise (n, rows, cols) through a Gaussian of this standard deviation, its own left at one."""
    reach = torch.arange(-most_px, most_px + 1, device=noise.device)
    kernel = torch.exp(-0.5 * (reach / width_px.clamp(min=1e-3)) ** 2)
    kernel = kernel / kernel.norm()
    across = nnf.conv2d(nnf.pad(noise[:, None], (most_px,) * 4, mode="circular"), kernel[None, None, None, :])
    return nnf.conv2d(across, kernel[None, None, :, None])[:, 0]
