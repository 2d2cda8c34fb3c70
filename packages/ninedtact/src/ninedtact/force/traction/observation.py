"""Observation models: from a reading to the signal that is inverted, on the grid of cells.

The signal is the change of brightness or, without a light calibration, the height itself. Brightness carries more information. A
height map is an image that was deblurred as far as noise allowed and then mapped by the depth curve. Features of a contact that are
narrower than the scattering of light remain blurred in it, and their dark and bright parts do not cancel as the heights themselves
do. The inversion predicts the scattered light instead, so that nothing has to be deblurred.

The cells are squares of about half a millimetre over the image and some skin around it. They follow the gel: a thin gel transmits
finer structure of a contact than a thick one. The observed signal is compared with the predicted one on the same cells. Fields of
the view have the shape (rows, cols). Fields of the skin are larger and periodic: their first rows and columns are the view, the
next ones are skin below (right of) it, and the last ones, wrapped around, are skin above (left of) it.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.errors import ForceEstimationError
from ninedtact.force.contact_detection import cell_noise_upper_bound, estimate_cell_noise
from ninedtact.mechanics.skin import PeriodicGrid
from ninedtact.quantities import HeightMap, HeightSource, Rectified, centred_axis_mm
from ninedtact.reading import Reading
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.depth import DepthCurve, GlobalDimmingModel
from ninedtact.shape.orthorectification import find_pixels_of_skin_places, sample_field

MARGIN_CELLS = 1
"""Cells beyond each side of the image where pressure may also act: near the border, pressed-in skin appears displaced outwards, out
of the image."""

_PITCH_PER_THICKNESS = 0.35
"""Pitch of the cells over the gel's thickness."""
_PITCH_LIMITS_MM = 0.5, 0.7
"""Smallest and largest pitch of the cells: the time of an inversion grows with their number."""
_MIN_CELLS = 8
"""Smallest number of cells along the shorter side of an image."""
_SURROUNDINGS_MM = 3.3
"""Width of the skin beyond the view that is modelled, because it scatters light into the view and separates the contact from its
periodic images."""


