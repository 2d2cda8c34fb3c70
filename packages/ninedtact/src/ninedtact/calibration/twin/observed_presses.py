"""What is fitted of the presses that calibrate a twin: brightness relative to the reference image, at pixels around a ball or a
flat end, and among the pins of the board.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.board.board_fit import BoardFit
from ninedtact.calibration.brightness_change import relative_brightness, smooth_gaussian
from ninedtact.quantities import Rectified, skin_grid_mm
from ninedtact.shape.lens_and_rectification import Points, determinant_at_each_point

_SMOOTHING_PX = 1.5


@dataclass(frozen=True)
class ObservedPress(ABC):
    """Two rectified images, before and after a press, of which pixels around the contact are fitted."""

    before: Rectified
    after: Rectified

    stride_px: ClassVar[int]
    """Distance of the fitted pixels in rows and columns; smoothing has correlated neighbouring pixels."""

    @property
    @abstractmethod
    def fitted_pixels(self) -> Bool[Array, "rows cols"]:
        """The pixels that are fitted."""

    @cached_property
    def ratio(self) -> Float32[Array, "rows cols"]:
        """Smoothed brightness relative to the reference image."""
        return smooth_gaussian(relative_brightness(self.after, self.before), _SMOOTHING_PX)

    @cached_property
    def positions_mm(self) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """x and y of every pixel, by the lens with which the images were rectified."""
        return skin_grid_mm(self.before.grey.shape, self.before.mm_per_px)

    def thin_out(self, pixels: Bool[Array, "rows cols"]) -> Bool[Array, "rows cols"]:
        """Return those of the pixels that lie in every `stride_px`-th row and column."""
        lattice = np.zeros_like(pixels)
        lattice[:: self.stride_px, :: self.stride_px] = True
        return np.asarray(pixels & lattice)

    @cached_property
    def relative_brightness(self) -> Float[Array, " n"]:
        """Relative brightness of the fitted pixels."""
        return self.ratio[self.fitted_pixels].astype(float)

    @property
    def mean_grey(self) -> float:
        """Mean brightness of the reference image, which converts relative brightness to grey levels."""
        return float(self.before.grey.mean())

    def image(self, values: Float[Array, " n"]) -> Float[Array, "few_rows few_cols"]:
        """Return values of the fitted pixels as a coarse image, not-a-number elsewhere."""
        image = np.full(self.fitted_pixels.shape, np.nan)
        image[self.fitted_pixels] = values
        return image[:: self.stride_px, :: self.stride_px]


REACH_MM = 8.0
"""Radius around the contact within which the image is fitted."""
_RIM_MM = 0.7
"""Distance from the rim of a flat end within which the image is not fitted: how round the edge is, and how the light scatters
there, is not known."""


def is_off_rim(distance_mm: Float[Array, "..."], face_radius_mm: float) -> Bool[Array, "..."]:
    """Return which distances from the middle of a flat end are fitted."""
    return np.asarray(np.abs(distance_mm - face_radius_mm) > _RIM_MM)


def tilt_basis(x_mm: Float[Array, " n"], y_mm: Float[Array, " n"], face_radius_mm: float) -> Float[Array, "n 2"]:
    """Return the orthonormal slopes of brightness across a flat face, by which its image changes where it is tilted.

    x_mm, y_mm: positions from the middle of the face.
    """
    on_face = np.hypot(x_mm, y_mm) < face_radius_mm
    return np.linalg.qr(np.column_stack([x_mm * on_face, y_mm * on_face]).astype(float))[0]


@dataclass(frozen=True)
class ObservedRoundPress(ObservedPress):
    """A press of a ball, or of the flat end of a round rod, fitted around the contact."""

    centre_mm: tuple[float, float]
    """Approximate centre of the contact."""
    face_radius_mm: float | None = None
    """Radius of a flat end; None for a ball."""
    stride_px: ClassVar[int] = 2

    @cached_property
    def distance_mm(self) -> Float32[Array, "rows cols"]:
        """Distance of every pixel from the centre of the contact."""
        x, y = self.positions_mm
        return np.hypot(x - self.centre_mm[0], y - self.centre_mm[1])

    @cached_property
    def fitted_pixels(self) -> Bool[Array, "rows cols"]:
        """The pixels that are fitted."""
        near = self.distance_mm < REACH_MM
        return self.thin_out(
            near if self.face_radius_mm is None else near & is_off_rim(self.distance_mm, self.face_radius_mm)
        )

    @cached_property
    def _tilt_basis(self) -> Float[Array, "n 2"]:
        assert self.face_radius_mm is not None
        (x, y), (middle_x, middle_y) = self.points_mm, self.centre_mm
        return tilt_basis(x[0] - middle_x, y[0] - middle_y, self.face_radius_mm)

    def without_tilt(self, values: Float[Array, "n ..."]) -> Float[Array, "n ..."]:
        """Return values of the fitted pixels without what a tilt of a flat face explains; those under a ball as they are."""
        if self.face_radius_mm is None:
            return values
        return values - self._tilt_basis @ (self._tilt_basis.T @ values)

    @cached_property
    def points_mm(self) -> tuple[Float32[Array, "1 n"], Float32[Array, "1 n"]]:
        """x and y of the fitted pixels."""
        x, y = (axis[self.fitted_pixels][None] for axis in self.positions_mm)
        return x, y

    @property
    def count(self) -> int:
        """Number of the fitted pixels."""
        return self.relative_brightness.size

    @property
    def blur_mm(self) -> float:
        """Standard deviation of the smoothing, which is part of the fitted point spread."""
        return _SMOOTHING_PX * self.before.mm_per_px


FIT_RADIUS_PITCHES = 0.6
"""Radius around a pin within which the image is fitted, in pitches: a little more than half-way to the next pin."""
MIN_PIXEL_DENSITY = 0.1
"""Smallest density of pixels per square millimetre, relative to the centre: a lens fitted to pins may fold the image over beyond
the outermost ones.
"""


@dataclass(frozen=True)
class ObservedBoardPress(ObservedPress):
    """A press of the board, fitted among the pins."""

    board: BoardFit
    stride_px: ClassVar[int] = 3

    @cached_property
    def fitted_pixels(self) -> Bool[Array, "rows cols"]:
        """The pixels that are fitted: among the pins, and away from undetected pins."""
        x, y = self.positions_mm
        design = self.board.board
        radius_mm = FIT_RADIUS_PITCHES * design.pitch_mm
        half_width_mm = (design.cols - 1) / 2 * design.pitch_mm + radius_mm
        half_height_mm = (design.rows - 1) / 2 * design.pitch_mm + radius_mm
        among_pins = (np.abs(x) < half_width_mm) & (np.abs(y) < half_height_mm)
        for pin_x, pin_y in self.board.points_mm[~self.board.found].tolist():
            among_pins &= np.hypot(x - pin_x, y - pin_y) > radius_mm
        fitted = self.thin_out(among_pins)
        fitted[fitted] = self.pixel_density(np.column_stack([x[fitted], y[fitted]])) > MIN_PIXEL_DENSITY
        return np.asarray(fitted)

    def pixel_density(self, points_mm: Points) -> Float[Array, " n"]:
        """Return the pixels of the raw image per square millimetre at these points, relative to the centre; negative where the
        image is folded over.
        """
        lens = self.board.lens
        density = determinant_at_each_point(lens.px_per_mm(points_mm))
        central_density = determinant_at_each_point(lens.px_per_mm(np.zeros((1, 2))))
        return np.asarray(density / central_density)

    @cached_property
    def points_mm(self) -> Points:
        """Positions of the fitted pixels."""
        return np.column_stack([axis[self.fitted_pixels] for axis in self.positions_mm]).astype(float)
