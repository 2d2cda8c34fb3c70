"""The nouns that cross rooms. Each carries its own scale, unit and stamp; none shares memory with the next result.

Axes, once for the whole package: the origin is the centre of the untouched skin; x runs along picture columns, y along
picture rows, z outward through the skin (right-handed, as the camera sees it). Arrays are (rows, cols). The centre of
an array of n samples is index (n − 1)/2. Lengths are mm; stamps are ns of the monotonic clock, taken on arrival.
"""

from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, UInt8
from numpy import ndarray as Array


class Coverage(IntEnum):
    """What a height at one pixel rests on."""

    OUT_OF_VIEW = 0
    """The camera does not see this point."""
    EXTRAPOLATED = 1
    """Seen, but beyond what the calibration covered (deeper than the ball, or farther out than the pins)."""
    MEASURED = 2
    """Seen, and inside the calibrated range."""


@dataclass(frozen=True)
class Frame:
    """One picture as the camera gave it."""

    image: UInt8[Array, "rows cols 3"]
    """BGR."""
    stamp_ns: int = 0
    """Monotonic clock when the picture arrived; 0 for a picture without a time."""
    index: int = 0
    """Number of this picture in its source, counted by the source itself, drops included."""


@dataclass(frozen=True)
class Rectified:
    """Grey brightness (0 to 255) on the skin's own square grid, lens removed."""

    grey: Float32[Array, "rows cols"]
    mm_per_px: float
    stamp_ns: int = 0


@dataclass(frozen=True)
class HeightMap:
    """Height of the skin above its untouched plane: negative where pressed in, positive where it bulges.

    Pixels are lines of sight: pixel (x, y) on the untouched plane sees the skin point at (x, y)·(1 + z/camera distance).
    """

    z_mm: Float32[Array, "rows cols"]
    coverage: UInt8[Array, "rows cols"]
    """A `Coverage` value per pixel."""
    mm_per_px: float
    noise_mm: float = 0.0
    """Standard deviation of one pixel's height from one picture to the next, as the calibration measured it."""
    camera_distance_mm: float = np.inf
    """From the camera to the untouched skin; infinite where every pixel is seen from straight below."""
    stamp_ns: int = 0

    @property
    def indentation_mm(self) -> Float32[Array, "rows cols"]:
        """How far the skin is pressed in, max(−z, 0)."""
        return np.maximum(-self.z_mm, 0)

    @property
    def in_view(self) -> Bool[Array, "rows cols"]:
        """Where the camera sees the skin at all."""
        return self.coverage != Coverage.OUT_OF_VIEW.value

    @cached_property
    def axes_mm(self) -> tuple[Float32[Array, " cols"], Float32[Array, " rows"]]:
        """Coordinates x of the columns and y of the rows."""
        return centred_axis_mm(self.z_mm.shape[1], self.mm_per_px), centred_axis_mm(self.z_mm.shape[0], self.mm_per_px)


@dataclass(frozen=True)
class PointCloud:
    """Points on the skin with outward unit normals, sensor frame, mm."""

    points_mm: Float32[Array, "n 3"]
    normals: Float32[Array, "n 3"]
    stamp_ns: int = 0


@dataclass(frozen=True)
class Mesh:
    """Triangles on the skin, counter-clockwise seen from outside (normals along +z)."""

    vertices_mm: Float32[Array, "n 3"]
    faces: Int32[Array, "m 3"]


@dataclass(frozen=True)
class Wrench:
    """Force and torque that the object applies to the skin, sensor frame: pressing gives F_z < 0."""

    force_n: Float64[Array, "3"]
    torque_nm: Float64[Array, "3"]
    about_mm: Float64[Array, "3"] = field(default_factory=lambda: np.zeros(3))
    """The point that the torque is about; the skin's centre unless said otherwise."""
    stamp_ns: int = 0

    def about(self, point_mm: Float64[Array, "3"]) -> "Wrench":
        """The same wrench with its torque about another point: τ' = τ + (old − new) × F."""
        arm_m = (self.about_mm - point_mm) / 1e3
        return replace(self, torque_nm=self.torque_nm + np.cross(arm_m, self.force_n), about_mm=point_mm)

    @property
    def six(self) -> Float64[Array, "6"]:
        """F_x, F_y, F_z in N and T_x, T_y, T_z in N·m."""
        return np.concatenate([self.force_n, self.torque_nm])


@dataclass(frozen=True)
class Reading:
    """All that one frame gave, what each stage cost, and how old it is."""

    frame: Frame
    rectified: Rectified
    height: HeightMap
    stage_ms: dict[str, float] = field(default_factory=dict)
    dropped: int = 0
    """Frames that the source delivered and nobody read, since the source was opened."""

    def age_ms(self, now_ns: int) -> float:
        """Time since the frame arrived, against `time.monotonic_ns()`."""
        return (now_ns - self.frame.stamp_ns) / 1e6


def centred_axis_mm(samples: int, mm_per_px: float) -> Float32[Array, " samples"]:
    """Coordinates of `samples` grid points, symmetric about zero."""
    return ((np.arange(samples) - (samples - 1) / 2) * mm_per_px).astype(np.float32)
