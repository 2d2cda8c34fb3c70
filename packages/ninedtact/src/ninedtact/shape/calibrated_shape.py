"""The calibrated shape path of one sensor: rectification, depth curve and their errors, from a camera frame to a height map.

The only other input is the reference image of the session (no contact), to which `CalibratedShape.depth_reader` binds the depth
curve: a `DepthReader` turns rectified images into height maps.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Float32, Shaped, UInt8, UInt16
from numpy import ndarray as Array

from ninedtact.errors import CalibrationError
from ninedtact.mechanics.base_deflection import BaseDeflection
from ninedtact.quantities import EstimateWarning, Frame, HeightMap, HeightSource, Rectified
from ninedtact.shape.deblurring import Deblurring, block_means, upsample
from ninedtact.shape.depth import (
    DIMMEST_REFERENCE,
    FINE_SMOOTHING,
    TABLE_STEPS,
    ZERO_INDEX,
    DepthCurve,
    GlobalDimmingModel,
    Smoothing,
)
from ninedtact.shape.lens_and_rectification import Rectification
from ninedtact.shape.light_change import LightCorrection
from ninedtact.shape.surface import max_indentation_mm, relief_of_deepest_patch_mm

REFERENCE_FRAMES = 10
"""Number of images without contact whose mean is a reference image; it brings their noise below that of a reading."""
MIN_LIT_GREY_LEVEL = 15.0
"""Mean grey level below which an image counts as taken in the dark and cannot be a reference image."""
_MAX_UNSTEADINESS = 0.1
"""Largest relative difference of the mean brightness between the images of one reference; light that is being switched on changes
by more."""
_SHAPE_ERROR_MM = 0.012
"""What edges, strokes and teeth of objects that are not balls add to the error of the maximum indentation
(`benchmarks/reconstruction_study.py`)."""
_HIDDEN_RELIEF = 0.35
"""Error of the maximum indentation over the relief that smoothing by the point spread takes off it: structure as fine as light is
scattered is read too shallow, and sharpening it overshoots. The most likely value for objects of all families on three simulated
sensors; on three others 74 and 83 % of true values are within one and two standard deviations with it, 63 and 79 % without."""
_KEPT_BYTES = 31 << 20
"""Size in bytes, just below the 32 MiB above which glibc no longer adapts its threshold (mallopt(3), M_MMAP_THRESHOLD)."""

FindReferenceFaults = Callable[[Sequence[Frame]], Sequence[str]]
"""Returns why raw images cannot be reference images of the calibrated sensor; nothing where they can."""


class ReferenceUnusable(CalibrationError):
    """The reference images of a session (no contact) are missing, too dark, or differ in brightness."""


@dataclass(frozen=True)
class DepthReader:
    """A depth curve bound to the reference image of this session."""

    curve: DepthCurve
    reference: Rectified
    lens_source: UInt8[Array, "rows cols"]
    smoothing: Smoothing = Smoothing()
    noise_mm: float = 0.0
    camera_distance_mm: float = np.inf
    loss: GlobalDimmingModel = GlobalDimmingModel()
    deblurring: Deblurring | None = None
    """The removal of the point spread of this sensor's light; None where the calibration does not determine it."""
    base_deflection: BaseDeflection | None = None
    """The deflection of the gel's base, which is added to the thinning that the curve gives; None where it is not known."""
    depth_per_thinning: float = 1.0
    """Depth of the press that calibrated the curve over the thinning at its end; above one on a base that yields."""
    reference_faults: tuple[str, ...] = ()
    """Why the reference image cannot be that of the calibrated sensor; empty where it can, or where this was not checked."""

    def __call__(self, rectified: Rectified) -> HeightMap:
        """Return the signed height of the skin, with the `HeightSource` of every pixel.

        After deblurring, heights are looked up and smoothed on the coarser grid, and only then brought to that of the image.
        """
        index = self._index_on_computed_grid(rectified.grey)
        few_mm = self.smoothing.on_grid(1 / self.coarseness)(self.curve.look_up_mm(index))
        if self.base_deflection is not None:
            few_mm = few_mm + self.base_deflection(few_mm, rectified.mm_per_px * self.coarseness)
        z_mm = self._on_image_grid(few_mm)
        if not self.curve.knows_bulges:
            cv2.threshold(z_mm, 0, 0, cv2.THRESH_TRUNC, dst=z_mm)
        if not self.all_in_view:
            z_mm[self.lens_source == HeightSource.OUT_OF_VIEW] = 0
        source = self.height_source(index)
        return HeightMap(
            z_mm,
            source,
            rectified.mm_per_px,
            self.noise_mm,
            self.camera_distance_mm,
            rectified.stamp_ns,
            self._is_clipped(index),
        )

    def _is_clipped(self, index: UInt16[Array, "few_rows few_cols"]) -> bool:
        """Return whether skin is darker than the end of the curve, its continuation included, by more than its error explains.

        index: on the grid on which heights are looked up. It is smoothed as these are, because noise darkens single pixels.
        """
        if index.min() >= self.curve.clipped_index:
            return False
        smoothed = self.smoothing.on_grid(1 / self.coarseness)(index.astype(np.float32))
        return bool(smoothed.min() < self.curve.clipped_index)

    def index(self, grey: Float32[Array, "rows cols"]) -> UInt16[Array, "rows cols"]:
        """Return the table index of every pixel; lost and scattered light is restored first where it is calibrated."""
        return self._on_image_grid(self._index_on_computed_grid(grey))

    def _index_on_computed_grid(self, grey: Float32[Array, "rows cols"]) -> UInt16[Array, "few_rows few_cols"]:
        """Return the table index on the grid on which heights are looked up: after deblurring a coarser one."""
        if self.deblurring is None:
            lost = self.loss(grey, self.reference.grey)
            return self.quantise(grey if lost == 0 else grey * np.float32(1 / (1 + lost)))
        ratio = block_means(grey, self.coarseness) * self.per_coarse_reference
        ratio *= np.float32(1 / (1 + self.loss.loss_of(ratio)))
        change, steps = self.deblurring(ratio, self.reference.mm_per_px), TABLE_STEPS["ratio"]
        return np.asarray(cv2.addWeighted(change, steps, change, 0, ZERO_INDEX - steps, dtype=cv2.CV_16U))

    def _on_image_grid(self, field: Shaped[Array, "few_rows few_cols"]) -> Shaped[Array, "rows cols"]:
        """Return a field of the grid on which heights are looked up on the grid of the image."""
        return field if self.coarseness == 1 else upsample(field, self.lens_source.shape, self.coarseness)

    @cached_property
    def coarseness(self) -> int:
        """Pixels along one side of a point of the grid on which heights are looked up."""
        return 1 if self.deblurring is None else self.deblurring.coarseness(self.reference.mm_per_px)

    @cached_property
    def per_reference(self) -> Float32[Array, "rows cols"]:
        """The reciprocal of the reference image, whose darkest pixels are raised to `DIMMEST_REFERENCE`."""
        return 1 / np.maximum(self.reference.grey, np.float32(DIMMEST_REFERENCE))

    @cached_property
    def per_coarse_reference(self) -> Float32[Array, "few_rows few_cols"]:
        """The reciprocal of the reference image on the coarser grid."""
        return 1 / np.maximum(block_means(self.reference.grey, self.coarseness), np.float32(DIMMEST_REFERENCE))

    def error_mm(self, indentation_mm: float) -> float:
        """Return the standard deviation of one pixel's indentation: scatter of the calibration and noise of the camera."""
        _, thinning_mm, error_mm = self.curve.pressed
        scatter = np.interp(indentation_mm / self.depth_per_thinning, thinning_mm, error_mm)
        return float(np.hypot(scatter, self.noise_mm))

    def max_indentation_error_mm(self, height: HeightMap) -> float:
        """Return the standard deviation of the maximum indentation of a height map (`surface.max_indentation_mm`)."""
        errors_mm = [self.error_mm(max_indentation_mm(height)), _SHAPE_ERROR_MM]
        if self.deblurring is not None and self.deblurring.point_spread_mm > 0:
            errors_mm.append(_HIDDEN_RELIEF * relief_of_deepest_patch_mm(height, self.deblurring.point_spread_mm))
        return float(np.linalg.norm(errors_mm))

    def quantise(self, grey: Float32[Array, "rows cols"]) -> UInt16[Array, "rows cols"]:
        """Return the signed signal as an index into the curve's table, rounded and saturated at its ends."""
        steps = TABLE_STEPS[self.curve.signal]
        if self.curve.signal == "difference":
            return np.asarray(cv2.addWeighted(grey, steps, self.index_offset, 1, 0, dtype=cv2.CV_16U))
        return np.asarray(cv2.multiply(grey, self.per_reference, scale=steps, dtype=cv2.CV_16U))

    @cached_property
    def index_offset(self) -> Float32[Array, "rows cols"]:
        """The offset for the difference signal: index = grey · steps + offset."""
        return ZERO_INDEX - np.float32(TABLE_STEPS["difference"]) * self.reference.grey

    def height_source(self, index: UInt16[Array, "few_rows few_cols"]) -> UInt8[Array, "rows cols"]:
        """Return the `HeightSource` of every pixel; the height of a pixel darker than the calibrated range is extrapolated.

        index: on the grid on which heights are looked up.
        """
        if index.min() >= self.curve.darkest_index:
            return self.lens_source.copy()
        beyond = (self._on_image_grid(index) < self.curve.darkest_index).view(np.uint8)
        return np.minimum(self.lens_source, np.uint8(HeightSource.MEASURED) - beyond)

    @cached_property
    def all_in_view(self) -> bool:
        """Whether the camera sees every pixel of the grid."""
        return bool((self.lens_source != HeightSource.OUT_OF_VIEW).all())


