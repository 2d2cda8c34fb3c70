"""Lens and rectification: the projection from the skin to the raw image, and the grey image on the skin's own square grid that
follows from it, with the lens distortion removed. Points are (x, y): mm on the skin (sensor frame), pixels in the image (columns,
rows; pixel centres at integers).

`LensModel`, the default: a wide-angle lens sees the plane through window and gel. The model is a homography (tilt, distance,
position) followed by radial and tangential terms about a free centre (Brown 1971, as in OpenCV's camera model; docs/references.md).
`CorrectedLensModel` adds a smooth displacement to it, for lenses and gels that the model does not follow.
`RadialBasisProjection`, for reproducing the paper: five central anchors, an equidistant grid, and a cubic radial-basis map
through all pins (docs/references.md: 9DTact, section on camera calibration). It passes exactly through every pin, so every pin's
error enters the map.

`rectification_of_projection` computes, for every pixel of the skin's grid, the raw pixel that shows it; `Rectification` resamples
images by that map.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from typing import TYPE_CHECKING, Literal, Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.design import RectifiedImageSize
from ninedtact.errors import CalibrationError, FileFormatError
from ninedtact.quantities import BgrImage, Frame, HeightSource, Rectified, skin_grid_mm

if TYPE_CHECKING:
    from scipy.interpolate import RBFInterpolator

Points = Float[Array, "n 2"]

HOMOGRAPHY_TERMS = 8
CENTRE_TERMS = 2


class PixelNotOnSkin(CalibrationError):
    """No point of the skin appears at this pixel."""


@runtime_checkable
class Projection(Protocol):
    """A projection from points of the skin to pixels of the raw image."""

    def to_px(self, points_mm: Points) -> Points:
        """Return the pixels (x, y) at which these skin points appear."""
        ...


@dataclass(frozen=True)
class LensModel:
    """A homography, followed by radial and tangential terms about a free centre."""

    homography: tuple[float, ...]
    """Eight entries, row by row, the ninth being 1; mm to image units."""
    centre: tuple[float, float]
    """Centre of the radial terms, in image units."""
    radial: tuple[float, ...]
    tangential: tuple[float, float]
    raw_shape: tuple[int, int]
    """(rows, cols) of the raw image. The image unit is half the long side, measured from the middle."""

    @property
    def unit_px(self) -> float:
        """Number of pixels in one image unit."""
        return max(self.raw_shape) / 2

    @property
    def middle_px(self) -> Float[Array, "2"]:
        """Pixel at which both image coordinates are zero."""
        rows, cols = self.raw_shape
        return np.array([(cols - 1) / 2, (rows - 1) / 2])

    @property
    def parameters(self) -> Float[Array, " k"]:
        """All parameters as one vector: homography, centre, radial terms, tangential terms."""
        return np.array([*self.homography, *self.centre, *self.radial, *self.tangential])

    def with_parameters(self, parameters: Float[Array, " k"]) -> "LensModel":
        """Return a model of the same kind with other parameters."""
        homography, centre, radial, tangential = np.split(
            np.asarray(parameters, float), np.cumsum([HOMOGRAPHY_TERMS, CENTRE_TERMS, len(self.radial)])
        )
        return replace(
            self,
            homography=tuple(homography.tolist()),
            centre=(float(centre[0]), float(centre[1])),
            radial=tuple(radial.tolist()),
            tangential=(float(tangential[0]), float(tangential[1])),
        )

    def to_px(self, points_mm: Points) -> Points:
        """Return the pixels (x, y) at which skin points (x, y) in mm appear."""
        return self.distort(self.in_plane(np.asarray(points_mm, float))) * self.unit_px + self.middle_px

    def in_plane(self, points_mm: Points) -> Points:
        """Apply the homography: mm to image units before distortion."""
        return self._in_plane_with_depth(points_mm)[0]

    def _in_plane_with_depth(self, points_mm: Points) -> tuple[Points, Float[Array, "n 1"]]:
        """Return the points in image units before distortion, and the divisor of the homography."""
        x, y = points_mm[:, :1], points_mm[:, 1:]
        (a, b, c), (d, e, f), (g, h) = self.homography[:3], self.homography[3:6], self.homography[6:]
        depth = g * x + h * y + 1.0
        return np.hstack([a * x + b * y + c, d * x + e * y + f]) / depth, depth

    def distort(self, plane: Points) -> Points:
        """Apply the radial and tangential terms, image units to image units."""
        x, y = (plane - self.centre).T
        squared, product, (p, q) = x * x + y * y, 2 * x * y, self.tangential
        growth = 1 + squared * _polynomial(self.radial, squared)
        bent_x = x * growth + p * product + q * (squared + 2 * x * x)
        bent_y = y * growth + q * product + p * (squared + 2 * y * y)
        return np.column_stack([bent_x, bent_y]) + self.centre

    def px_per_mm(self, points_mm: Points) -> Float[Array, "n 2 2"]:
        """Return the Jacobian of `to_px`: rows are pixel axes, columns are mm axes."""
        plane, depth = self._in_plane_with_depth(np.asarray(points_mm, float))
        matrix = np.append(self.homography, 1.0).reshape(3, 3)
        by_point = (matrix[:2, :2] - plane[..., None] * matrix[2, :2]) / depth[..., None]
        return np.asarray(self._distortion_jacobian(plane) @ by_point * self.unit_px)

    def px_per_parameter(self, points_mm: Points) -> Float[Array, "n 2 k"]:
        """Return the derivative of `to_px` by every parameter, in the order of `parameters`."""
        points_mm = np.asarray(points_mm, float)
        plane, depth = self._in_plane_with_depth(points_mm)
        by_plane, offset = self._distortion_jacobian(plane), plane - self.centre
        ahead, none = np.column_stack([points_mm, np.ones(len(points_mm))]) / depth, np.zeros((len(points_mm), 3))
        by_rows = np.stack([np.hstack([ahead, none]), np.hstack([none, ahead])], axis=1)
        by_homography = np.concatenate([by_rows, -plane[..., None] * ahead[:, None, :2]], axis=2)
        squared, product = (offset**2).sum(axis=1, keepdims=True), 2 * offset.prod(axis=1, keepdims=True)
        by_radial = list(accumulate(self.radial, lambda term, _: term * squared, initial=offset))[1:]
        along = squared + 2 * offset**2
        by_tangential = [np.hstack([product, along[:, 1:]]), np.hstack([along[:, :1], product])]
        rest = np.stack([*by_radial, *by_tangential], axis=-1)
        return np.concatenate([by_plane @ by_homography, np.eye(2) - by_plane, rest], axis=2) * self.unit_px

    def _distortion_jacobian(self, plane: Points) -> Float[Array, "n 2 2"]:
        offset = plane - self.centre
        squared = offset[:, 0] ** 2 + offset[:, 1] ** 2
        growth = 1 + squared * _polynomial(self.radial, squared)
        slope = _polynomial([(2 * n + 2) * k for n, k in enumerate(self.radial)], squared)
        (x, y), (p, q) = offset.T, self.tangential
        bend = np.stack([2 * p * y + 6 * q * x, 2 * p * x + 2 * q * y, 2 * p * x + 2 * q * y, 2 * q * x + 6 * p * y])
        outer = offset[:, :, None] * offset[:, None, :] * slope[:, None, None]
        return np.asarray(np.eye(2) * np.reshape(growth, (-1, 1, 1)) + outer + bend.T.reshape(-1, 2, 2))

    def to_mm(self, points_px: Points) -> Points:
        """Return the skin points in mm that appear at these pixels; raises `PixelNotOnSkin` where there is none."""
        target = np.asarray(points_px, float)
        points = self.from_affine(target)
        for _ in range(30):
            miss = target - self.to_px(points)
            slope = self.px_per_mm(points)
            if not determinant_at_each_point(slope).all() or not np.isfinite(slope).all():
                break
            points = points + solve_at_each_point(slope, miss)
            if np.abs(miss).max(initial=0.0) < 1e-9 * self.unit_px:
                return points
        raise PixelNotOnSkin(
            expected="pixels on the skin", got="some that the lens model cannot reach", remedy="stay inside the image"
        )

    def from_affine(self, points_px: Points) -> Points:
        """Return a first guess of `to_mm`, by the model's tangent at the skin centre."""
        origin = np.zeros((1, 2))
        return (points_px - self.to_px(origin)) @ np.linalg.inv(self.px_per_mm(origin)[0]).T


