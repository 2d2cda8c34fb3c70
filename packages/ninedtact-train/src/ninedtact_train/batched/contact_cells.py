"""Many images → the signal of each on the cells of the traction inversion, and its contact region, as torch tensors.

The steps are those of `force.traction.observation` and `force.contact_detection` for images that are read alone: nothing is
remembered of a stream.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Bool, Float32
from torch.nn import functional

from ninedtact.force import contact_detection as detection
from ninedtact.force.traction import observation as on_cells
from ninedtact.quantities import HeightSource
from ninedtact.reading import CELL_MM
from ninedtact.robust_noise import STD_PER_MEDIAN
from ninedtact.shape.depth import SAMPLING_SIDE_PX
from ninedtact_train.batched.depth_reading import BatchedDepthReader, Fields, block_means, blurred

Views = Float32[torch.Tensor, "batch cell_rows cell_cols"]
Masks = Bool[torch.Tensor, "batch cell_rows cell_cols"]
Numbers = Float32[torch.Tensor, " batch"]


@dataclass(frozen=True)
class BatchedObservation:
    """`ObservationOnCells` of each image, with the contact region."""

    change: Views
    noise: Numbers
    z_mm: Views
    in_view: Views
    region: Views
    """One where pressure may act; zero elsewhere, and everywhere where nothing touches."""
    sight: "BatchedLinesOfSight"

    def select(self, indices: torch.Tensor) -> "BatchedObservation":
        """Return the observations of some images."""
        change, noise, z_mm, in_view, region = (
            part[indices] for part in (self.change, self.noise, self.z_mm, self.in_view, self.region)
        )
        sight = replace(self.sight, pixel=self.sight.pixel[indices])
        return BatchedObservation(change, noise, z_mm, in_view, region, sight)


@dataclass(frozen=True)
class BatchedLinesOfSight:
    """`LinesOfSight` of each observation."""

    inverse_distance_per_mm: float
    pixel: Float32[torch.Tensor, "batch cell_rows cell_cols 2"]
    """Where the cells were observed, from −1 to 1 across the image's plane."""

    def follow(
        self, field: Float32[torch.Tensor, "batch a b"], height_mm: Float32[torch.Tensor, "batch a b"]
    ) -> Float32[torch.Tensor, "batch a b"]:
        """Return a field of each skin where the lines of sight through the points of its grid meet it."""
        down, across = (torch.linspace(-1, 1, side, device=field.device) for side in field.shape[1:])
        plane = torch.stack(torch.meshgrid(across, down, indexing="xy"), -1)
        pixel = plane.expand(len(field), -1, -1, -1)
        for _ in range(on_cells.SIGHTLINE_ITERATIONS):
            pixel = plane * (1 + _sampled(height_mm, pixel) * self.inverse_distance_per_mm)[..., None]
        return _sampled(field, pixel)

    def observe(self, change: Views) -> Views:
        """Return the change of brightness that is observed on the cells, of that on lines of sight."""
        return _sampled(change, self.pixel)


