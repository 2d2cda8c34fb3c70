"""A ball pressed on the skin, as two rectified images and the contact circle in them, and what every fit of such a press gives.

`find_ball_press` checks two raw images and finds the contact circle. `BallFit` is the interface of the fits in `ball_fit`. A fit
knows the height of the skin on every line of sight of the press, and gives the depth curve of any region of the disc. All fits are
therefore tested in the same way: the curve of one half of the disc reads the other half.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.calibration.ball.contact_circle import (
    MAX_RADIUS_BY_PHYSICS,
    ContactCircle,
    find_contact_circle,
    require_disc_above_black,
    require_usable_depth,
)
from ninedtact.calibration.brightness_change import (
    relative_brightness,
    require_same_image_size,
    require_usable_exposure,
)
from ninedtact.design import BallGauge
from ninedtact.mechanics.base_deflection import BaseDeflection
from ninedtact.quantities import BgrImage, Frame, HeightSource, Rectified, skin_grid_mm
from ninedtact.shape.calibrated_shape import DepthReader
from ninedtact.shape.deblurring import Deblurring
from ninedtact.shape.depth import BrightnessSignal, DepthCurve, DepthMethod, GlobalDimmingModel, Smoothing
from ninedtact.shape.lens_and_rectification import Rectification, to_grey_float


@dataclass(frozen=True)
class RoundPress:
    """The reference image, the image of the press of a round object, and the contact circle found in them."""

    before: Rectified
    after: Rectified
    circle: ContactCircle

    @property
    def centre_mm(self) -> tuple[float, float]:
        """x and y of the centre of the contact on the skin."""
        rows, cols = self.before.grey.shape
        x, y = self.circle.centre_px
        return (x - (cols - 1) / 2) * self.before.mm_per_px, (y - (rows - 1) / 2) * self.before.mm_per_px

    @property
    def edge_radius_mm(self) -> float:
        """Radius of the contact circle."""
        return self.circle.radius_px * self.before.mm_per_px


@dataclass(frozen=True)
class BallPress(RoundPress):
    """The press of the calibration's ball."""

    ball: BallGauge

    def about(self, centre_px: Float[Array, "2"]) -> "BallPress":
        """Return the same press with the centre of the contact at another pixel."""
        return replace(self, circle=replace(self.circle, centre_px=(float(centre_px[0]), float(centre_px[1]))))

    def darkening(
        self, signal: BrightnessSignal, where: Bool[Array, "rows cols"], loss: float = 0.0
    ) -> Float32[Array, " n"]:
        """Return the darkening of the pixels of a region in the unit of a signal, after a loss of light of the whole image."""
        before, after = self.before.grey[where], self.after.grey[where] / np.float32(1 + loss)
        return before - after if signal == "difference" else 1 - after / np.maximum(before, 1)

    def rigid_ball_depth_mm(self, camera_distance_mm: float) -> Float[Array, "rows cols"]:
        """Return the depth at which every pixel's line of sight meets the ball, zero where it misses the disc.

        The camera stands `camera_distance_mm` below the centre of the skin. The line through a point of the undeformed plane is
        followed until it meets the sphere that cuts the plane in the contact circle. (Refraction on the way is included in the lens
        model and in the distance; docs/accuracy.md gives what remains.)
        """
        camera = np.array([0.0, 0.0, -camera_distance_mm])
        radius_mm = self.ball.radius_mm
        ball = np.array([*self.centre_mm, np.sqrt(radius_mm**2 - self.edge_radius_mm**2)])
        x, y = skin_grid_mm(self.before.grey.shape, self.before.mm_per_px)
        sight = np.stack([x, y, np.full_like(x, camera_distance_mm)], axis=-1).astype(float)
        ray_fraction = intersect_rays_with_sphere(camera - ball, sight, radius_mm)
        return np.maximum(camera_distance_mm * (1 - ray_fraction), 0)

    def halves(self) -> list[Bool[Array, "rows cols"]]:
        """Return the left, right, upper and lower half of the image about the centre of the contact."""
        rows, cols = np.indices(self.before.grey.shape)
        left, upper = cols < self.circle.centre_px[0], rows < self.circle.centre_px[1]
        return [np.asarray(half) for half in (left, ~left, upper, ~upper)]