def determinant_at_each_point(matrices: Float[Array, "n 2 2"]) -> Float[Array, " n"]:
    """Return the determinant of each matrix."""
    return np.asarray(matrices[:, 0, 0] * matrices[:, 1, 1] - matrices[:, 0, 1] * matrices[:, 1, 0])


def solve_at_each_point(matrices: Float[Array, "n 2 2"], right: Float[Array, "n 2 *k"]) -> Float[Array, "n 2 *k"]:
    """Return the solution of two linear equations at each point, by Cramer's rule, which is faster than `numpy.linalg.solve`."""
    matrices = matrices / determinant_at_each_point(matrices)[:, None, None]
    columns = (slice(None), *(None,) * (right.ndim - 2))
    a, b, c, d = (matrices[:, row, column][columns] for row in (0, 1) for column in (0, 1))
    x, y = right[:, 0], right[:, 1]
    return np.stack([d * x - b * y, a * y - c * x], axis=1)


def _polynomial(coefficients: Sequence[float], at: Float[Array, " n"]) -> Float[Array, " n"]:
    """Return the polynomial of these coefficients, the constant first, by Horner's rule."""
    value = np.zeros_like(at)
    for coefficient in reversed(coefficients):
        value = value * at + coefficient
    return value


def central_mm_per_px(projection: Projection, reach_mm: float) -> float:
    """Return the mm on the skin per raw pixel around the centre: the mean over four points `reach_mm` away from it (the paper's
    anchors, where the reach is the pitch).
    """
    points = np.array([(0, 0), (reach_mm, 0), (-reach_mm, 0), (0, reach_mm), (0, -reach_mm)], float)
    middle, *around = projection.to_px(points)
    return float(reach_mm / np.hypot(*(np.array(around) - middle).T).mean())


