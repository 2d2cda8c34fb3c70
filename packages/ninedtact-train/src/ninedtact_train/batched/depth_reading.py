"""Many images of one calibrated sensor at once → heights of the skin, as torch tensors that never leave their device.

The steps are those of `ninedtact.shape` and of `BaseDeflection`, which read one image with OpenCV: rectify, restore the lost light,
deblur, look heights up, smooth them, add the deflection of the base. Heights agree with theirs to rounding, because a policy must
see in training what the sensor will show it. Changes of a real camera's light, bands and dirt are not corrected.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import cv2
import numpy as np
import torch
from jaxtyping import Float32, Shaped, UInt8
from torch.nn import functional

from ninedtact.design import Gel
from ninedtact.errors import InputError
from ninedtact.mechanics import base_deflection as base
from ninedtact.mechanics.finite_strain import finite_strain_stiffening
from ninedtact.mechanics.skin import PeriodicGrid, padded_grid
from ninedtact.quantities import HeightSource
from ninedtact.shape import deblurring as blur
from ninedtact.shape import depth
from ninedtact.shape.calibrated_shape import DepthReader
from ninedtact.shape.lens_and_rectification import Rectification

Fields = Float32[torch.Tensor, "batch rows cols"]
Few = Float32[torch.Tensor, "batch few_rows few_cols"]
Padded = Float32[torch.Tensor, "batch tall wide"]


@dataclass(frozen=True)
class BatchedDepthReader:
    """Reads heights against one reference image.

    >>> reader = BatchedDepthReader(shape.rectify, shape.depth_reader(reference), "cuda")
    >>> heights_mm = reader(batch.images(press))
    """

    rectify: Rectification
    reader: DepthReader
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.reader.deblurring is None:
            raise InputError(
                expected="a calibration that knows how light scatters",
                got="one without",
                remedy="calibrate with the method 'physics'",
            )

    def __call__(self, images: Shaped[torch.Tensor, "batch raw_rows raw_cols"]) -> Fields:
        """Return the signed heights in mm on the rectified grid. images: grey, uint8, on the device of the reader.

        Raises `InputError` as `require_own` does.
        """
        self.require_own(images)
        return self.heights_mm(self.rectified(images))

    def require_own(self, images: Shaped[torch.Tensor, "..."]) -> None:
        """Raise `InputError` for images of another type, shape or device, and for no images."""
        wanted, device = self.rectify.raw_shape, torch.device(self.device)
        if (
            images.dtype != torch.uint8
            or images.ndim != 3
            or not len(images)
            or tuple(images.shape[1:]) != wanted
            or images.device.type != device.type
        ):
            raise InputError(
                expected=f"one or more grey images (batch, {wanted[0]}, {wanted[1]}) of type uint8 on {device}",
                got=f"{tuple(images.shape)} of {images.dtype} on {images.device}",
                remedy="convert them",
            )

    def heights_mm(self, grey: Fields) -> Fields:
        """Return the signed heights in mm of rectified images."""
        few_mm = self._look_up_mm(self._restored_brightness(grey))
        if sigma_px := self.reader.smoothing.on_grid(1 / self._coarseness).combined_px:
            few_mm = blurred(few_mm, sigma_px, round(3 * sigma_px), "replicate")
        if self.reader.base_deflection is not None:
            few_mm = few_mm + self._base_deflection_mm(few_mm)
        heights = _upsampled(few_mm, self._coarseness, self.reader.lens_source.shape)
        return heights * self._in_view if self.reader.curve.knows_bulges else heights.clamp(max=0) * self._in_view

    def rectified(self, images: UInt8[torch.Tensor, "batch raw_rows raw_cols"]) -> Fields:
        """Return the grey levels on the rectified grid."""
        places = self._source_places.expand(len(images), -1, -1, -1)
        grey = images[:, None].to(torch.float32)
        found = functional.grid_sample(grey, places, "bilinear", "border", align_corners=True)
        return found[:, 0]

    def _restored_brightness(self, grey: Fields) -> Few:
        """Return the brightness relative to the reference image on the coarser grid, without lost and scattered light."""
        ratio = block_means(grey, self._coarseness) * self._per_coarse_reference
        return self._deblurred(ratio / (1 + self.lost_light(ratio)))

    def lost_light(self, ratio: Few) -> Float32[torch.Tensor, "batch 1 1"]:
        """Return `GlobalDimmingModel.loss_of` each field."""
        loss = ratio.new_zeros(len(ratio), 1, 1)
        for _ in range(depth.DIMMING_ITERATIONS if self.reader.loss.global_dimming else 0):
            darkening = 1 - ratio / (1 + loss)
            noticed = darkening * (darkening > depth.MIN_DARKENING)
            loss = -self.reader.loss.global_dimming * noticed.mean((1, 2), keepdim=True)
        return loss

    def _deblurred(self, field: Fields) -> Fields:
        """Return `deconvolve_gaussian_blur` of each field."""
        spread, inverse, weight, threshold = self._deblurring
        rows, cols = field.shape[1:]
        tall, wide = spread.shape[0], 2 * (spread.shape[1] - 1)
        down, right = tall - rows, wide - cols
        padded = _mirrored(field, down // 2, down - down // 2, right // 2, right - right // 2)
        data = torch.fft.rfft2(padded) * spread
        sharp = torch.fft.irfft2(data * inverse, s=(tall, wide))
        kept = padded.new_zeros(2, *padded.shape)
        for _ in range(blur.EDGE_ITERATIONS):
            gradient = torch.stack([sharp.roll(-1, axis) - sharp for axis in (1, 2)]) + kept
            kept = gradient * (threshold / gradient.square().sum(0).sqrt().clamp(min=threshold))
            edges = gradient - 2 * kept
            divergence = sum(edge.roll(1, axis) - edge for edge, axis in zip(edges, (1, 2), strict=True))
            sharp = torch.fft.irfft2((torch.fft.rfft2(divergence) * weight + data) * inverse, s=(tall, wide))
        return sharp[:, down // 2 : down // 2 + rows, right // 2 : right // 2 + cols]

    def _look_up_mm(self, brightness: Fields) -> Fields:
        steps = depth.TABLE_STEPS["ratio"]
        index = (brightness * steps + (depth.ZERO_INDEX - steps)).round().clamp(0, depth.TABLE_SIZE - 1)
        return self._table[index.to(torch.int64)]

    def _base_deflection_mm(self, thickness_change_mm: Fields) -> Fields:
        """Return `BaseDeflection` of each field."""
        deflection = self.reader.base_deflection
        assert deflection is not None
        if deflection.gel.has_rigid_base:
            return torch.zeros_like(thickness_change_mm)
        rows, cols = thickness_change_mm.shape[1:]
        mm_per_px = self.reader.reference.mm_per_px * self._coarseness
        side = max(round(base.DEFLECTION_PITCH_MM / mm_per_px), 1)
        few = block_means(thickness_change_mm, side)
        pitch_mm, (few_rows, few_cols) = side * mm_per_px, few.shape[1:]
        grid = padded_grid(few_cols * pitch_mm, few_rows * pitch_mm, pitch_mm, base.DEFLECTION_MARGIN_MM)
        padded = functional.pad(few, (0, grid.cols - few_cols, 0, grid.rows - few_rows))
        waves = _waves_on_device(grid, deflection.gel, self.device)
        spectrum = torch.fft.rfft2(padded)
        share = waves.share_of_interface(waves.shear_over_pressure(spectrum, few))
        deflected = spectrum * share
        if deflection.gel.finite_strain:
            height_mm = padded + torch.fft.irfft2(deflected, s=grid.shape)
            stiffening = finite_strain_stiffening(height_mm, padded, deflection.gel)
            added = torch.fft.rfft2(deflection.stiffening * (stiffening - 1) * padded.clamp(max=0))
            deflected = deflected + share * (added + share * added)
        interface = torch.fft.irfft2(deflected, s=grid.shape)[:, :few_rows, :few_cols]
        return _upsampled(interface.contiguous(), side, (rows, cols))

    @cached_property
    def _coarseness(self) -> int:
        return self.reader.coarseness

    @cached_property
    def _source_places(self) -> torch.Tensor:
        """The source pixels from −1 to 1, as `grid_sample` takes them."""
        rows, cols = self.rectify.raw_shape
        source = self.rectify.source_px * (2 / np.array([cols - 1, rows - 1])) - 1
        return torch.as_tensor(source[None], dtype=torch.float32, device=self.device)

    @cached_property
    def _per_coarse_reference(self) -> torch.Tensor:
        return torch.as_tensor(self.reader.per_coarse_reference, device=self.device)

    @cached_property
    def _table(self) -> torch.Tensor:
        return torch.as_tensor(self.reader.curve.table, device=self.device)

    @cached_property
    def _in_view(self) -> torch.Tensor:
        in_view = self.reader.lens_source != HeightSource.OUT_OF_VIEW
        return torch.as_tensor(in_view, dtype=torch.float32, device=self.device)

    @cached_property
    def _deblurring(self) -> tuple[Any, Any, float, float]:
        """The transform of the point spread, the inverse, the weight of edges and the steepness from which one counts."""
        deblurring, mm_per_px = self.reader.deblurring, self.reader.reference.mm_per_px
        assert deblurring is not None
        sigma_px = round(deblurring.point_spread_mm / mm_per_px / self._coarseness, 6)
        packed, _ = blur.deconvolution_symbols(*self.reader.per_coarse_reference.shape, sigma_px, deblurring.floor)
        tall, wide = packed.shape
        kx, ky = np.fft.rfftfreq(wide), np.abs(np.fft.fftfreq(tall))[:, None]
        spread = np.exp(-2 * (np.pi * sigma_px) ** 2 * (kx**2 + ky**2))
        weight = deblurring.floor * sigma_px**2
        variation = weight * 4 * (np.sin(np.pi * kx) ** 2 + np.sin(np.pi * ky) ** 2)
        symbols = (
            torch.as_tensor(one, dtype=torch.float32, device=self.device)
            for one in (spread, 1 / (spread**2 + variation))
        )
        return *symbols, weight, blur.LEAST_EDGE_STEP / sigma_px  # type: ignore[return-value]


@dataclass(frozen=True)
class _DeviceWaves:
    """`HeldSkinWaves` on a device, of which each image of a batch has shear of its own."""

    shape: tuple[int, int]
    thinning: torch.Tensor
    interface: torch.Tensor
    thinning_by_shear: torch.Tensor
    interface_by_shear: torch.Tensor
    blur: torch.Tensor

    def share_of_interface(self, shear_over_pressure: torch.Tensor) -> torch.Tensor:
        """Return the height of the interface over the change of thickness."""
        return self._with_shear(self.interface, self.interface_by_shear, shear_over_pressure) / self._thinning(
            shear_over_pressure
        )

    def shear_over_pressure(self, spectrum: torch.Tensor, seen_mm: Fields) -> torch.Tensor:
        """Return the shear over the pressure of each image, (batch, 2), by a fixed number of steps; one that has ended stays."""
        deepest_mm, (rows, cols) = seen_mm.amin((1, 2), keepdim=True), seen_mm.shape[1:]
        touched = (seen_mm <= base.EDGE_OF_CONTACT * deepest_mm).to(torch.float32)
        free = 1 - functional.max_pool2d(touched, 3, 1, 1)
        going = (deepest_mm[:, 0, 0] <= -base.LEAST_THINNING_MM) & free.bool().any(-1).any(-1)
        ratio = seen_mm.new_zeros(len(seen_mm), 2)
        for _ in range(base.SHEAR_STEPS):
            thinning = self._thinning(ratio)
            pressure = spectrum * self.blur / thinning
            by_shear = pressure[:, None] * self.thinning_by_shear / thinning[:, None]
            fields = torch.fft.irfft2(torch.cat([pressure[:, None], by_shear], 1), s=self.shape)[..., :rows, :cols]
            wrong, derivatives = (fields * free[:, None]).flatten(2).to(torch.float64).split([1, 2], 1)
            gram, right = derivatives @ derivatives.mT, derivatives @ wrong.mT
            gram = gram + 1e-30 * torch.eye(2, dtype=gram.dtype, device=gram.device)
            step = going[:, None] * torch.linalg.solve(gram, right)[..., 0].to(ratio.dtype)
            ratio = ratio + step
            ratio = ratio / (ratio.norm(dim=1, keepdim=True) / base.MAX_SHEAR).clamp(min=1)
            going = going & (step.abs().amax(1) >= base.SMALL_SHEAR)
        return ratio

    def _thinning(self, shear_over_pressure: torch.Tensor) -> torch.Tensor:
        return self._with_shear(self.thinning, self.thinning_by_shear, shear_over_pressure)

    @staticmethod
    def _with_shear(alone: torch.Tensor, by_shear: torch.Tensor, shear_over_pressure: torch.Tensor) -> torch.Tensor:
        s_x, s_y = shear_over_pressure[:, :, None, None].unbind(1)
        return alone + s_x * by_shear[0] + s_y * by_shear[1]


@lru_cache(maxsize=4)
def _waves_on_device(grid: PeriodicGrid, gel: Gel, device: str) -> _DeviceWaves:
    """Return the responses of a gel for every wave of a grid, on a device."""
    waves = base.held_skin_waves(grid, gel)
    names = ("thinning", "interface", "thinning_by_shear", "interface_by_shear", "blur")
    return _DeviceWaves(waves.grid.shape, *(torch.as_tensor(getattr(waves, name), device=device) for name in names))


def block_means(fields: Fields, side: int) -> Few:
    """Return `deblurring.block_means` of each field."""
    rows, cols = fields.shape[1:]
    padded = functional.pad(fields[:, None], (0, -cols % side, 0, -rows % side), "replicate")
    return functional.avg_pool2d(padded, side)[:, 0]


def _upsampled(fields: Few, fineness: int, shape: tuple[int, ...]) -> Fields:
    """Return `deblurring.upsample` of each field."""
    fine = functional.interpolate(fields[:, None], scale_factor=fineness, mode="bicubic", align_corners=False)
    return fine[:, 0, : shape[0], : shape[1]]


def blurred(fields: Fields, sigma_px: float, reach: int, border: str) -> Fields:
    """Return the Gaussian blur of each field; border: how it goes on beyond its border, as `torch.nn.functional.pad` names it."""
    kernel = _gaussian_column(sigma_px, reach, str(fields.device))
    padded = functional.pad(fields[:, None], (reach, reach, reach, reach), border)
    return functional.conv2d(functional.conv2d(padded, kernel), kernel.mT)[:, 0]


@lru_cache(maxsize=16)
def _gaussian_column(sigma_px: float, reach: int, device: str) -> Float32[torch.Tensor, "1 1 n 1"]:
    """Return the weights of a Gaussian mean on a device."""
    weights = cv2.getGaussianKernel(2 * reach + 1, sigma_px, cv2.CV_32F)
    return torch.as_tensor(weights, device=device)[None, None]


def _mirrored(fields: Fields, above: int, below: int, left: int, right: int) -> Padded:
    """Return the fields with a mirrored border, whose first row repeats the last one (`cv2.BORDER_REFLECT`)."""
    rows, cols = fields.shape[1:]
    down, across = (
        np.abs((np.arange(-before, side + after) + side + 0.5) % (2 * side) - side).astype(int)
        for before, side, after in ((above, rows, below), (left, cols, right))
    )
    return fields[:, torch.as_tensor(down, device=fields.device)][:, :, torch.as_tensor(across, device=fields.device)]
