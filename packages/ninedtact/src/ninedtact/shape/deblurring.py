"""Undoes the scattering of light in the gel: a deconvolution of the brightness by its Gaussian point spread that keeps edges.

A linear filter rings at the rim of a flat object, so that the skin under it would appear deeper than it is. The sharpened field x
minimises |PSF ⊗ x − image|² + its total variation, which prefers plateaus with steps between them, by a few iterations of the
split Bregman method (Goldstein and Osher 2009, docs/references.md). All iterations run on a grid that is no finer than the
point spread needs.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import cv2
import numpy as np
from jaxtyping import Float32, Shaped
from msgspec import Meta
from numpy import ndarray as Array

_DFT_SIDE_FACTOR = 4
"""Sides of transformed fields are multiples of it, for which the transform is fastest."""
_MIN_POINTS_PER_SPREAD = 1.6
"""Smallest number of points of the coarser grid in one standard deviation of the point spread."""
_MAX_COARSENESS = 4
EDGE_ITERATIONS = 2
"""Iterations after the first, linear one; more change heights by less than the noise does."""
LEAST_EDGE_STEP = 0.009
"""Relative change of brightness over one standard deviation of the point spread that counts as an edge; it is several times the
noise, and less than a step of 0.1 mm."""

Field = Float32[Array, "rows cols"]


@dataclass(frozen=True)
class Deblurring:
    """Deconvolution of the brightness by its Gaussian point spread."""

    point_spread_mm: Annotated[float, Meta(ge=0.01, le=5)]
    """Standard deviation of the point spread."""
    floor: Annotated[float, Meta(ge=1e-4, le=1)] = 0.01
    """Weight ρ of the variation beside the image, for waves of 2π standard deviations; the smaller, the sharper and the noisier."""

    def coarseness(self, mm_per_px: float) -> int:
        """Return the pixels along one side of a point of the coarser grid; it resolves the point spread, and nothing is finer."""
        return int(np.clip(self.point_spread_mm / mm_per_px / _MIN_POINTS_PER_SPREAD, 1, _MAX_COARSENESS))

    def __call__(self, few: Field, mm_per_px: float) -> Field:
        """Return a field on the coarser grid as it was before scattering; beyond its border it is taken as mirrored.

        mm_per_px: of the image, not of the coarser grid.
        """
        return deconvolve_gaussian_blur(few, self.point_spread_mm / mm_per_px / self.coarseness(mm_per_px), self.floor)


def block_means(field: Float32[Array, "rows cols"], side: int) -> Float32[Array, "few_rows few_cols"]:
    """Return the means of square blocks; rows and columns that are missing in the last ones repeat the border."""
    rows, cols = field.shape
    if rows % side or cols % side:
        field = cv2.copyMakeBorder(field, 0, -rows % side, 0, -cols % side, cv2.BORDER_REPLICATE)
    # OpenCV computes means of whole blocks ten times faster than those with parts of pixels, and those of 2 x 2 pixels fastest.
    for part in (2, side // 2) if side % 2 == 0 else (side,):
        rows, cols = field.shape
        field = np.asarray(cv2.resize(field, (cols // part, rows // part), interpolation=cv2.INTER_AREA))
    return field


def upsample(
    field: Shaped[Array, "few_rows few_cols"], shape: tuple[int, ...], fineness: int
) -> Shaped[Array, "rows cols"]:
    """Return a field on a grid of this shape that is finer by a whole factor, by cubic interpolation."""
    rows, cols = field.shape
    fine = cv2.resize(field, (cols * fineness, rows * fineness), interpolation=cv2.INTER_CUBIC)
    return np.ascontiguousarray(fine[: shape[0], : shape[1]])


def deconvolve_gaussian_blur(field: Field, sigma_px: float, floor: float) -> Field:
    """Return the field deblurred on its own grid; a uniform field is returned as it is."""
    rows, cols = field.shape
    spread, inverse = deconvolution_symbols(rows, cols, round(sigma_px, 6), floor)
    down, right = spread.shape[0] - rows, spread.shape[1] - cols
    padded = cv2.copyMakeBorder(field, down // 2, down - down // 2, right // 2, right - right // 2, cv2.BORDER_REFLECT)
    data = _transform(padded) * spread
    weight, threshold = floor * sigma_px**2, np.float32(LEAST_EDGE_STEP / sigma_px)
    sharp = _inverse_transform(data * inverse)
    kept = np.zeros((2, *padded.shape), np.float32)  # b, the part of the gradient that is no edge
    for _ in range(EDGE_ITERATIONS):
        gradient = _gradient(sharp)
        gradient += kept
        # Not by `cv2.magnitude`, whose last digit depends on where the arrays lie in memory.
        steepness = np.sqrt(np.square(gradient[0]) + np.square(gradient[1]))
        np.multiply(gradient, threshold / np.maximum(steepness, threshold), out=kept)
        gradient -= 2 * kept
        edges = _transform(_negative_divergence(gradient))
        edges *= np.float32(weight)
        edges += data
        edges *= inverse
        sharp = _inverse_transform(edges)
    return np.ascontiguousarray(sharp[down // 2 : down // 2 + rows, right // 2 : right // 2 + cols])


def _transform(field: Field) -> Field:
    aligned = _aligned_copy(field)
    return np.asarray(cv2.dft(aligned, dst=aligned))


def _inverse_transform(transform: Field) -> Field:
    aligned, flags = _aligned_copy(transform), cv2.DFT_INVERSE | cv2.DFT_SCALE | cv2.DFT_REAL_OUTPUT
    return np.asarray(cv2.dft(aligned, dst=aligned, flags=flags))


def _aligned_copy(field: Field) -> Field:
    """Return a copy that begins at a multiple of 64 bytes: the last digit of `cv2.dft` depends on where a field lies in memory."""
    memory = np.empty(field.nbytes + 64, np.uint8)
    start = -memory.ctypes.data % 64
    aligned = memory[start : start + field.nbytes].view(np.float32).reshape(field.shape)
    aligned[...] = field
    return aligned


def _gradient(field: Field) -> Float32[Array, "2 rows cols"]:
    """Return the forward differences along rows and columns of a periodic field."""
    steps = np.empty((2, *field.shape), np.float32)
    np.subtract(field[1:], field[:-1], out=steps[0, :-1])
    np.subtract(field[0], field[-1], out=steps[0, -1])
    np.subtract(field[:, 1:], field[:, :-1], out=steps[1, :, :-1])
    np.subtract(field[:, 0], field[:, -1], out=steps[1, :, -1])
    return steps


def _negative_divergence(steps: Float32[Array, "2 rows cols"]) -> Field:
    """Return the adjoint of `_gradient`."""
    down, along = steps
    found = np.empty_like(down)
    np.subtract(down[:-1], down[1:], out=found[1:])
    np.subtract(down[-1], down[0], out=found[0])
    found -= along
    found[:, 1:] += along[:, :-1]
    found[:, 0] += along[:, -1]
    return found


@lru_cache(maxsize=8)
def deconvolution_symbols(rows: int, cols: int, sigma_px: float, floor: float) -> tuple[Field, Field]:
    """Return the transform G of the point spread and 1/(G² + ρ|∇|²), of the padded field.

    They are arranged as `cv2.dft` packs the transform of a real field, whose size is even here. Real and imaginary parts of one
    frequency are neighbours in a row, and in the first and last columns, which hold the frequencies 0 and 1/2, in the column.
    """
    reach = int(np.ceil(6 * sigma_px))
    tall, wide = (
        _DFT_SIDE_FACTOR * cv2.getOptimalDFTSize(-(-(side + reach) // _DFT_SIDE_FACTOR)) for side in (rows, cols)
    )
    ky = np.repeat(np.abs(np.fft.fftfreq(tall))[:, None], wide, axis=1)
    ky[:, [0, -1]] = ((np.arange(tall) + 1) // 2 / tall)[:, None]
    kx = (np.arange(wide) + 1) // 2 / wide
    spread = np.exp(-2 * (np.pi * sigma_px) ** 2 * (kx**2 + ky**2))
    variation = floor * sigma_px**2 * 4 * (np.sin(np.pi * kx) ** 2 + np.sin(np.pi * ky) ** 2)
    return spread.astype(np.float32), (1 / (spread**2 + variation)).astype(np.float32)