@dataclass(frozen=True)
class CellGrid:
    """A view of (rows, cols) square cells about the middle of an image, which covers the image and `MARGIN_CELLS` cells around it.

    The cells fit the image exactly along one axis at least; along the other one the outermost may lie up to half outside it.
    """

    rows: int
    cols: int
    pitch_mm: float
    """Side of a cell."""
    mm_per_px: float
    """Pixel pitch of the image."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the view."""
        return self.rows, self.cols

    @property
    def image_shape(self) -> tuple[int, int]:
        """Rows and columns of the part that is on the image."""
        return self.rows - 2 * MARGIN_CELLS, self.cols - 2 * MARGIN_CELLS

    @cached_property
    def on_image(self) -> Float32[Array, "rows cols"]:
        """One on the cells of the image, zero on the margin."""
        return np.pad(np.ones(self.image_shape, np.float32), MARGIN_CELLS)

    @cached_property
    def patch(self) -> PeriodicGrid:
        """The periodic skin, larger than the view."""
        from scipy.fft import next_fast_len

        around = 2 * int(np.ceil(_SURROUNDINGS_MM / self.pitch_mm))
        rows, cols = (next_fast_len(side + around, real=True) for side in self.shape)
        return PeriodicGrid(rows, cols, self.pitch_mm)

    @cached_property
    def axes_mm(self) -> tuple[Float32[Array, " cols"], Float32[Array, " rows"]]:
        """Coordinates x of the columns and y of the rows of the view."""
        return centred_axis_mm(self.cols, self.pitch_mm), centred_axis_mm(self.rows, self.pitch_mm)

    @cached_property
    def coordinates_mm(self) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """Coordinates x and y of every cell of the view."""
        x, y = np.meshgrid(*self.axes_mm)
        return x, y

    def offsets(self, axis: int) -> Float[Array, " skin"]:
        """Return the index along one axis of the skin, counted from the view's first cell; negative for skin that is wrapped
        around."""
        view, skin = self.shape[axis], self.patch.shape[axis]
        index = np.arange(skin)
        return np.where(index < view + (skin - view) // 2, index, index - skin).astype(float)

    def average(self, field: Float32[Array, "a b"]) -> Float32[Array, "rows cols"]:
        """Return the means of an image's field over the part of each cell that is on the image; the outermost ones are repeated on
        the margin."""
        down, across = self.averaging_weights(field.shape)
        return down @ field @ across.T

    def averaging_weights(self, shape: tuple[int, ...]) -> tuple[Float32[Array, "rows a"], Float32[Array, "cols b"]]:
        """Return the weights of the rows and of the columns of an image of this shape in `average`."""
        px_per_cell = self.pitch_mm / self.mm_per_px
        down, across = (
            _averaging_weights(pixels, cells, px_per_cell)
            for pixels, cells in zip(shape, self.image_shape, strict=True)
        )
        return down, across


def cell_grid_over_image(shape: tuple[int, int], mm_per_px: float, thickness_mm: float) -> CellGrid:
    """Return the cells over an image of this shape (rows, cols), as fine as a gel of this thickness needs."""
    largest_mm = float(np.clip(_PITCH_PER_THICKNESS * thickness_mm, *_PITCH_LIMITS_MM))
    sides_mm = [side * mm_per_px for side in shape]
    largest_mm = min(largest_mm, min(sides_mm) / _MIN_CELLS)
    pitch_mm = max(side_mm / _count_to_cover(side_mm, largest_mm) for side_mm in sides_mm)
    rows, cols = (_count_to_cover(side_mm, pitch_mm) for side_mm in sides_mm)
    return CellGrid(rows + 2 * MARGIN_CELLS, cols + 2 * MARGIN_CELLS, pitch_mm, mm_per_px)


def _count_to_cover(side_mm: float, pitch_mm: float) -> int:
    """Return the number of cells that cover a side; a side that they fit exactly needs no more of them because of rounding."""
    return int(np.ceil(side_mm / pitch_mm - 1e-9))


@lru_cache(maxsize=16)
def _averaging_weights(pixels: int, cells: int, px_per_cell: float) -> Float32[Array, "view pixels"]:
    """Return the weight of each pixel in the mean of each cell, along one axis; the cells lie about the middle of the pixels."""
    ends = pixels / 2 + (np.arange(cells + 1) - cells / 2) * px_per_cell
    inside = np.diff(np.clip(ends[:, None] - np.arange(pixels), 0, 1), axis=0)
    weights = inside / inside.sum(axis=1, keepdims=True)
    return np.pad(weights, ((MARGIN_CELLS, MARGIN_CELLS), (0, 0)), mode="edge").astype(np.float32)


View = Float32[Array, "rows cols"]

_EXTENSION_FACTOR = 2.0
"""Multiple of the calibrated range up to which the depth curve is extrapolated along its last segment."""
SIGHTLINE_ITERATIONS = 4
MIN_BRIGHTNESS_NOISE = 2e-4
"""Smallest noise of a cell's relative brightness: a tenth of a grey level's step, averaged over a cell."""
_LOCAL_FRACTION = 0.4
"""Fraction of the depth curve's error that differs from place to place. The rest scales the whole contact, which the stated error
of the wrench contains; were it assumed in every cell, the inversion would shrink forces. Found on simulated sensors."""


@dataclass(frozen=True)
class BrightnessLaw:
    """Relative change of brightness over height before scattering, linear between knots: the depth curve, inverted."""

    height_mm: Float[Array, " knots"]
    change: Float[Array, " knots"]

    def __call__(self, height_mm: Float32[Array, "*shape"]) -> Float32[Array, "*shape"]:
        """Return the relative change of brightness of skin at these heights."""
        return np.interp(height_mm, self.height_mm, self.change).astype(np.float32)

    @property
    def deepest_known_mm(self) -> float:
        """Height at the last knot of the depth curve, before the extrapolation."""
        return float(self.height_mm[1])

    def slope_per_mm(self, height_mm: Float32[Array, "*shape"]) -> Float32[Array, "*shape"]:
        """Return the derivative of the change with respect to height."""
        steps = np.diff(self.change) / np.diff(self.height_mm)
        segment = np.searchsorted(self.height_mm[1:-1], height_mm, side="right")
        return steps.astype(np.float32)[segment]


def brightness_law_of_curve(curve: DepthCurve) -> BrightnessLaw:
    """Return the brightness law of a ratio curve, extrapolated at both ends.

    Raises `ForceEstimationError` where the curve has no bulges.
    """
    if not curve.knows_bulges or curve.signal != "ratio":
        raise ForceEstimationError(
            expected="a depth curve that knows bulges",
            got="one for indentation alone",
            remedy="calibrate with the method 'physics'",
        )
    darkening, indentation_mm, _ = curve.pressed
    height = np.concatenate([-np.array(indentation_mm)[::-1], np.array(curve.bulge_mm)[1:]])
    change = np.concatenate([-np.array(darkening)[::-1], np.array(curve.brightening)[1:]])
    distinct = np.concatenate([[True], np.diff(height) > 1e-9])
    height, change = height[distinct], change[distinct]
    slope = np.diff(change) / np.diff(height)
    low, high = _EXTENSION_FACTOR * height[0], _EXTENSION_FACTOR * height[-1]
    ends = change[0] + slope[0] * (low - height[0]), change[-1] + slope[-1] * (high - height[-1])
    return BrightnessLaw(np.concatenate([[low], height, [high]]), np.concatenate([[ends[0]], change, [ends[1]]]))


@dataclass(frozen=True)
class LinesOfSight:
    """Where the lines of sight of an image meet the plane of the untouched skin, and which of them the cells were observed at."""

    inverse_distance_per_mm: float
    """One over the viewing distance; zero where lines of sight are parallel."""
    pixel: Float32[Array, "2 rows cols"]
    """Column and row, in cells of the image's plane, of the line of sight at which each cell was observed."""

    def follow(self, field: Float32[Array, "a b"], height_mm: Float32[Array, "a b"]) -> Float32[Array, "a b"]:
        """Return a field of the skin where the lines of sight through the points of its grid meet it; the camera is under its
        middle."""
        rows, cols = field.shape
        middle = np.array([(cols - 1) / 2, (rows - 1) / 2], np.float32)[:, None, None]
        from_middle = np.stack(np.meshgrid(*(np.arange(side, dtype=np.float32) for side in (cols, rows)))) - middle
        pixel = from_middle + middle
        for _ in range(SIGHTLINE_ITERATIONS):
            seen_mm = sample_field(height_mm, pixel, cv2.INTER_LINEAR)
            pixel = from_middle * (1 + seen_mm * np.float32(self.inverse_distance_per_mm)) + middle
        return sample_field(field, pixel, cv2.INTER_LINEAR)

    def observe(self, change: View) -> View:
        """Return the change of brightness that is observed on the cells, of that on lines of sight."""
        return _at_pixels(change, self.pixel)


@dataclass(frozen=True)
class ObservationOnCells:
    """The observed signal and its errors as orthorectified fields on the cells."""

    change: View
    """Relative change of brightness."""
    noise: float
    """Standard deviation of one cell's change from image to image."""
    error: float
    """Standard deviation of the change due to the calibration, as far as it differs from place to place."""
    z_mm: View
    """Height from the depth reader, used for the initial guess and the contact region."""
    in_view: View
    """One where a cell is seen, zero where not."""
    sight: LinesOfSight | None = None
    """How the cells were observed; None where lines of sight are parallel."""


class ObservationModel(ABC):
    """How a reading becomes an observation, and which law relates the observed signal to heights."""

    law: BrightnessLaw
    point_spread_mm: float
    """Standard deviation of the point-spread of the observed signal."""

    @abstractmethod
    def observe(self, reading: Reading, cells: CellGrid) -> ObservationOnCells:
        """Return the reading's signal on the cells; raises `ForceEstimationError`."""


@dataclass(frozen=True)
class BrightnessObservationModel(ObservationModel):
    """Observes the image itself, by the sensor's brightness law."""

    curve: DepthCurve
    loss: GlobalDimmingModel
    point_spread_mm: float
    _reference: list[tuple[Rectified, View]] = field(default_factory=list, init=False, repr=False, compare=False)
    """The last reference averaged over the cells, cached because it changes only once a session."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "law", brightness_law_of_curve(self.curve))

    def observe(self, reading: Reading, cells: CellGrid) -> ObservationOnCells:
        """Return the relative change of brightness."""
        below, pixel = orthorectify_onto_cells(reading.height, cells)
        change = _at_pixels(self._relative_change(reading.rectified, reading.reference, cells), pixel)
        largest = cell_noise_upper_bound(
            reading.rectified.grey, reading.reference.grey, int(np.prod(cells.image_shape))
        )
        noise = min(max(estimate_cell_noise(change), MIN_BRIGHTNESS_NOISE), largest)
        uneven = reading.light.gradient
        error = float(np.hypot(self.local_error, 0.0 if uneven is None else uneven.error))
        sight = LinesOfSight(1 / reading.height.camera_distance_mm, pixel)
        return ObservationOnCells(change, noise, error, below.z_mm, below.in_view.astype(np.float32), sight)

    def _relative_change(self, image: Rectified, reference: Rectified, cells: CellGrid) -> View:
        """Return the relative change of brightness of every cell, corrected for the global loss of light."""
        # Another thread may replace the cached reference at any moment.
        cached = self._reference[0] if self._reference else None
        if cached is None or cached[0] is not reference or cached[1].shape != cells.shape:
            cached = reference, np.maximum(cells.average(reference.grey), np.float32(1))
            self._reference[:] = [cached]
        lost = self.loss(image.grey, reference.grey)
        return cells.average(image.grey) / cached[1] * np.float32(1 / (1 + lost)) - np.float32(1)

    @property
    def local_error(self) -> float:
        """Standard deviation of a cell's change due to the depth curve, as far as it differs from place to place."""
        steps = np.diff(self.curve.darkening) / np.maximum(np.diff(self.curve.indentation_mm), 1e-9)
        return _LOCAL_FRACTION * float(np.mean(steps * np.array(self.curve.error_mm)[1:]))


def build_brightness_observation_model(calibrated: CalibratedShape) -> BrightnessObservationModel:
    """Return the observation model of a calibrated sensor; raises `ForceEstimationError` where its calibration has no
    point-spread."""
    if calibrated.deblurring is None:
        raise ForceEstimationError(
            expected="a calibration that knows how light scatters",
            got="one without",
            remedy="calibrate with the method 'physics', or, if it was imported, run 'ninedtact calibrate "
            "--from-import' with images of a ball",
        )
    return BrightnessObservationModel(calibrated.curve, calibrated.loss, calibrated.deblurring.point_spread_mm)


def orthorectify_onto_cells(height: HeightMap, cells: CellGrid) -> tuple[HeightMap, Float32[Array, "2 rows cols"]]:
    """Return the height map on the cells, and the column and row of the line of sight of each.

    Columns and rows are those of the averaged map. Raises `ForceEstimationError` where nothing is in view.
    """
    if not height.in_view.any():
        raise ForceEstimationError(
            expected="a height map with pixels in view",
            got="one that is out of view everywhere",
            remedy="calibrate the board again",
        )
    in_view = _fraction_of_cells(height.source != HeightSource.OUT_OF_VIEW.value, cells) * cells.on_image
    source = np.where(in_view > 0.5, HeightSource.MEASURED, HeightSource.OUT_OF_VIEW).astype(np.uint8)
    coarse = replace(height, z_mm=cells.average(height.z_mm), source=source, mm_per_px=cells.pitch_mm)
    seen_mm = np.where(coarse.in_view, coarse.z_mm, np.float32(0))
    pitch_mm, place_mm = (cells.pitch_mm, cells.pitch_mm), np.stack(cells.coordinates_mm)
    pixel = find_pixels_of_skin_places(seen_mm, pitch_mm, place_mm, height.camera_distance_mm, SIGHTLINE_ITERATIONS)
    source = np.asarray(sample_field(source, pixel, cv2.INTER_NEAREST))
    below = replace(coarse, z_mm=_at_pixels(coarse.z_mm, pixel), source=source, camera_distance_mm=np.inf)
    return below, pixel


def _fraction_of_cells(where: Bool[Array, "a b"], cells: CellGrid) -> View:
    """Return the fraction of every cell in which a mask holds, quickly where it holds everywhere or nowhere."""
    if where.all() or not where.any():
        return np.full(cells.shape, where.flat[0], np.float32)
    return cells.average(where.astype(np.float32))


def _at_pixels(values: View, pixel: Float32[Array, "2 rows cols"]) -> View:
    """Interpolate a field of lines of sight at the given columns and rows."""
    return np.asarray(sample_field(values, pixel, cv2.INTER_LINEAR), np.float32)
