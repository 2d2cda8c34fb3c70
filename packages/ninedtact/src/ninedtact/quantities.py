"""The quantities that packages exchange: frames, height maps, wrenches and their parts. Each object carries its own scale, unit and
time stamp, and none shares memory with the next result.

The axes are the same in the whole package: the origin is the centre of the undeformed skin; x runs along image columns, y along
image rows, z outward through the skin (right-handed, as the camera sees it). Arrays are (rows, cols). The centre of an array of n
samples is at index (n − 1)/2. Lengths are in mm; stamps are in ns of the monotonic clock, taken on arrival.
"""

from dataclasses import dataclass, field, replace
from enum import IntEnum, StrEnum
from functools import cached_property
from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int, Int32, UInt8
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.design import Gel

WRENCH_AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
"""Names of the six components of a wrench."""
WRENCH_UNITS = ("N", "N", "N", "N·m", "N·m", "N·m")
DISPLAY_UNITS = ("N", "N", "N", "N·mm", "N·mm", "N·mm")
"""Units of the components where a person reads them."""
DISPLAY_FACTORS = np.array([1.0, 1.0, 1.0, 1e3, 1e3, 1e3])
"""Factors from `WRENCH_UNITS` to `DISPLAY_UNITS`."""
NO_OBJECT = "none"
"""Name of the object in pairs of image and wrench in which nothing touches the skin."""


class HeightSource(IntEnum):
    """Whether the height at one pixel is measured, extrapolated or out of view."""

    OUT_OF_VIEW = 0
    """The camera does not see this point."""
    EXTRAPOLATED = 1
    """The camera sees this point, but it is beyond the calibrated range (deeper than the ball, or farther out than the pins)."""
    MEASURED = 2
    """The camera sees this point, and it is inside the calibrated range."""


BgrImage = UInt8[Array, "_ _ 3"]
"""A colour image as OpenCV and the cameras give it."""


@checks_arguments
@dataclass(frozen=True)
class Frame:
    """One image from the camera."""

    image: UInt8[Array, "rows cols 3"]
    """BGR image."""
    stamp_ns: Annotated[int, Meta(ge=0, lt=1 << 62)] = 0
    """Monotonic clock when the image arrived; 0 for an image without a time."""
    index: Annotated[int, Meta(ge=0, lt=1 << 32)] = 0
    """Number of this image in its source, counted by the source, dropped images included."""


@checks_arguments
@dataclass(frozen=True)
class Rectified:
    """Grey brightness (0 to 255) on the skin's own square grid, with lens distortion removed."""

    grey: Float32[Array, "rows cols"]
    mm_per_px: Annotated[float, Meta(gt=0)]
    stamp_ns: int = 0


@checks_arguments
@dataclass(frozen=True)
class HeightMap:
    """Height of the skin above its undeformed plane: negative where indented, positive where it bulges.

    Pixels are lines of sight: pixel (x, y) on the undeformed plane sees the skin point at (x, y)·(1 + z/camera distance).
    """

    z_mm: Float32[Array, "rows cols"]
    source: UInt8[Array, "rows cols"]
    """A `HeightSource` value per pixel."""
    mm_per_px: Annotated[float, Meta(gt=0)]
    noise_mm: Annotated[float, Meta(ge=0)] = 0.0
    """Standard deviation of one pixel's height from one image to the next, as the calibration measured it."""
    camera_distance_mm: Annotated[float, Meta(gt=0)] = np.inf
    """Distance from the camera to the undeformed skin; infinite for an orthographic view."""
    stamp_ns: int = 0
    is_clipped: bool = False
    """Whether skin is deeper than the depth curve goes, by more than twice its error; it appears as deep as the curve's end."""

    @property
    def indentation_mm(self) -> Float32[Array, "rows cols"]:
        """Return the indentation of the skin, max(−z, 0)."""
        return np.maximum(-self.z_mm, 0)

    @property
    def in_view(self) -> Bool[Array, "rows cols"]:
        """Return the pixels at which the camera sees the skin."""
        return self.source != HeightSource.OUT_OF_VIEW.value

    @property
    def visible_z_mm(self) -> Float32[Array, "rows cols"]:
        """Return the heights, NaN where the camera does not see the skin."""
        return np.where(self.in_view, self.z_mm, np.float32(np.nan))

    @cached_property
    def axes_mm(self) -> tuple[Float32[Array, " cols"], Float32[Array, " rows"]]:
        """Return the coordinates x of the columns and y of the rows."""
        return centred_axis_mm(self.z_mm.shape[1], self.mm_per_px), centred_axis_mm(self.z_mm.shape[0], self.mm_per_px)

    @checks_arguments
    def points_at(self, rows: Int[Array, " n"], cols: Int[Array, " n"]) -> Float64[Array, "n 3"]:
        """Return the points of the skin in mm that these pixels see."""
        x_axis, y_axis = self.axes_mm
        z_mm = self.z_mm[rows, cols].astype(float)
        scale = 1 + z_mm / self.camera_distance_mm  # from where lines of sight cross the undeformed plane to the skin
        return np.column_stack([x_axis[cols] * scale, y_axis[rows] * scale, z_mm])


