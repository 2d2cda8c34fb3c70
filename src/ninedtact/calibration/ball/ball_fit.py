"""The depth curve from one press of a ball of known radius. In: the raw reference image and the raw image of the pressed ball.
Out: `BallFit`, from `fit_ball`, by one of three methods.

`physics`, the default, fits contact mechanics and light together to the whole image and needs no rule about where the ball's
disc ends (`TwinDepthFit`). Its curve is the sensor's brightness model (`simulation.gel_brightness`) for darkening and
brightening, so that it covers bulges too.

`ratio` and `table` use the contact disc only. Inside it the skin lies on the ball, so the depth at which every line of sight
meets the skin is known; it is paired with the pixel's darkening. `table` is the paper's mapping list of grey differences, with
two corrections; `ratio` pairs depth with the brightness factor, which is uniform over the image.

The camera is near, so a line of sight meets deep skin farther inwards than shallow skin. Without this correction, as in the
paper, the error of `ratio` doubles on a real press (benchmarks/ball_accuracy.py). The rule that the disc's edge is at depth
zero is the paper's; real gel piles up at the rim, so that the rule gives depths some 0.1–0.2 mm too large (docs/accuracy.md).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array
from scipy.ndimage import gaussian_filter1d

from ninedtact.calibration.ball.ball_press import BallPressImages, refine_ball_centre
from ninedtact.calibration.ball.contact_circle import (
    WIDEST_BY_PHYSICS,
    ContactCircle,
    asymmetry_warnings,
    find_contact_circle,
    require_disc_above_black,
    require_explained_by_ball,
    require_usable_depth,
    spherical_cap_height_mm,
)
from ninedtact.calibration.press_brightness import (
    BgrImage,
    estimate_camera_noise,
    flat_fielded_brightness_change,
    require_same_image_size,
    require_usable_exposure,
    to_grey_float,
)
from ninedtact.calibration.twin.ball_press_fit import ParameterPrior, TwinFit, fit_twin_to_ball_press
from ninedtact.calibration.twin.ball_press_model import PATCH, ParameterVector
from ninedtact.design import BallGauge, SensorDesign
from ninedtact.quantities import Frame, HeightSource, Rectified
from ninedtact.shape.depth import (
    FINE_SMOOTHING,
    TABLE_STEPS,
    BrightnessSignal,
    CurveContinuation,
    Deblurring,
    DepthCurve,
    DepthMethod,
    DepthReader,
    GlobalDimmingModel,
    Smoothing,
)
from ninedtact.shape.rectification import Rectification
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.pixel_to_skin_map import SightlineGrid

KNOT_COUNT = 25
MIN_PIXELS_PER_KNOT = 30
"""Smallest number of pixels at a depth for which the brightness model is corrected there."""
MIN_DISC_INDENTATION_MM = 0.05
"""Indentation below which a pixel is left out of the disc: the ball's edge is near, and light is scattered from it."""
CONTINUATION_KNOT_COUNT = 8
"""Number of knots of the curve beyond the depth of the press."""
MAX_DEPTH_PER_THICKNESS = 0.9
"""Fraction of the gel's thickness to which the curve continues beyond the depth of the press."""
MIN_CONTINUATION_MM = 0.05
"""Length of the shortest continuation."""
CONTINUATION_ERROR_PER_MM = 0.2
"""Error of the curve beyond the depth of the press, in mm per mm."""
MAX_BULGE_MM = 1.0
"""Largest height that the curve of bulges covers."""
NOISE_FLOORS = (0.01, 0.03, 0.1)
"""The noise floors of the deblurring that are tried, from sharp to smooth; the one that reconstructs the ball best is taken."""