@dataclass(frozen=True)
class BatchedObserver:
    """Observes the images of one sensor on the cells of its inversion."""

    reader: BatchedDepthReader
    model: on_cells.BrightnessObservationModel
    cells: on_cells.CellGrid
    settings: detection.ContactRegionSettings

    def __call__(self, grey: Fields, heights_mm: Fields) -> BatchedObservation:
        """Return the observations of rectified images and their heights."""
        z_mm, in_view, pixel = self._orthorectified(heights_mm)
        change = _sampled(self._relative_change(grey), pixel)
        pixel_noise = self._pixel_noise(grey)
        largest = self._largest_noise(pixel_noise, int(np.prod(self.cells.image_shape)))
        noise = cell_noise(change).clamp(min=on_cells.MIN_BRIGHTNESS_NOISE).minimum(largest)
        least = self._correlated_noise_limit(grey, pixel_noise)
        region = self._region(change, z_mm, in_view, noise, least)
        sight = BatchedLinesOfSight(1 / self.reader.reader.camera_distance_mm, pixel)
        return BatchedObservation(change, noise, z_mm, in_view, region, sight)

    def average(self, fields: Fields) -> Views:
        """Return `CellGrid.average` of each field."""
        down, across = self._averaging
        return down @ fields @ across

    def _orthorectified(
        self, heights_mm: Fields
    ) -> tuple[Views, Views, Float32[torch.Tensor, "batch cell_rows cell_cols 2"]]:
        """Return heights and visibility on the cells, and the pixel of each cell's line of sight (from −1 to 1)."""
        z_mm = self.average(heights_mm)
        seen_mm = z_mm * self._seen_before
        per_distance = 1 / self.reader.reader.camera_distance_mm
        found_mm = torch.zeros_like(seen_mm)
        for _ in range(on_cells.SIGHTLINE_ITERATIONS + 1):
            pixel = self._places / (1 + found_mm * per_distance)[..., None]
            found_mm = _sampled(seen_mm, pixel)
        seen = self._seen_before.expand_as(seen_mm)[:, None]
        in_view = functional.grid_sample(seen, pixel, "nearest", "zeros", align_corners=True)[:, 0]
        return _sampled(z_mm, pixel), in_view, pixel

    def _relative_change(self, grey: Fields) -> Views:
        """Return the relative change of brightness, corrected for the global loss of light."""
        ratio = block_means(grey, SAMPLING_SIDE_PX) / block_means(self._reference, SAMPLING_SIDE_PX).clamp(min=1)
        lost = self.reader.lost_light(ratio)
        return self.average(grey) / self.average(self._reference).clamp(min=1) / (1 + lost) - 1

    def _pixel_noise(self, grey: Fields) -> Numbers:
        """Return the standard deviation of a pixel's relative brightness."""
        rows = np.s_[:, :: detection.NOISE_EVERY_ROWS]
        brightness = grey[rows] / self._reference[rows].clamp(min=1)
        return robust_std(brightness.diff(n=2, dim=2)) / 6**0.5

    def _largest_noise(self, pixel_noise: Numbers, cells: int) -> Numbers:
        """Return `cell_noise_upper_bound` of each image."""
        share = detection.MAX_NOISE_PER_PIXEL_NOISE * (cells / self._reference[0].numel()) ** 0.5
        return (share * pixel_noise).clamp(min=detection.MAX_NOISE)

    def _correlated_noise_limit(self, grey: Fields, pixel_noise: Numbers) -> Numbers:
        """Return `correlated_noise_limit` of images without a stream."""
        level = self._reference[:, :: detection.NOISE_EVERY_ROWS].mean().clamp(min=1)
        rounding = torch.exp(-2 * (np.pi * detection.INTERPOLATED * pixel_noise * level) ** 2) / level
        (down, across), (fewer_down, fewer_across) = self._detection_averaging
        signal = (down @ grey @ across) / (down @ self._reference @ across).clamp(min=1)
        coarse = (2 * cell_noise(fewer_down @ signal @ fewer_across)).clamp(max=detection.MAX_NOISE)
        return rounding.maximum(self._noise_limit(coarse, 0.0, detection.SMOOTHING_CELLS))

    def _noise_limit(self, noise: Numbers, least: float, smoothing_cells: float) -> Numbers:
        noise = detection.smoothed_noise(noise, smoothing_cells)
        return (self.settings.threshold.noise_stds * noise).clamp(min=least)

    def _region(self, change: Views, z_mm: Views, in_view: Views, noise: Numbers, least: Numbers) -> Views:
        """Return `find_contact_region` of each image; zero everywhere where nothing touches."""
        settings, threshold, seen = self.settings, self.settings.threshold, in_view > 0
        darkening = smoothed((_median(change, seen) - change) * in_view, settings.smoothing_cells)
        limit = self._noise_limit(noise, threshold.min_darkening, settings.smoothing_cells).maximum(least)
        limit = limit[:, None, None]
        darkening = _without_light_at_border(darkening, seen, limit, threshold.border_darkening)
        darkest = darkening.amax((1, 2), keepdim=True)
        pressed, deep = self._pressed_and_deep(change, z_mm, seen)
        dark = darkening > (settings.dark_fraction * darkest).maximum(limit)
        parts = spread_over_parts((pressed & deep).to(z_mm.dtype), pressed, cross=True) > 0
        return widened((parts | dark).to(z_mm.dtype)) * (darkest > limit)

    def _pressed_and_deep(self, change: Views, z_mm: Views, seen: Masks) -> tuple[Masks, Masks]:
        """Return the cells on indented skin, and the cells deep enough to be more than noise (`ContactRegionSettings`)."""
        settings, margin = self.settings, on_cells.MARGIN_CELLS
        depth_mm = -z_mm[:, margin:-margin, margin:-margin].amin((1, 2), keepdim=True).clamp(max=0)
        deep = z_mm < -(settings.deep_fraction * depth_mm).clamp(min=settings.deep_mm)
        deep = deep & (change < settings.thin_fraction * change.amin((1, 2), keepdim=True))
        level_mm = _median(z_mm, seen).maximum(-settings.level_fraction * depth_mm).clamp(max=0)
        pressed = z_mm < level_mm - (settings.shallow_fraction * depth_mm).clamp(min=settings.shallow_mm)
        return pressed & (change <= settings.bright_fraction * change.amax((1, 2), keepdim=True).clamp(min=0)), deep

    @cached_property
    def _reference(self) -> Fields:
        return torch.as_tensor(self.reader.reader.reference.grey, device=self.reader.device)[None]

    @cached_property
    def _averaging(self) -> tuple[torch.Tensor, torch.Tensor]:
        down, across = self.cells.averaging_weights(self._reference.shape[1:])
        return self._weights(down), self._weights(across.T)

    @cached_property
    def _detection_averaging(self) -> tuple[tuple[torch.Tensor, torch.Tensor], ...]:
        """The weights of pixels in the cells of the contact detection, and those of these cells in others twice as large."""
        sides = self._reference.shape[1:]
        cells = [max(round(side * self.cells.mm_per_px / CELL_MM), 1) for side in sides]
        coarse = [count // 2 for count in cells]
        pairs = (sides, cells), (cells, coarse)
        each = ([area_weights(many, few) for many, few in zip(*pair, strict=True)] for pair in pairs)
        return tuple((self._weights(down), self._weights(across.T)) for down, across in each)

    @cached_property
    def _seen_before(self) -> Float32[torch.Tensor, "cell_rows cell_cols"]:
        """One on the cells of the averaged height map that are in view."""
        in_view = self.reader.reader.lens_source != HeightSource.OUT_OF_VIEW
        fraction = self.cells.average(in_view.astype(np.float32)) * self.cells.on_image
        return self._weights((fraction > 0.5).astype(np.float32))

    @cached_property
    def _places(self) -> Float32[torch.Tensor, "cell_rows cell_cols 2"]:
        """The cells' places from −1 to 1 between the middles of the first and last one."""
        rows, cols = self.cells.shape
        half_mm = np.array([cols - 1, rows - 1]) * self.cells.pitch_mm / 2
        return self._weights(np.stack(self.cells.coordinates_mm, axis=-1) / half_mm)

    def _weights(self, values: np.ndarray) -> torch.Tensor:
        return torch.as_tensor(np.ascontiguousarray(values), dtype=torch.float32, device=self.reader.device)


def smoothed(fields: Views, sigma_cells: float, reach: int | None = None) -> Views:
    """Return `cv2.GaussianBlur` of each field, with its own reach where none is given."""
    return blurred(fields, sigma_cells, round(8 * sigma_cells + 1) // 2 if reach is None else reach, "reflect")


def widened(fields: Views) -> Views:
    """Return the largest value of each cell and its four neighbours."""
    down, across = (functional.max_pool2d(fields[:, None], side, 1, pad)[:, 0] for side, pad in _CROSS)
    return down.maximum(across)


_CROSS = ((3, 1), (1, 0)), ((1, 3), (0, 1))


def spread_over_parts(values: Views, mask: Masks, cross: bool = False) -> Views:
    """Return the largest of values above zero in each connected part of a mask, on all of its cells; zero outside the mask.

    cross: cells are connected to four neighbours, not eight. A part that winds further than both sides of the grid together is not
    reached to its end.
    """
    inside = mask.to(values.dtype)
    found = values * inside
    for _ in range(sum(values.shape[1:])):
        wider = widened(found) if cross else functional.max_pool2d(found[:, None], 3, 1, 1)[:, 0]
        found = wider * inside
    return found


def robust_std(deviations: Float32[torch.Tensor, "batch a b"]) -> Numbers:
    """Return `robust_noise.robust_std` of each image."""
    return STD_PER_MEDIAN * _median(deviations.abs().flatten(1)[:, None])[:, 0, 0]


def cell_noise(fields: Views) -> Numbers:
    """Return `estimate_cell_noise` of each field."""
    return robust_std(fields - smoothed(fields, detection.NOISE_SMOOTHING_CELLS, 1)) / detection.SMOOTHING_RESIDUE


def area_weights(many: int, few: int) -> np.ndarray:
    """Return the weights of many pixels in the means of fewer equal cells over them, (few, many)."""
    ends = np.arange(few + 1) * (many / few)
    inside = np.diff(np.clip(ends[:, None] - np.arange(many), 0, 1), axis=0)
    return np.asarray(inside / inside.sum(axis=1, keepdims=True))


def _sampled(fields: Views, pixel: torch.Tensor) -> Views:
    """Interpolate each field at the pixels; beyond the border its values repeat."""
    return functional.grid_sample(fields[:, None], pixel, "bilinear", "border", align_corners=True)[:, 0]


def _median(fields: Views, where: Masks | None = None) -> Float32[torch.Tensor, "batch 1 1"]:
    """Return the median of each field, or of its cells where a mask holds."""
    values = fields.flatten(1) if where is None else fields.masked_fill(~where, torch.inf).flatten(1)
    ordered, size = values.sort(dim=1).values, values.shape[1]
    count = torch.full_like(values[:, :1], size) if where is None else where.flatten(1).sum(1, keepdim=True)
    low, high = (
        ordered.gather(1, (count - odd).div(2, rounding_mode="floor").long().clamp(0, size - 1)) for odd in (1, 0)
    )
    return ((low + high) / 2)[:, :, None]


def _without_light_at_border(
    darkening: Views, seen: Masks, limit: Float32[torch.Tensor, "batch 1 1"], bright: float
) -> Views:
    """Return `contact_detection`'s darkening without parts that are darkest at the border of the view and not dark enough."""
    inner = 1 - functional.max_pool2d(1 - functional.pad(seen.to(darkening.dtype), (2, 2, 2, 2))[:, None], 5, 1)[:, 0]
    above = darkening > limit
    darkest = spread_over_parts(darkening, above)
    at_border = (darkening >= darkest) & above & seen & (inner == 0)
    light = (spread_over_parts(at_border.to(darkening.dtype), above) > 0) & (darkest < bright)
    return darkening.masked_fill(light, 0.0)
