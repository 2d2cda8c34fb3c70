"""The skin as a surface in space: slopes, areas, points with normals, and triangles; and the scalar measures of a height map.

Pixels of a height map are lines of sight (`quantities.HeightMap`). The line of sight through (u, v) on the undeformed plane meets
skin of height z at (x, y) = (u, v)·k with k = 1 + z/D, where D is the camera's distance. From the two tangents of that surface
along u and v, the outward normal is along (−dz/du, −dz/dv, n) with n = 1 + (z + u·dz/du + v·dz/dv)/D, and one unit of (u, v) covers
k·n units of (x, y). Where D is infinite, k = n = 1.

The measures are the maximum indentation and bulge, contact area, displaced volume, and the centre of the contact (`ShapeSummary`).
`contact_mask` decides by a `ContactRule` which pixels are in contact.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int, Int32
from msgspec import Meta
from numpy import ndarray as Array
from numpy.lib.stride_tricks import sliding_window_view

from ninedtact.bounds import checks_arguments
from ninedtact.errors import InputError
from ninedtact.quantities import HeightMap, HeightSource, Mesh, PointCloud, skin_grid_mm
from ninedtact.shape.deblurring import block_means

Grid = Float32[Array, "rows cols"]

_SOBEL_WEIGHT = 8.0
"""Sobel's difference spans two pixels and is summed over three rows with weights 1, 2, 1."""
_ROW_WEIGHTS = np.array([[1], [2], [1]], np.float32)
_NEIGHBOURHOOD = np.ones((3, 3), np.uint8)


@checks_arguments
def point_cloud(height: HeightMap, every: Annotated[int, Meta(ge=1)] = 1) -> PointCloud:
    """Return all points in view, row by row, in the sensor frame (mm), with outward unit normals.

    `every` = 3 keeps each third row and column, for display; the normals are still those of the full grid.
    """
    u, v = _plane_coordinates_mm(height.z_mm.shape, height.mm_per_px, every)
    slope_x, slope_y = (_thin(slope, every) for slope in surface_slope(height))
    scale = sightline_scale(height, every)
    points = cv2.merge([u * scale, v * scale, _thin(height.z_mm, every)])
    directions = cv2.merge(_unit_normals(height, slope_x, slope_y, every))
    return PointCloud(
        _triples_in_view(points, height, every), _triples_in_view(directions, height, every), height.stamp_ns
    )


@checks_arguments
def surface_mesh(height: HeightMap, every: Annotated[int, Meta(ge=1)] = 1) -> Mesh:
    """Return the open surface: two triangles per square of pixels wholly in view; vertex k is point k of `point_cloud(height,
    every)`. Raises `InputError`, also where fewer than two rows or columns are kept."""
    require_mesh_spacing(height, every)
    return Mesh(point_cloud(height, every).points_mm.copy(), triangulate_view(height.in_view[::every, ::every]))


def require_mesh_spacing(height: HeightMap, every: int) -> None:
    """Raise `InputError` where a mesh of every so many rows and columns would have no triangle."""
    rows, cols = height.z_mm.shape
    if every >= min(rows, cols):
        raise InputError(
            f"expected every={every} to keep at least two of {rows} rows and {cols} columns for a mesh; give at most "
            f"{min(rows, cols) - 1}"
        )


def triangulate_view(in_view: Bool[Array, "rows cols"]) -> Int32[Array, "m 3"]:
    """Return triangles between the pixels in view, which are numbered row by row; counter-clockwise with x right and y up."""
    number = np.cumsum(in_view, dtype=np.int32).reshape(in_view.shape) - np.int32(1)
    whole = in_view[:-1, :-1] & in_view[:-1, 1:] & in_view[1:, :-1] & in_view[1:, 1:]
    near, right, far, across = (
        part[whole] for part in (number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:])
    )
    return np.stack([near, right, across, near, across, far], axis=-1).reshape(-1, 3)


def surface_slope(height: HeightMap) -> tuple[Grid, Grid]:
    """Return the slopes dz/dx and dz/dy (mm/mm) by Sobel's differences; heights out of view are not used."""
    along_x, along_y = _slope_everywhere(height.z_mm, height.mm_per_px)
    if height.source.min() == HeightSource.OUT_OF_VIEW:
        rows, cols = _edge_of_view(height.in_view)
        along_x[rows, cols], along_y[rows, cols] = _slope_at(height, rows, cols)
    return along_x, along_y