def intersect_rays_with_sphere(
    start: Float[Array, "3"], sight: Float[Array, "rows cols 3"], radius: float
) -> Float[Array, "rows cols"]:
    """Return the smaller t at which start + t·sight lies on the sphere about zero; 1 (the plane) where there is no intersection."""
    square = (sight**2).sum(axis=-1)
    product = sight @ start
    discriminant = product**2 - square * (start @ start - radius**2)
    return np.where(discriminant > 0, (-product - np.sqrt(np.maximum(discriminant, 0))) / square, 1)


def find_ball_press(
    rectify: Rectification, reference: BgrImage, press: BgrImage, ball: BallGauge, method: DepthMethod
) -> BallPress:
    """Check and rectify two raw images (rows, cols, 3) of the skin, without contact and under the ball, and find the contact.

    Raises `BallPressUnusable`, `CalibrationError` and `FileFormatError`.
    """
    before, after = rectify_pair(rectify, reference, press, "ball")
    return BallPress(before, after, find_usable_contact_circle(before, after, ball, method), ball)


def rectify_pair(
    rectify: Rectification, reference: BgrImage, press: BgrImage, name: str
) -> tuple[Rectified, Rectified]:
    """Check and rectify two raw images of the skin, without contact and under an object of this name.

    Raises `CalibrationError` and `FileFormatError`.
    """
    require_same_image_size(f"{name} image", reference, press)
    require_usable_exposure(f"{name} reference", reference)
    require_usable_exposure(f"{name} image", press)
    return rectify(Frame(reference)), rectify(Frame(press))


def find_usable_contact_circle(
    before: Rectified, after: Rectified, ball: BallGauge, method: DepthMethod
) -> ContactCircle:
    """Return the contact circle of a ball that can calibrate depth by this method; raises `BallPressUnusable`."""
    circle = find_contact_circle(rectified_flat_fielded_change(before, after))
    require_usable_depth(ball, circle, before.mm_per_px, MAX_RADIUS_BY_PHYSICS if method == "physics" else 1.0)
    require_disc_above_black(after.grey, circle)
    return circle


def rectified_flat_fielded_change(before: Rectified, after: Rectified) -> Float32[Array, "rows cols"]:
    """Return the relative change of brightness of two rectified images, times the mean of the first, in grey levels."""
    return (relative_brightness(after, before) - 1) * before.grey.mean()