@checks_arguments
@dataclass(frozen=True)
class PointCloud:
    """Points on the skin with outward unit normals, sensor frame, mm."""

    points_mm: Float32[Array, "n 3"]
    normals: Float32[Array, "n 3"]
    stamp_ns: int = 0


@checks_arguments
@dataclass(frozen=True)
class Mesh:
    """Triangles on the skin, counter-clockwise as seen from outside (normals along +z)."""

    vertices_mm: Float32[Array, "n 3"]
    faces: Int32[Array, "m 3"]


def centred_axis_mm(samples: int, mm_per_px: float) -> Float32[Array, " samples"]:
    """Return the coordinates of `samples` grid points, symmetric about zero."""
    return ((np.arange(samples) - (samples - 1) / 2) * mm_per_px).astype(np.float32)


def skin_grid_mm(
    shape: tuple[int, int], mm_per_px: float
) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
    """Return the coordinates x and y of every pixel of a rectified grid."""
    x, y = np.meshgrid(centred_axis_mm(shape[1], mm_per_px), centred_axis_mm(shape[0], mm_per_px))
    return x, y


@checks_arguments
@dataclass(frozen=True)
class Wrench:
    """Force and torque that the object applies to the skin, in the sensor frame; pressing gives F_z < 0.

    >>> wrench = ninedtact.Wrench(np.array([0.0, 0.0, -2.0]), np.zeros(3))
    >>> float(wrench.about(np.array([10.0, 0.0, 0.0])).torque_nm[1])
    -0.02
    """

    force_n: Float64[Array, "3"]
    torque_nm: Float64[Array, "3"]
    about_mm: Float64[Array, "3"] = field(default_factory=lambda: np.zeros(3))
    """Reference point of the torque; the centre of the skin by default."""
    stamp_ns: int = 0

    @checks_arguments
    def about(self, point_mm: Float64[Array, "3"]) -> "Wrench":
        """Return the same wrench with its torque about another point: τ' = τ + (old − new) × F."""
        return replace(self, torque_nm=(self.shift_matrix(point_mm) @ self.six)[3:], about_mm=np.array(point_mm, float))

    def about_skin_centre(self) -> "Wrench":
        """Return the same wrench with its torque about the centre of the skin."""
        return self.about(np.zeros(3)) if self.about_mm.any() else self

    @checks_arguments
    def shift_matrix(self, point_mm: Float64[Array, "3"]) -> Float64[Array, "6 6"]:
        """Return the matrix that turns `six` into that of the same wrench about another point; it moves covariances too."""
        x, y, z = ((self.about_mm - point_mm) / 1e3).tolist()
        shift = np.eye(6)
        shift[3:, :3] = [[0, -z, y], [z, 0, -x], [-y, x, 0]]
        return shift

    @property
    def six(self) -> Float64[Array, "6"]:
        """F_x, F_y, F_z in N and T_x, T_y, T_z in N·m."""
        return np.concatenate([self.force_n, self.torque_nm])


@checks_arguments
@dataclass(frozen=True)
class Deformation:
    """Darkening and brightening of the rectified image by a contact, with the reference image: the input of the paper's network.

    Values are grey levels, 0 to 255, as floating-point numbers, so that nothing overflows.
    """

    darker: Float32[Array, "rows cols"]
    """max(reference − image, 0)."""
    brighter: Float32[Array, "rows cols"]
    """max(image − reference, 0)."""
    reference: Float32[Array, "rows cols"]
    """The reference image (no contact) of this session."""
    mm_per_px: Annotated[float, Meta(gt=0)]
    stamp_ns: int = 0