@dataclass(frozen=True)
class LensModelCorrection:
    """A smooth displacement in the image on top of a lens model: Gaussians about the pins, so that it vanishes far from them."""

    points_mm: Points
    weights_px: Points
    width_mm: float
    """Standard deviation of the Gaussians on the skin."""

    def shift_px(self, points_mm: Points) -> Points:
        """Return the displacement in pixels at these skin points."""
        return gaussian_basis_matrix(np.asarray(points_mm, float), self.points_mm, self.width_mm) @ self.weights_px


def gaussian_basis_matrix(points_mm: Points, centres_mm: Float[Array, "k 2"], width_mm: float) -> Float[Array, "n k"]:
    """Return the Gaussians about the centres, which are one there, at these points."""
    squared = sum((points_mm[:, None, axis] - centres_mm[None, :, axis]) ** 2 for axis in (0, 1))
    return np.asarray(np.exp(-squared / (2 * width_mm**2)))


@dataclass(frozen=True)
class CorrectedLensModel:
    """A lens model plus a smooth displacement of its pixels."""

    lens: LensModel
    correction: LensModelCorrection

    def to_px(self, points_mm: Points) -> Points:
        """Return the pixels (x, y) at which skin points appear."""
        return self.lens.to_px(points_mm) + self.correction.shift_px(points_mm)


@dataclass(frozen=True)
class RadialBasisProjection:
    """Cubic radial-basis interpolation from the skin to the image."""

    points_mm: Points
    points_px: Points

    def to_px(self, points_mm: Points) -> Points:
        """Return the pixels (x, y) at which skin points appear."""
        return np.asarray(self.interpolator(np.asarray(points_mm, float)))

    @cached_property
    def interpolator(self) -> "RBFInterpolator":
        """The interpolator, solved once."""
        from scipy.interpolate import RBFInterpolator  # slow to import

        return RBFInterpolator(self.points_mm, self.points_px, kernel="cubic")