@dataclass(frozen=True)
class TwinDepthFit:
    """A fitted ball press, and the depth curve that follows from its brightness model."""

    fit: TwinFit

    @cached_property
    def sightline_height_mm(self) -> Float32[Array, "rows cols"]:
        """Height of the fitted skin on every pixel's line of sight."""
        x, y = self.fit.forward.observed.positions_mm
        height_mm = np.asarray(self.fit.contact.height_mm, np.float32)
        centre_mm = self.fit.parameters["x_mm"], self.fit.parameters["y_mm"]
        sightlines = SightlineGrid(x, y, self.fit.light.inverse_distance_per_mm)
        return sightlines.height_mm(PATCH, centre_mm, height_mm, fine=True)

    @property
    def centre_px(self) -> Float[Array, "2"]:
        """The fitted centre of the contact, (x, y) in the rectified image."""
        rows, cols = self.sightline_height_mm.shape
        centre_mm = np.array([self.fit.parameters["x_mm"], self.fit.parameters["y_mm"]])
        middle_px = np.array([(cols - 1) / 2, (rows - 1) / 2])
        return np.asarray(centre_mm / self.fit.forward.observed.before.mm_per_px + middle_px)

    @property
    def depth_mm(self) -> Float[Array, "rows cols"]:
        """Indentation on every pixel's line of sight."""
        return np.maximum(-self.sightline_height_mm.astype(float), 0)

    @cached_property
    def disc(self) -> Bool[Array, "rows cols"]:
        """The indented pixels that are at least a point spread away from the edge, where brightness does not determine a single
        depth.
        """
        pressed = (self.sightline_height_mm < -MIN_DISC_INDENTATION_MM).astype(np.uint8)
        reach = int(np.ceil(self.fit.light.point_spread_mm / self.fit.forward.observed.before.mm_per_px))
        ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        return np.asarray(cv2.erode(pressed, ellipse) > 0)

    @cached_property
    def deblurring(self) -> Deblurring:
        """The removal of the point spread, with the noise floor that reconstructs this ball best."""
        sigma_mm = np.sqrt(max(self.fit.light.point_spread_mm**2 - self.fit.forward.observed.blur_mm**2, 0))
        candidates = [Deblurring(float(sigma_mm), floor) for floor in NOISE_FLOORS]
        curve = self.model_curve(self.fit.light)
        return min(candidates, key=lambda candidate: self.error_with_deblurring_mm(curve, self.disc, candidate))

    def curve(self, where: Bool[Array, "rows cols"]) -> DepthCurve:
        """Return the brightness model as a depth curve, corrected by the measured darkening in this region of the ball, because the
        form of the model is an idealisation.
        """
        curve = self.model_curve(self.fit.light)
        knot_depth_mm = np.array(curve.indentation_mm)
        knot_darkening = np.array(curve.darkening)
        depth_mm = self.depth_mm[where]
        residual = self.darkening[where] - np.interp(depth_mm, knot_depth_mm, knot_darkening)
        knot = np.rint(depth_mm / knot_depth_mm[1]).astype(int)
        count = np.bincount(knot, minlength=KNOT_COUNT)[:KNOT_COUNT]
        mean = np.bincount(knot, residual, minlength=KNOT_COUNT)[:KNOT_COUNT] / np.maximum(count, 1)
        known = np.flatnonzero(count > MIN_PIXELS_PER_KNOT)
        correction = np.interp(np.arange(KNOT_COUNT), np.append(0, known), np.append(0.0, mean[known]))
        corrected = knot_darkening + gaussian_filter1d(correction, 1.0)
        rising = np.maximum.accumulate(corrected) + 1e-6 * np.arange(KNOT_COUNT)
        darkening = rising - rising[0]
        continuation = self._continue_model_curve(float(darkening[-1]))
        return replace(curve, darkening=tuple(darkening.tolist()), beyond=continuation)

    def _continue_model_curve(self, max_darkening: float) -> CurveContinuation:
        """Return the curve beyond the depth of the press, where the brightness model continues from this darkening; nothing for a
        press that left little of the gel."""
        light = self.fit.light
        start_mm = self._max_depth_mm
        end_mm = MAX_DEPTH_PER_THICKNESS * min(self.fit.parameters["thickness_mm"], light.thickness_mm)
        if end_mm < start_mm + MIN_CONTINUATION_MM:
            return CurveContinuation()
        depth_mm = np.linspace(start_mm, end_mm, CONTINUATION_KNOT_COUNT + 1)
        darkening = np.abs(light.brightness_change(-depth_mm))
        return CurveContinuation(
            tuple((max_darkening + (darkening - darkening[0])[1:]).tolist()),
            tuple(depth_mm[1:].tolist()),
            (0.0,) * CONTINUATION_KNOT_COUNT,
        )

    @property
    def _max_depth_mm(self) -> float:
        """Depth at which the calibrated curve ends."""
        return float(min(self.fit.parameters["depth_mm"], 0.95 * self.fit.light.thickness_mm))

    @cached_property
    def darkening(self) -> Float32[Array, "rows cols"]:
        """Darkening of the ball image after the corrections of a reconstruction: lost and scattered light are restored."""
        reader = self.reader(self.model_curve(self.fit.light), self.deblurring)
        index = reader.index(self.fit.forward.observed.after.grey)
        return FINE_SMOOTHING(1 - index.astype(np.float32) / np.float32(TABLE_STEPS["ratio"]))

    def model_curve(self, light: BrightnessModel) -> DepthCurve:
        """Return a brightness model as a depth curve, without errors and without continuation."""
        depth_mm = np.linspace(0, self._max_depth_mm, KNOT_COUNT)
        darkening = np.abs(light.brightness_change(-depth_mm))
        brightening = light.brightening_per_mm * MAX_BULGE_MM
        bulges = ((0.0, brightening), (0.0, MAX_BULGE_MM)) if brightening > 0 else ((0.0,), (0.0,))
        return DepthCurve("ratio", tuple(darkening.tolist()), tuple(depth_mm.tolist()), (0.0,) * KNOT_COUNT, *bulges)

    def with_errors(self, curve: DepthCurve, cross_validation_mae_mm: float) -> DepthCurve:
        """Return the curve with its errors: cross-validation on the ball, and the uncertainty of the depth of the press."""
        reconstruction_error_mm = np.hypot(self.error_mm(curve, self.disc), cross_validation_mae_mm)
        relative_depth_std = self.fit.uncertainty.standard_deviations["depth_mm"] / self.fit.parameters["depth_mm"]
        error_mm = np.hypot(reconstruction_error_mm, relative_depth_std * np.array(curve.indentation_mm))
        extrapolated_mm = np.array(curve.beyond.indentation_mm) - curve.max_indentation_mm
        continuation_error_mm = error_mm[-1] + CONTINUATION_ERROR_PER_MM * extrapolated_mm
        continuation = replace(curve.beyond, error_mm=tuple(continuation_error_mm.tolist()))
        return replace(curve, error_mm=tuple(error_mm.tolist()), beyond=continuation)

    def error_mm(self, curve: DepthCurve, where: Bool[Array, "rows cols"]) -> float:
        """Return the mean absolute error of the reconstructed height in a region, against the fitted skin."""
        return self.error_with_deblurring_mm(curve, where, self.deblurring)

    def error_with_deblurring_mm(
        self, curve: DepthCurve, where: Bool[Array, "rows cols"], deblurring: Deblurring
    ) -> float:
        """Return the mean absolute error of the reconstructed height in a region with this deblurring."""
        height_mm = self.reader(curve, deblurring)(self.fit.forward.observed.after).z_mm
        return float(np.abs(height_mm - self.sightline_height_mm)[where].mean())

    def reader(self, curve: DepthCurve, deblurring: Deblurring) -> DepthReader:
        """Return the depth reader of the calibrated sensor."""
        everywhere = np.full(self.sightline_height_mm.shape, HeightSource.MEASURED, np.uint8)
        reference = self.fit.forward.observed.before
        loss = GlobalDimmingModel(self.fit.light.global_dimming)
        return DepthReader(curve, reference, everywhere, FINE_SMOOTHING, loss=loss, deblurring=deblurring)

    def cross_validation_mae_mm(self) -> float:
        """Return the error of one half of the disc with the curve of the other half, mean over four cuts."""
        x, y = self.fit.forward.observed.positions_mm
        left, upper = x < self.fit.parameters["x_mm"], y < self.fit.parameters["y_mm"]
        halves = [np.asarray(half) for half in (left, ~left, upper, ~upper)]
        return float(np.mean([self.error_mm(self.curve(self.disc & half), self.disc & ~half) for half in halves]))


