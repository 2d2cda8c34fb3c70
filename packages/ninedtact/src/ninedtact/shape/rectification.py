"""Rectification: raw image → grey image on the skin's own square grid, with the lens distortion removed.
`rectification_of_projection` computes, for every pixel of the grid, the raw pixel that shows it; `Rectification` resamples images
by that map.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.design import RectifiedImageSize
from ninedtact.errors import FileFormatError
from ninedtact.quantities import Frame, HeightSource, Rectified, skin_grid_mm
from ninedtact.shape.lens import Projection

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
        _require_bgr(frame.image)
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
                f"expected images of {cols}x{rows} pixels as this sensor was calibrated with, got {got_cols}x{got_rows}; "
                "set the camera to that size, or calibrate again at the new one"
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


def _require_bgr(image: Array) -> None:
    """Refuse an image that is not a BGR image of 8 bits: heights of other grey levels would be wrong."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise FileFormatError(
            f"expected BGR images of 8 bits (uint8, rows x cols x 3), got {image.dtype} of shape {image.shape}; convert them, a "
            "grey one with cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)"
        )


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