CameraRotation = Literal[0, 90, 180, 270]
"""Angle from the image's column axis to the sensor's x axis, in degrees, clockwise on the screen."""
Area = tuple[float, float, float, float]
"""x from, x to, y from, y to, in mm on the skin."""
OUT_OF_VIEW_PX = -1.0
"""Both coordinates of the source pixel of a rectified pixel that an imported map declares to be outside the raw image."""


@dataclass(frozen=True)
class Rectification:
    """The raw pixel from which every pixel of the rectified grid takes its brightness."""

    source_px: Float32[Array, "rows cols 2"]
    """Raw pixel (x, y) of every rectified pixel."""
    mm_per_px: float
    raw_shape: tuple[int, int]
    calibrated_area_mm: Area
    """Area that the calibration covers; heights outside are marked as extrapolated."""

    def __call__(self, frame: Frame) -> Rectified:
        """Rectify one frame; raises `FileFormatError`."""
        self.require_size(frame.image)
        grey = cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY).astype(np.float32)
        return Rectified(self.resample(grey), self.mm_per_px, frame.stamp_ns)

    def resample(self, raw: Float32[Array, "raw_rows raw_cols"]) -> Float32[Array, "rows cols"]:
        """Return any raw grey field on the rectified grid, by bilinear interpolation; edges are repeated outside the image."""
        x, y = self.source_planes
        return np.asarray(cv2.remap(raw, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def require_size(self, image: UInt8[Array, "raw_rows raw_cols 3"]) -> None:
        """Refuse an image of another size."""
        if image.shape[:2] != self.raw_shape:
            (rows, cols), (got_rows, got_cols) = self.raw_shape, image.shape[:2]
            raise FileFormatError(
                expected=f"images of {cols}x{rows} pixels as this sensor was calibrated with",
                got=f"{got_cols}x{got_rows}",
                remedy="give images of that size, or calibrate this size (`ninedtact calibrate --size`)",
            )

    @cached_property
    def source_planes(self) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """x and y of the source pixels as two arrays, the form in which OpenCV 5 resamples fastest."""
        return np.ascontiguousarray(self.source_px[..., 0]), np.ascontiguousarray(self.source_px[..., 1])

    @cached_property
    def height_source(self) -> UInt8[Array, "rows cols"]:
        """`HeightSource` of every pixel as far as the lens determines it, before any depth is computed."""
        rows, cols = self.raw_shape
        x, y = self.source_px[..., 0], self.source_px[..., 1]
        seen = (x >= -0.5) & (x <= cols - 0.5) & (y >= -0.5) & (y <= rows - 0.5)
        return np.where(seen, self.calibrated_region, HeightSource.OUT_OF_VIEW).astype(np.uint8)

    @property
    def calibrated_region(self) -> UInt8[Array, "rows cols"]:
        """Return MEASURED inside the calibrated area and EXTRAPOLATED outside."""
        x, y = skin_grid_mm(self.source_px.shape[:2], self.mm_per_px)
        left, right, top, bottom = self.calibrated_area_mm
        inside = (x >= left) & (x <= right) & (y >= top) & (y <= bottom)
        return np.where(inside, HeightSource.MEASURED, HeightSource.EXTRAPOLATED).astype(np.uint8)


def rectification_of_projection(
    projection: Projection,
    field_of_view: RectifiedImageSize,
    mm_per_px: float,
    raw_shape: tuple[int, int],
    calibrated_area_mm: Area,
) -> Rectification:
    """Return the rectification of a grid on the skin, with the raw pixel of every grid pixel found by the projection."""
    shape = (field_of_view.rows, field_of_view.cols)
    points_mm = np.column_stack([axis.ravel() for axis in skin_grid_mm(shape, mm_per_px)]).astype(float)
    source = projection.to_px(points_mm).astype(np.float32).reshape(*shape, 2)
    return Rectification(source, mm_per_px, raw_shape, calibrated_area_mm)


def to_grey_float(image: BgrImage) -> Float32[Array, "rows cols"]:
    """Convert a BGR image to grey levels as float32."""
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32)