def pixel_footprint_mm2(height: HeightMap) -> Grid:
    """Return the area of each pixel's skin, projected on the undeformed plane."""
    n = _normal_z_component(height, *surface_slope(height))
    return np.asarray(sightline_scale(height) * n * np.float32(height.mm_per_px**2))


def sightline_scale(height: HeightMap, every: int = 1) -> Grid:
    """Return k = 1 + z/D, the factor from the (u, v) of each pixel to the (x, y) of the skin seen there, at every so many rows and
    columns."""
    scale = _thin(height.z_mm, every) * np.float32(1 / height.camera_distance_mm)
    scale += 1
    return np.asarray(scale)


def _thin(field: Grid, every: int) -> Float32[Array, "fewer_rows fewer_cols"]:
    """Return every so many rows and columns."""
    return np.ascontiguousarray(field[::every, ::every])


def _normal_z_component(height: HeightMap, slope_x: Grid, slope_y: Grid, every: int = 1) -> Grid:
    """Return n: the third component of a normal along (−dz/du, −dz/dv, n), at every so many rows and columns."""
    in_distances = height.mm_per_px / height.camera_distance_mm
    u, v = _plane_coordinates_mm(height.z_mm.shape, in_distances, every)
    n = sightline_scale(height, every)
    cv2.accumulateProduct(u, slope_x, n)
    cv2.accumulateProduct(v, slope_y, n)
    return n


def _unit_normals(height: HeightMap, x: Grid, y: Grid, every: int) -> list[Grid]:
    """Return the outward unit normals of both slopes, which are overwritten, as three planes x, y, z."""
    z = _normal_z_component(height, x, y, every)
    scale = x * x
    cv2.accumulateSquare(y, scale)
    cv2.accumulateSquare(z, scale)
    cv2.pow(scale, -0.5, scale)
    z *= scale
    np.negative(scale, out=scale)
    x *= scale
    y *= scale
    return [x, y, z]


def _triples_in_view(grid: Float32[Array, "rows cols 3"], height: HeightMap, every: int) -> Float32[Array, "n 3"]:
    """Return the triples of every so many rows and columns whose pixels are in view, row by row."""
    triples = grid.reshape(-1, 3)
    if height.source.min() != HeightSource.OUT_OF_VIEW:
        return triples
    # numpy selects items of 12 bytes twenty times faster than rows of three floats.
    items = triples.view("V12")[:, 0][height.in_view[::every, ::every].ravel()]
    return np.asarray(items.view(np.float32).reshape(-1, 3))


@lru_cache(maxsize=8)
def _plane_coordinates_mm(shape: tuple[int, int], mm_per_px: float, every: int = 1) -> tuple[Grid, Grid]:
    """Return x and y of every pixel, or of every so many rows and columns, on the untouched plane; read-only, as every caller gets
    the same two arrays. With another unit per pixel they have that unit."""
    x, y = (_thin(plane, every) for plane in skin_grid_mm(shape, mm_per_px))
    for plane in (x, y):
        plane.flags.writeable = False
    return x, y


def _slope_everywhere(z_mm: Grid, mm_per_px: float) -> tuple[Grid, Grid]:
    """Return both slopes of a grid that is wholly in view."""
    scale = 1 / (_SOBEL_WEIGHT * mm_per_px)
    along_x = cv2.Sobel(z_mm, cv2.CV_32F, 1, 0, scale=scale, borderType=cv2.BORDER_REPLICATE)
    along_y = cv2.Sobel(z_mm, cv2.CV_32F, 0, 1, scale=scale, borderType=cv2.BORDER_REPLICATE)
    # At the border the pixel itself is repeated as its outer neighbour, so half of the difference is missing.
    for border in (along_x[:, 0], along_x[:, -1], along_y[0], along_y[-1]):
        border *= 2
    return along_x, along_y