SIGNAL: dict[DepthMethod, BrightnessSignal] = {"table": "difference", "ratio": "ratio"}


@dataclass(frozen=True)
class BallFit:
    """The depth curve, with the press, the errors and the warnings of its fit."""

    method: DepthMethod
    curve: DepthCurve
    press: BallPressImages
    reconstruction_mae_mm: float
    """Mean absolute error of the reconstructed height inside the disc."""
    cross_validation_mae_mm: float
    """Mean absolute error of one half of the disc, reconstructed with the curve of the other half; the mean over four cuts."""
    warnings: tuple[str, ...]
    noise_mm: float = 0.0
    """Standard deviation of one pixel's height from image to image, filters included."""
    physical: TwinDepthFit | None = None
    """The fit of mechanics and light; None for the methods `ratio` and `table`."""

    @property
    def max_indentation_mm(self) -> float:
        """Depth of the ball's lowest point."""
        if self.physical is not None:
            return self.physical.fit.parameters["depth_mm"]
        return spherical_cap_height_mm(self.press.ball.radius_mm, self.press.edge_radius_mm)

    @property
    def true_mm(self) -> Float[Array, "rows cols"]:
        """Reference indentation on every pixel's line of sight, as determined by this method."""
        return self.press.depth_mm if self.physical is None else self.physical.depth_mm

    @property
    def disc(self) -> Bool[Array, "rows cols"]:
        """The pixels at which the ball indents the skin."""
        return self.press.disc if self.physical is None else self.physical.disc

    @property
    def loss(self) -> GlobalDimmingModel:
        """The loss of light of the whole image; none where the method does not determine it."""
        return GlobalDimmingModel(0.0 if self.physical is None else self.physical.fit.light.global_dimming)

    @property
    def deblurring(self) -> Deblurring | None:
        """The removal of the point spread; None where the method does not determine it."""
        return None if self.physical is None else self.physical.deblurring

    def reader(self, before: Rectified, source: UInt8[Array, "rows cols"]) -> DepthReader:
        """Return the depth reader of the calibrated sensor for this reference image."""
        smoothing = self.press.smoothing if self.deblurring is None else FINE_SMOOTHING
        return DepthReader(self.curve, before, source, smoothing, loss=self.loss, deblurring=self.deblurring)