@dataclass(frozen=True)
class BallFit(ABC):
    """The fit of one press of a ball: the height of the skin in it, and the depth curve that follows."""

    press: BallPress
    """The press, with the centre of the contact as this fit found it."""
    smoothing: Smoothing
    """The filters of a reconstruction after the look-up."""

    @property
    @abstractmethod
    def method(self) -> DepthMethod:
        """The method of the fit."""

    @property
    @abstractmethod
    def height_mm(self) -> Float[Array, "rows cols"]:
        """Height of the skin on every pixel's line of sight; zero where the fit does not determine it."""

    @property
    def thickness_change_mm(self) -> Float[Array, "rows cols"]:
        """What the depth curve gives on every pixel's line of sight: the height where the fit knows nothing of the gel's base."""
        return self.height_mm

    @property
    def base_deflection(self) -> BaseDeflection | None:
        """The deflection of the gel's base, which is added to what the curve gives; None where the fit knows nothing of it."""
        return None

    @property
    @abstractmethod
    def disc(self) -> Bool[Array, "rows cols"]:
        """The pixels whose depth and darkening are paired."""

    @property
    @abstractmethod
    def max_indentation_mm(self) -> float:
        """Depth of the ball's lowest point."""

    @property
    @abstractmethod
    def loss(self) -> GlobalDimmingModel:
        """The loss of light of the whole image; none where the method does not determine it."""

    @property
    @abstractmethod
    def deblurring(self) -> Deblurring | None:
        """The removal of the point spread; None where the method does not determine it."""

    @abstractmethod
    def fit_curve(self, where: Bool[Array, "rows cols"]) -> DepthCurve:
        """Return the depth curve of a region of the disc."""

    @abstractmethod
    def with_errors(self, curve: DepthCurve) -> DepthCurve:
        """Return the curve of the whole disc with the standard deviation at every knot."""

    @cached_property
    def curve(self) -> DepthCurve:
        """The depth curve of the whole disc, with its errors."""
        return self.with_errors(self.fit_curve(self.disc))

    @cached_property
    def thinning_mm(self) -> Float[Array, "rows cols"]:
        """Thinning of the gel on every pixel's line of sight; where the fit knows nothing of its base, the indentation."""
        return np.maximum(-self.thickness_change_mm.astype(float), 0)

    @property
    def range_mm(self) -> float:
        """Depth to which the curve is calibrated."""
        return self.curve.max_indentation_mm

    @property
    def reconstruction_mae_mm(self) -> float:
        """Mean absolute error of the reconstructed height inside the disc."""
        return self.error_mm(self.curve, self.disc)

    @cached_property
    def cross_validation_mae_mm(self) -> float:
        """Mean absolute error of one half of the disc, reconstructed with the curve of the other half; the mean over four cuts."""
        halves = self.press.halves()
        return float(np.mean([self.error_mm(self.fit_curve(self.disc & half), self.disc & ~half) for half in halves]))

    def reader(self, before: Rectified, source: UInt8[Array, "rows cols"]) -> DepthReader:
        """Return the depth reader of the calibrated sensor for this reference image."""
        return replace(self.press_reader(self.curve, self.deblurring), reference=before, lens_source=source)

    def press_reader(self, curve: DepthCurve, deblurring: Deblurring | None) -> DepthReader:
        """Return the depth reader of this press with a curve and a deblurring that are being fitted."""
        everywhere = np.full(self.press.before.grey.shape, HeightSource.MEASURED, np.uint8)
        return DepthReader(
            curve,
            self.press.before,
            everywhere,
            self.smoothing,
            loss=self.loss,
            deblurring=deblurring,
            base_deflection=self.base_deflection,
        )

    def error_mm(self, curve: DepthCurve, where: Bool[Array, "rows cols"]) -> float:
        """Return the mean absolute error, in a region, of the heights that this curve gives, filters included."""
        return self.reading_error_mm(self.press_reader(curve, self.deblurring), where)

    def reading_error_mm(self, reader: DepthReader, where: Bool[Array, "rows cols"]) -> float:
        """Return the mean absolute error, in a region, of the heights that a reader of this press gives."""
        return float(np.abs(reader(self.press.after).z_mm - self.height_mm)[where].mean())


def simulate_height_noise_mm(
    reader: Callable[[Rectified], DepthReader], rectify: Rectification, reference: BgrImage, noise: float
) -> float:
    """Return the standard deviation of the height when camera noise is added to a uniform darkening half-way down the range.

    reader: builds a depth reader from a reference image. noise: standard deviation of one raw pixel, grey levels. The noise passes
    through lens and filters, so that the result is the noise of a reconstruction.
    """
    raw = to_grey_float(reference)
    curve = reader(Rectified(rectify.resample(raw), rectify.mm_per_px)).curve
    half_way = curve.darkening[-1] / 2
    pressed = raw - half_way if curve.signal == "difference" else raw * (1 - half_way)
    grainy = pressed + np.random.default_rng(0).normal(0, noise, raw.shape).astype(np.float32)
    before, after = (Rectified(rectify.resample(image), rectify.mm_per_px) for image in (raw, grainy))
    read = replace(reader(before), loss=GlobalDimmingModel())
    clean, noisy = (read(image) for image in (Rectified(rectify.resample(pressed), rectify.mm_per_px), after))
    return float(np.std((noisy.z_mm - clean.z_mm)[noisy.in_view]))