def _edge_of_view(in_view: Bool[Array, "rows cols"]) -> tuple[Int[Array, " n"], Int[Array, " n"]]:
    """Return rows and columns of the pixels in view that have a neighbour out of view."""
    surrounded = cv2.erode(in_view.view(np.uint8), _NEIGHBOURHOOD).view(bool)
    # numpy finds indices in one dimension ten times faster than in two.
    rows, cols = np.unravel_index(np.flatnonzero(in_view & ~surrounded), in_view.shape)
    return rows, cols


def _slope_at(
    height: HeightMap, rows: Int[Array, " n"], cols: Int[Array, " n"]
) -> tuple[Float32[Array, " n"], Float32[Array, " n"]]:
    """Return the slopes at single pixels, from their neighbours in view alone."""
    z_mm, in_view = _neighbourhoods(height.z_mm, rows, cols), _neighbourhoods(height.in_view, rows, cols)
    along_x = _mean_step(z_mm, in_view)
    along_y = _mean_step(z_mm.transpose(0, 2, 1), in_view.transpose(0, 2, 1))
    return along_x / np.float32(height.mm_per_px), along_y / np.float32(height.mm_per_px)


def _neighbourhoods(field: Array, rows: Int[Array, " n"], cols: Int[Array, " n"]) -> Array:
    """Return the 3 x 3 neighbourhoods of single pixels, with zeros outside the grid."""
    return np.asarray(sliding_window_view(np.pad(field, 1), (3, 3))[rows, cols])


def _mean_step(z_mm: Float32[Array, "n 3 3"], in_view: Bool[Array, "n 3 3"]) -> Float32[Array, " n"]:
    """Return the mean step between columns in view, weighted as Sobel does; zero where no two columns are in view."""
    both = in_view[:, :, 1:] & in_view[:, :, :-1]
    steps = np.where(both, np.diff(z_mm, axis=2), np.float32(0))
    weight = (_ROW_WEIGHTS * both).sum(axis=(1, 2))
    return np.asarray((_ROW_WEIGHTS * steps).sum(axis=(1, 2)) / np.maximum(weight, 1))


@dataclass(frozen=True)
class ContactRule:
    """The rule of which pixels are in contact: those beyond a threshold at which the skin is hollow, in a connected region that
    somewhere is deep enough.

    Skin is hollow, lower than the mean of its surroundings, where an object holds it down. Free skin that friction drags down
    behind an object, or that hangs between two parts of it, is not.
    """

    at_least_mm: float = 0.05
    """Smallest threshold. It exceeds the apparent height of slow drift of the light and of the gel, and is one fiftieth of the
    gel's thickness.
    """
    noise_factor: float = 5.0
    """Threshold in standard deviations of a pixel: at 5, not one pixel in three million without contact exceeds it by chance."""
    share_of_deepest: float = 0.25
    """Fraction of the maximum indentation that a region must reach. A deep press takes light away from the whole image, which looks
    like a shallow press far from it: up to 0.3 mm in the corners of a real image whose ball is 2 mm deep.
    """
    hollow_share: float = 0.03
    """Fraction of the maximum indentation by which hollow skin is lower, and free skin beside it higher, than its surroundings."""
    hollow_threshold_share: float = 0.1
    """The same of the threshold, which matters for light contacts: means over the surroundings have a tenth of the noise."""

    def threshold_mm(self, noise_mm: float) -> float:
        """Return the larger of the two thresholds."""
        return max(self.at_least_mm, self.noise_factor * noise_mm)


_NOTABLE_SHARE = 0.01
"""Share of the contact beyond the calibrated range from which it is worth a warning."""


@dataclass(frozen=True)
class ShapeSummary:
    """The measures of one height map."""

    max_indentation_mm: float
    max_bulge_mm: float
    contact_area_mm2: float
    """Area of the contact, projected on the undeformed plane."""
    displaced_volume_mm3: float
    """Volume between the contact and the undeformed plane."""
    contact_centre_mm: tuple[float, float] | None
    """x and y of the centre of the displaced volume; None where there is no contact."""
    contact_threshold_mm: float
    extrapolated_share: float
    """Fraction of the contact area that lies beyond the calibrated range, 0 to 1."""
    is_deepest_clipped: bool
    """Whether the skin is deeper somewhere than the depth curve goes, so that the maximum indentation is a lower limit."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence where depths, or a notable part of the contact, lie beyond the calibrated range."""
        clipped = ("the maximum indentation lies beyond the calibrated range and is a lower limit",)
        share = (f"{self.extrapolated_share:.0%} of the contact lies beyond the calibrated range",)
        return (clipped if self.is_deepest_clipped else ()) + (
            share if self.extrapolated_share > _NOTABLE_SHARE else ()
        )