def fit_ball(
    rectify: Rectification,
    reference: BgrImage,
    press: BgrImage,
    design: SensorDesign,
    method: DepthMethod = "physics",
    smoothing: Smoothing = Smoothing(),
    priors: tuple[ParameterPrior, ...] = (),
    initial: ParameterVector | None = None,
) -> BallFit:
    """Find the contact disc and fit the depth curve; raises `BallPressUnusable`, `ImageUnusable`, `WrongImageSize`.

    reference, press: raw images (rows, cols, 3) of the skin without contact and of the ball pressed on it. priors, initial: as for
    `fit_twin_to_ball_press`, for the method `physics` alone.
    """
    require_same_image_size("ball image", reference, press)
    require_usable_exposure("ball reference", reference)
    require_usable_exposure("ball image", press)
    before, after = rectify(Frame(reference)), rectify(Frame(press))
    circle = find_usable_contact_circle(before, after, design.ball, method)
    images = BallPressImages(before, after, circle, design.ball, design.camera, smoothing)
    if method == "physics":
        fit = _fit_by_physics(images, design, priors, initial)
    else:
        fit = _fit_by_contact_disc(refine_ball_centre(images), method)
    # A height against an averaged reference contains the noise of one image.
    noise = estimate_camera_noise(flat_fielded_brightness_change(reference, press))
    reader = partial(fit.reader, source=rectify.height_source)
    return replace(fit, noise_mm=simulate_height_noise_mm(reader, rectify, reference, noise))


