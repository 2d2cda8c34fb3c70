"""Quantities of shape: camera frames, rectified images, height maps, point clouds and meshes."""

from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float32, Int32, UInt8
from numpy import ndarray as Array


class HeightSource(IntEnum):
    """The source of the height at one pixel."""

    OUT_OF_VIEW = 0
    """The camera does not see this point."""
    EXTRAPOLATED = 1
    """The camera sees this point, but it is beyond the calibrated range (deeper than the ball, or farther out than the pins)."""
    MEASURED = 2
    """The camera sees this point, and it is inside the calibrated range."""


@dataclass(frozen=True)
class Frame:
    """One image from the camera."""

    image: UInt8[Array, "rows cols 3"]
    """BGR image."""
    stamp_ns: int = 0
    """Monotonic clock when the image arrived; 0 for an image without a time."""
    index: int = 0
    """Number of this image in its source, counted by the source, dropped images included."""


@dataclass(frozen=True)
class Rectified:
    """Grey brightness (0 to 255) on the skin's own square grid, with lens distortion removed."""

    grey: Float32[Array, "rows cols"]
    mm_per_px: float
    stamp_ns: int = 0


@dataclass(frozen=True)
class HeightMap:
    """Height of the skin above its undeformed plane: negative where indented, positive where it bulges.

    Pixels are lines of sight: pixel (x, y) on the undeformed plane sees the skin point at (x, y)·(1 + z/camera distance).
    """

    z_mm: Float32[Array, "rows cols"]
    source: UInt8[Array, "rows cols"]
    """A `HeightSource` value per pixel."""
    mm_per_px: float
    noise_mm: float = 0.0
    """Standard deviation of one pixel's height from one image to the next, as the calibration measured it."""
    camera_distance_mm: float = np.inf
    """Distance from the camera to the undeformed skin; infinite for an orthographic view."""
    stamp_ns: int = 0

    @property
    def indentation_mm(self) -> Float32[Array, "rows cols"]:
        """Return the indentation of the skin, max(−z, 0)."""
        return np.maximum(-self.z_mm, 0)

    @property
    def in_view(self) -> Bool[Array, "rows cols"]:
        """Return the pixels at which the camera sees the skin."""
        return self.source != HeightSource.OUT_OF_VIEW.value

    @cached_property
    def axes_mm(self) -> tuple[Float32[Array, " cols"], Float32[Array, " rows"]]:
        """Return the coordinates x of the columns and y of the rows."""
        return centred_axis_mm(self.z_mm.shape[1], self.mm_per_px), centred_axis_mm(self.z_mm.shape[0], self.mm_per_px)


@dataclass(frozen=True)
class PointCloud:
    """Points on the skin with outward unit normals, sensor frame, mm."""

    points_mm: Float32[Array, "n 3"]
    normals: Float32[Array, "n 3"]
    stamp_ns: int = 0


@dataclass(frozen=True)
class Mesh:
    """Triangles on the skin, counter-clockwise as seen from outside (normals along +z)."""

    vertices_mm: Float32[Array, "n 3"]
    faces: Int32[Array, "m 3"]


def centred_axis_mm(samples: int, mm_per_px: float) -> Float32[Array, " samples"]:
    """Return the coordinates of `samples` grid points, symmetric about zero."""
    return ((np.arange(samples) - (samples - 1) / 2) * mm_per_px).astype(np.float32)