@checks_arguments
def summarise_shape(
    height: HeightMap, rule: ContactRule = ContactRule(), touched: Bool[Array, "rows cols"] | None = None
) -> ShapeSummary:
    """Return the measures of one height map; pixels out of view do not count. touched: its `contact_mask`, where it is known."""
    touched = contact_mask(height, rule) if touched is None else touched
    # The volume is summed inside the contact only, because rectified noise over the whole image adds up to cubic millimetres.
    at = np.flatnonzero(touched)
    area_mm2 = pixel_footprint_mm2(height).ravel()[at] if at.size else np.zeros(0, np.float32)
    volume_mm3 = area_mm2 * -height.z_mm.ravel()[at]
    return ShapeSummary(
        max_indentation_mm=max_indentation_mm(height),
        max_bulge_mm=max_bulge_mm(height),
        contact_area_mm2=float(area_mm2.sum(dtype=np.float64)),
        displaced_volume_mm3=float(volume_mm3.sum(dtype=np.float64)),
        contact_centre_mm=_weighted_centre_mm(height, at, volume_mm3),
        contact_threshold_mm=rule.threshold_mm(height.noise_mm),
        extrapolated_share=np.count_nonzero(height.source.ravel()[at] == HeightSource.EXTRAPOLATED) / max(at.size, 1),
        is_deepest_clipped=height.is_clipped,
    )


def contact_mask(height: HeightMap, rule: ContactRule = ContactRule()) -> Bool[Array, "rows cols"]:
    """Return the pixels at which an object holds the skin down by more than drift, noise and loss of light explain."""
    beyond = height.in_view & (height.z_mm < -rule.threshold_mm(height.noise_mm))
    return beyond & _is_held_down(height, rule) if beyond.any() else beyond


_BLOCK_MM = 0.2
"""Side of the blocks on which held skin is found."""
_NARROW_MM, _WIDE_MM = 0.15, 1.0
"""Standard deviations of two Gaussians; the difference of the heights that they average is the depth of a hollow. The narrow one
removes noise; the wide one is narrower than what friction drags down, which is about as wide as the gel is thick.
"""


def _is_held_down(height: HeightMap, rule: ContactRule) -> Bool[Array, "rows cols"]:
    """Return where the skin is hollow, or level inside hollow rims as under a flat face, in regions that are deep enough.

    Level skin that adjoins skin above the mean of its surroundings is free: between an object and skin at rest there is such skin.
    """
    side = max(round(_BLOCK_MM / height.mm_per_px), 1)
    z_mm, wide_mm = _means_around(height, side, _NARROW_MM), _means_around(height, 2 * side, _WIDE_MM)
    rows, cols = z_mm.shape
    hollow_mm = cv2.resize(wide_mm, None, fx=2, fy=2, interpolation=cv2.INTER_LINEAR)[:rows, :cols] - z_mm
    threshold_mm, deepest_mm = rule.threshold_mm(height.noise_mm), max_indentation_mm(height)
    least_mm = max(rule.hollow_share * deepest_mm, rule.hollow_threshold_share * threshold_mm)
    pressed, deep = z_mm < -threshold_mm, z_mm <= -rule.share_of_deepest * deepest_mm
    free = connected_parts_with(pressed & (hollow_mm <= least_mm), _widened(hollow_mm < -least_mm))
    held = connected_parts_with(pressed & ~free, deep)
    # Interpolated between blocks, the edge is smooth: it lies where the skin beside a held region begins to be free.
    hollow_mm[held] = np.maximum(hollow_mm[held], 0)
    hollow_mm[~_widened(_widened(held))] = -deepest_mm
    on_pixels = cv2.resize(hollow_mm, (cols * side, rows * side), interpolation=cv2.INTER_LINEAR)
    return np.asarray(on_pixels[: height.z_mm.shape[0], : height.z_mm.shape[1]] > -least_mm)