@dataclass(frozen=True)
class CalibratedShape:
    """Rectification, depth curve and their errors for one sensor."""

    rectify: Rectification
    curve: DepthCurve
    noise_mm: float
    camera_distance_mm: float
    smoothing: Smoothing = Smoothing()
    loss: GlobalDimmingModel = GlobalDimmingModel()
    deblurring: Deblurring | None = None
    """The removal of the point spread of this sensor's light; None where the calibration does not determine it."""
    base_deflection: BaseDeflection | None = None
    """The deflection of the gel's base; None where the calibration does not determine the gel."""
    warnings: tuple[EstimateWarning, ...] = ()
    """Reasons to distrust everything that is measured with this calibration; every reading carries them."""
    range_mm: float | None = None
    """Depth to which the curve is calibrated; None where the curve gives depth itself."""
    calibration_checksum: str = ""
    """`SensorFolder.calibration_checksum`, which every reading carries; empty for a shape that is of no sensor folder."""

    @cached_property
    def light(self) -> LightCorrection:
        """Takes changes of the light since the reference image, and dirt, out of rectified images."""
        return LightCorrection(self.rectify)

    @property
    def depth_range_mm(self) -> float:
        """Depth to which the curve is calibrated. On a base that yields it is more than the thinning at the curve's end."""
        return self.curve.max_indentation_mm if self.range_mm is None else self.range_mm

    def depth_reader(self, *references: Frame, find_faults: FindReferenceFaults = lambda _: ()) -> DepthReader:
        """Return a depth reader for the reference image of this session, the mean of one or more frames, with its faults; raises
        `ReferenceUnusable`.
        """
        retain_freed_memory()
        mean = mean_rectified_image([self.rectify(frame) for frame in references])
        return self.reader_against(mean, tuple(find_faults(references)))

    def reader_against(self, reference: Rectified, faults: tuple[str, ...] = ()) -> DepthReader:
        """Return a depth reader for a reference image that is already rectified, and the faults of this image."""
        return DepthReader(
            self.curve,
            reference,
            self.rectify.height_source,
            self.smoothing if self.deblurring is None else FINE_SMOOTHING,
            self.noise_mm,
            self.camera_distance_mm,
            self.loss,
            self.deblurring,
            self.base_deflection,
            self.depth_range_mm / self.curve.max_indentation_mm if self.curve.max_indentation_mm > 0 else 1.0,
            faults,
        )