def find_usable_contact_circle(
    before: Rectified, after: Rectified, ball: BallGauge, method: DepthMethod
) -> ContactCircle:
    """Return the contact circle of a ball that can calibrate depth by this method; raises `BallPressUnusable`."""
    circle = find_contact_circle(rectified_flat_fielded_change(before, after))
    require_usable_depth(ball, circle, before.mm_per_px, WIDEST_BY_PHYSICS if method == "physics" else 1.0)
    require_disc_above_black(after.grey, circle)
    return circle


def _fit_by_physics(
    press: BallPressImages,
    design: SensorDesign,
    priors: tuple[ParameterPrior, ...],
    initial: ParameterVector | None,
) -> BallFit:
    """Fit mechanics and light together, and measure how well the result reconstructs the ball."""
    physical = TwinDepthFit(fit_twin_to_ball_press(press.before, press.after, press.circle, design, priors, initial))
    require_explained_by_ball(physical.fit.image_rmse_grey_levels, press.circle)
    curve = physical.curve(physical.disc)
    cross_validation_mae_mm = physical.cross_validation_mae_mm()
    return BallFit(
        method="physics",
        curve=physical.with_errors(curve, cross_validation_mae_mm),
        press=press.about(physical.centre_px),
        reconstruction_mae_mm=physical.error_mm(curve, physical.disc),
        cross_validation_mae_mm=cross_validation_mae_mm,
        warnings=asymmetry_warnings(press.circle),
        physical=physical,
    )


def _fit_by_contact_disc(press: BallPressImages, method: DepthMethod) -> BallFit:
    """Pair depth with darkening, and measure how well the result reconstructs the ball."""
    signal = SIGNAL[method]
    curve = press.curve(signal, press.disc)
    half_errors = [
        press.error_mm(press.curve(signal, press.disc & half), press.disc & ~half) for half in press.halves()
    ]
    cross_validation_mae_mm = float(np.mean(half_errors))
    return BallFit(
        method=method,
        curve=replace(curve, error_mm=tuple(np.hypot(curve.error_mm, cross_validation_mae_mm).tolist())),
        press=press,
        reconstruction_mae_mm=press.error_mm(curve, press.disc),
        cross_validation_mae_mm=cross_validation_mae_mm,
        warnings=asymmetry_warnings(press.circle),
    )


def rectified_flat_fielded_change(before: Rectified, after: Rectified) -> Float32[Array, "rows cols"]:
    """Return the relative change of brightness of two rectified images, times the mean of the first, in grey levels."""
    return (after.grey / np.maximum(before.grey, 1) - 1) * before.grey.mean()


def simulate_height_noise_mm(
    reader: Callable[[Rectified], DepthReader], rectify: Rectification, reference: BgrImage, noise: float, seed: int = 0
) -> float:
    """Return the standard deviation of the height when camera noise is added to a uniform darkening half-way down the range.

    reader: builds a depth reader from a reference image. noise: standard deviation of one raw pixel, grey levels. The noise passes
    through lens and filters, so that the result is the noise of a reconstruction.
    """
    raw = to_grey_float(reference)
    curve = reader(Rectified(rectify.resample(raw), rectify.mm_per_px)).curve
    half_way = curve.darkening[-1] / 2
    pressed = raw - half_way if curve.signal == "difference" else raw * (1 - half_way)
    noisy = pressed + np.random.default_rng(seed).normal(0, noise, raw.shape).astype(np.float32)
    before, after = (Rectified(rectify.resample(image), rectify.mm_per_px) for image in (raw, noisy))
    height = replace(reader(before), loss=GlobalDimmingModel())(after)
    return float(np.std(height.z_mm[height.in_view]))