def _means_around(height: HeightMap, side: int, sigma_mm: float) -> Grid:
    """Return on blocks of pixels the mean height around each, over what is in view."""
    seen, sigma = height.in_view, sigma_mm / (side * height.mm_per_px)
    if seen.all():
        return np.asarray(
            cv2.GaussianBlur(block_means(height.z_mm, side), (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        )
    z_mm, weight = (
        cv2.GaussianBlur(block_means(field, side), (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        for field in (np.where(seen, height.z_mm, np.float32(0)), seen.astype(np.float32))
    )
    return np.asarray(z_mm / np.maximum(weight, np.float32(1e-6)))


def _widened(mask: Bool[Array, "rows cols"]) -> Bool[Array, "rows cols"]:
    return np.asarray(cv2.dilate(mask.view(np.uint8), _NEIGHBOURHOOD).view(bool))


def connected_parts_with(
    mask: Bool[Array, "rows cols"], marks: Bool[Array, "rows cols"], neighbours: int = 8
) -> Bool[Array, "rows cols"]:
    """Return the connected parts of a mask that hold a mark; pixels are connected to 4 or 8 neighbours."""
    count, part = cv2.connectedComponents(mask.view(np.uint8), connectivity=neighbours)
    is_marked = np.zeros(count, bool)
    is_marked[part[mask & marks]] = True
    return np.asarray(is_marked[part])


_PATCH_MM = 0.4
"""Side of the patches over which extremes are averaged; scattered light shows nothing smaller."""


def max_indentation_mm(height: HeightMap) -> float:
    """Return the maximum indentation, the mean over the deepest square patch of about 0.4 mm; 0 where nothing is indented.

    The deepest single pixel is the deepest by its noise. Under a ball of 4 mm radius the mean is 3 µm less than its lowest point.
    """
    return max(0.0, -_extremes_mm(height)[0])


def max_bulge_mm(height: HeightMap) -> float:
    """Return the maximum height of bulges in view, a mean over a patch as well; 0 where nothing bulges."""
    return max(0.0, _extremes_mm(height)[1])


def relief_of_deepest_patch_mm(height: HeightMap, scale_mm: float) -> float:
    """Return by how much the deepest patch is deeper than in the map smoothed over a scale (standard deviation of a Gaussian)."""
    smooth_mm = cv2.GaussianBlur(_seen_mm(height), (0, 0), scale_mm / height.mm_per_px)
    smooth = _patch_means_mm(replace(height, z_mm=smooth_mm))
    means = _patch_means_mm(height)
    deepest = means.argmin()
    return max(0.0, float(smooth.flat[deepest] - means.flat[deepest]))


def _extremes_mm(height: HeightMap) -> tuple[float, float]:
    """Return the lowest and the highest mean over patches."""
    return cv2.minMaxLoc(_patch_means_mm(height))[:2]


def _patch_means_mm(height: HeightMap) -> Float32[Array, "few_rows few_cols"]:
    """Return the mean heights of patches that overlap by half."""
    half = max(min(round(_PATCH_MM / 2 / height.mm_per_px), min(height.z_mm.shape) // 2), 1)
    halves = block_means(_seen_mm(height), half)
    return np.asarray(cv2.blur(halves, (2, 2), borderType=cv2.BORDER_REPLICATE))


def _seen_mm(height: HeightMap) -> Float32[Array, "rows cols"]:
    """Return the heights; what is out of view counts as undeformed."""
    in_view = height.in_view
    return height.z_mm if in_view.all() else np.where(in_view, height.z_mm, np.float32(0))


def _weighted_centre_mm(
    height: HeightMap, at: Int[Array, " n"], weight: Float32[Array, " n"]
) -> tuple[float, float] | None:
    """Return the weighted mean position of the skin at pixels, numbered row by row; None where all weights are zero."""
    total = weight.sum(dtype=np.float64)
    if total == 0:
        return None
    x_mm, y_mm, _ = (
        weight.astype(np.float64) @ height.points_at(*np.divmod(at, height.z_mm.shape[1])) / total
    ).tolist()
    return x_mm, y_mm