def mean_rectified_image(images: list[Rectified]) -> Rectified:
    """Return the mean brightness of several rectified images of the same skin; raises `ReferenceUnusable`."""
    if not images:
        raise ReferenceUnusable(
            expected="at least one reference image (no contact)", got="none", remedy="take one first"
        )
    total = np.zeros_like(images[0].grey)
    for image in images:
        cv2.accumulate(image.grey, total)
    total /= len(images)
    if total.mean() < MIN_LIT_GREY_LEVEL:
        raise ReferenceUnusable(
            expected="a lit reference image (no contact)",
            got=f"a mean grey level of {total.mean():.0f} of 255",
            remedy="switch the sensor's light on and raise the exposure",
        )
    levels = [float(image.grey.mean()) for image in images]
    if max(levels) - min(levels) > _MAX_UNSTEADINESS * max(levels):
        raise ReferenceUnusable(
            expected="reference images (no contact) of one brightness",
            got=f"mean grey levels from {min(levels):.0f} to {max(levels):.0f}",
            remedy="wait until light and exposure are steady",
        )
    return Rectified(total, images[0].mm_per_px, images[-1].stamp_ns)


def retain_freed_memory() -> None:
    """Make the allocator keep the memory that one frame's results free, so that the next frame's results reuse it.

    glibc sets the amount that it keeps by the largest block freed so far. Without this call, and depending on what else the program
    does, allocating fresh memory for every frame costs up to four times as much as computing the frame.
    """
    np.empty(_KEPT_BYTES, np.uint8)