@checks_arguments
@dataclass(frozen=True)
class Traction:
    """Traction of the object on the skin, force per area at every place."""

    pressure_mpa: Float32[Array, "rows cols"]
    """Inward pressure, never below zero."""
    shear_mpa: Float32[Array, "2 rows cols"]
    """Shear traction along x and along y."""
    mm_per_px: Annotated[float, Meta(gt=0)]
    stamp_ns: int = 0
    height_mm: Float32[Array, "rows cols"] | None = None
    """Height of the skin on which the tractions act, where it is known; the shear then has a lever arm."""
    gel: Gel = Gel()
    """The gel that they deform, with the modulus that scales them."""

    @property
    def is_touched(self) -> Bool[Array, "rows cols"]:
        """Return the places at which the object presses."""
        return self.pressure_mpa > 0

    def wrench(self) -> Wrench:
        """Return the sum of the tractions, with the torque about the skin's centre. Lever arms end on the skin, or on its
        undeformed plane where no height is known.
        """
        rows, cols = self.pressure_mpa.shape
        x_mm, y_mm = (centred_axis_mm(side, self.mm_per_px).astype(float) for side in (cols, rows))
        parts_n = self.parts_mpa * self.mm_per_px**2
        with_x, with_y = parts_n.sum(1) @ x_mm, parts_n.sum(2) @ y_mm
        with_z = np.zeros(3) if self.height_mm is None else (parts_n * self.height_mm).sum((1, 2))
        torque_nmm = np.array([with_y[2] - with_z[1], with_z[0] - with_x[2], with_x[1] - with_y[0]])
        return Wrench(parts_n.sum((1, 2)), torque_nmm / 1e3, stamp_ns=self.stamp_ns)

    @property
    def parts_mpa(self) -> Float64[Array, "3 rows cols"]:
        """Return the tractions along x, along y and outwards."""
        return np.concatenate([self.shear_mpa, -self.pressure_mpa[None]]).astype(float)


class EstimateWarning(StrEnum):
    """The reason why an estimate is doubtful. After the reasons that begin with *image*, nothing is estimated."""

    OUT_OF_RANGE = "out of range"
    """The force is outside the range for which the estimator was made."""
    UNLIKE_TRAINING = "unlike training"
    """The image is unlike the images from which the estimator was trained."""
    NOT_CONVERGED = "not converged"
    """The solver stopped before it converged."""
    PART_UNSEEN = "part unseen"
    """The contact extends beyond the camera's view."""
    REFERENCE_UNLIKE_CALIBRATION = "reference unlike the calibrated one"
    """The reference image of this session shows another sensor or something that touches the gel, or is overexposed."""
    CALIBRATION_EDITED = "calibration edited"
    """The numbers of `sensor.toml` are not those that the calibration wrote."""
    NOT_CALIBRATED = "not calibrated"
    """Nothing of the sensor is calibrated: gel and light are taken to be those of the published design."""
    LIGHT_CHANGED = "light changed"
    """Gain or gamma differ from those of the reference image by 1 % or more; what `Reading.light` says was taken out."""
    LIGHT_BANDED = "bands in the light"
    """Bands of a dimmed light under a rolling shutter; they were taken out."""
    LIGHT_FLICKERS = "light flickers"
    """The brightness of the stream oscillates; `Reading.stream` says with which period."""
    DIRT = "dirt in view"
    """Spots that gel cannot make, on lens or window; they were masked."""
    IMAGE_DARK = "image dark"
    """The image is too dark to show anything: light off, lens covered, exposure changed."""
    IMAGE_OVEREXPOSED = "image overexposed"
    """Most of the image is white."""
    IMAGE_UNLIKE_REFERENCE = "image unlike its reference"
    """No press can turn the reference image into this image: another sensor, other light, a failed LED, images exchanged."""


@checks_arguments
@dataclass(frozen=True)
class WrenchEstimate:
    """A wrench that was estimated from an image, with its uncertainty."""

    wrench: Wrench
    covariance: Float64[Array, "6 6"]
    """Covariance of the errors of `wrench.six`, N², N²·m and N²·m²; infinite variances where no error is stated."""
    touching: bool
    """Whether there is contact; without contact the wrench is exactly zero."""
    warnings: tuple[EstimateWarning, ...] = ()
    traction: Traction | None = None
    """The traction, where the estimator computes it."""

    @property
    def std(self) -> Float64[Array, "6"]:
        """One standard deviation of each component of `wrench.six`, N and N·m."""
        return np.sqrt(np.diag(self.covariance))

    @checks_arguments
    def about(self, point_mm: Float64[Array, "3"]) -> "WrenchEstimate":
        """Return the same estimate with torques, and their errors, about another point."""
        shift = self.wrench.shift_matrix(point_mm)
        unknown = ~np.isfinite(self.covariance).all(axis=1)
        covariance = shift @ np.where(unknown[:, None] | unknown, 0, self.covariance) @ shift.T
        # An axis into which the move mixes one without a stated error has none either.
        covariance[np.diag_indices(6)] += np.where((shift[:, unknown] != 0).any(axis=1), np.inf, 0)
        return replace(self, wrench=self.wrench.about(point_mm), covariance=covariance)

    def about_skin_centre(self) -> "WrenchEstimate":
        """Return the same estimate with torques, and their errors, about the centre of the skin."""
        return self.about(np.zeros(3))


def diagonal_covariance(std: Float64[Array, "6"]) -> Float64[Array, "6 6"]:
    """Return the covariance of errors of these standard deviations that are independent of each other."""
    return np.diag(std**2)
