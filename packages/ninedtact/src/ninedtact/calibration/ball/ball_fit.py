"""The depth curve from one press of a ball of known radius. In: the raw reference image and the raw image of the pressed ball.
Out: a `BallFit`, from `fit_ball`, by one of three methods.

`physics`, the default, fits contact mechanics and light together to the whole image and needs no rule about where the ball's
disc ends (`TwinBallFit`). Its curve is the sensor's brightness model (`simulation.gel_brightness`) for darkening and
brightening, so that it covers bulges too.

`ratio` and `table` use the contact disc only (`ContactDiscFit`). Inside it the skin lies on the ball, so the depth at which every
line of sight meets the skin is known; it is paired with the pixel's darkening. `table` is the paper's mapping list of grey
differences, with two corrections; `ratio` pairs depth with the brightness factor, which is uniform over the image.

The camera is near, so a line of sight meets deep skin farther inwards than shallow skin. Without this correction, as in the
paper, the error of `ratio` doubles on a real press (benchmarks/ball_accuracy.py). The rule that the disc's edge is at depth
zero is the paper's; real gel piles up at the rim, so that the rule gives depths some 0.1–0.2 mm too large (docs/accuracy.md).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import isotonic_regression, minimize, minimize_scalar

from ninedtact.calibration.ball.ball_press import BallFit, BallPress, find_ball_press
from ninedtact.calibration.ball.contact_circle import (
    require_explained_by_ball,
    spherical_cap_height_mm,
)
from ninedtact.calibration.ball.second_press import ObjectPress
from ninedtact.calibration.brightness_change import relative_brightness, smooth_gaussian
from ninedtact.calibration.twin.ball_press_fit import TwinFit, fit_twin_to_ball_press
from ninedtact.calibration.twin.gel_base import KnownBase
from ninedtact.calibration.twin.press_search import ParameterPrior
from ninedtact.design import SensorDesign
from ninedtact.mechanics.base_deflection import BaseDeflection
from ninedtact.quantities import BgrImage
from ninedtact.shape.deblurring import Deblurring
from ninedtact.shape.depth import (
    FINE_SMOOTHING,
    TABLE_STEPS,
    BrightnessSignal,
    CurveContinuation,
    DepthCurve,
    DepthMethod,
    GlobalDimmingModel,
    Smoothing,
)
from ninedtact.shape.lens_and_rectification import Rectification
from ninedtact.simulation.calibration_press_models import BallPressParameters
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.pixel_to_skin_map import SightlineGrid


def fit_ball(
    rectify: Rectification,
    reference: BgrImage,
    press: BgrImage,
    design: SensorDesign,
    method: DepthMethod = "physics",
    smoothing: Smoothing = Smoothing(),
    further: tuple[ObjectPress, ...] = (),
) -> BallFit:
    """Find the contact disc and fit the depth curve; raises `BallPressUnusable`, `CalibrationError`, `FileFormatError`.

    reference, press: raw images (rows, cols, 3) of the skin without contact and of the ball pressed on it. smoothing: the filters
    after the look-up, for the methods `ratio` and `table`; `physics` has its own. further: presses that are fitted together with
    this one, by `physics` alone.
    """
    found = find_ball_press(rectify, reference, press, design.ball, method)
    if method == "physics":
        return fit_ball_by_physics(found, design, further=further)
    signal: BrightnessSignal = "difference" if method == "table" else "ratio"
    return ContactDiscFit(_refine_centre(found, design), smoothing, signal, design)


def fit_ball_by_physics(
    press: BallPress,
    design: SensorDesign,
    priors: tuple[ParameterPrior, ...] = (),
    initial: tuple[BallPressParameters, ...] = (),
    further: tuple[ObjectPress, ...] = (),
    base: KnownBase | None = None,
) -> "TwinBallFit":
    """Fit contact mechanics and light to a press, with priors, initial parameters, further presses and base as for
    `fit_twin_to_ball_press`.

    Raises `BallPressUnusable` where a ball in gel does not explain the image.
    """
    twin_fit = fit_twin_to_ball_press(press, design, priors, initial, further, base)
    require_explained_by_ball(twin_fit.image_rmse_grey_levels, press.circle)
    for one, fit in zip(further, twin_fit.further, strict=True):
        one.object.require_explained(fit.residual_rms_grey_levels, one.circle)
    return TwinBallFit(press.about(twin_fit.centre_px), FINE_SMOOTHING, twin_fit)


_LEVEL: dict[BrightnessSignal, float] = {"difference": 1.0, "ratio": 1 / 160}
"""Width of one bin of darkening: one grey level, and its equivalent in the ratio for an image of usual brightness."""
_FIRST_LEVEL = 4
"""Bin below which the curve is a straight line from zero. The edge of the disc is blurred, so the first bins would turn a drift of
one grey level into a tenth of a millimetre.
"""
_CENTRING_SMOOTHING_PX = 1.0
_CENTRING_TERMS = 7


@dataclass(frozen=True)
class ContactDiscFit(BallFit):
    """The fit of the methods `ratio` and `table`: inside the contact circle the skin lies on a rigid ball."""

    signal: BrightnessSignal
    design: SensorDesign

    @property
    def method(self) -> DepthMethod:
        """The method of the fit."""
        return "table" if self.signal == "difference" else "ratio"

    @cached_property
    def height_mm(self) -> Float[Array, "rows cols"]:
        """Height of the ball's surface on every pixel's line of sight, zero outside the disc."""
        return -self.press.rigid_ball_depth_mm(self.design.camera.distance_mm)

    @cached_property
    def disc(self) -> Bool[Array, "rows cols"]:
        """The pixels at which the ball touches, by the rule that the edge of the disc is at depth zero."""
        circle = self.press.circle
        return circle.distance_px(self.press.before.grey.shape) < circle.radius_px

    @property
    def max_indentation_mm(self) -> float:
        """Depth of the ball's lowest point, by the same rule."""
        return spherical_cap_height_mm(self.design.ball.radius_mm, self.press.edge_radius_mm)

    @property
    def loss(self) -> GlobalDimmingModel:
        """None: the disc does not determine how much light the whole image loses."""
        return GlobalDimmingModel()

    @property
    def deblurring(self) -> None:
        """None: the disc does not determine the point spread."""

    def fit_curve(self, where: Bool[Array, "rows cols"]) -> DepthCurve:
        """Return the monotone curve through the pixels of a region."""
        return fit_monotone_depth_curve(self.signal, self.press.darkening(self.signal, where), self.thinning_mm[where])

    def with_errors(self, curve: DepthCurve) -> DepthCurve:
        """Return the curve with its errors: the scatter of the pixels, and cross-validation on the ball."""
        return replace(curve, error_mm=tuple(np.hypot(curve.error_mm, self.cross_validation_mae_mm).tolist()))


def _refine_centre(press: BallPress, design: SensorDesign) -> BallPress:
    """Return the press with its centre moved to where brightness is most nearly a function of depth alone.

    The edge determines the disc's size well but its centre only roughly, because the bulge around it is never quite even.
    """
    brightness = smooth_gaussian(relative_brightness(press.after, press.before), _CENTRING_SMOOTHING_PX)

    def scatter(centre_px: Float[Array, "2"]) -> float:
        depth_mm = press.about(centre_px).rigid_ball_depth_mm(design.camera.distance_mm)
        inside = depth_mm > 0
        powers = np.vander(depth_mm[inside], _CENTRING_TERMS)
        fitted = powers @ np.linalg.lstsq(powers, brightness[inside], rcond=None)[0]
        return float(np.std(brightness[inside] - fitted))

    best = minimize(scatter, press.circle.centre_px, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-7})
    return press.about(best.x)


def fit_monotone_depth_curve(
    signal: BrightnessSignal, darkening: Float[Array, " n"], depth_mm: Float[Array, " n"]
) -> DepthCurve:
    """Return the mean depth of every bin of darkening, made monotone by isotonic regression (weights: pixels per bin).

    Empty bins are interpolated; brightening pixels near the edge count as bin zero.
    """
    level = np.maximum(np.round(darkening / _LEVEL[signal]), 0).astype(int)
    count = np.bincount(level)
    known = np.flatnonzero(count)
    known = known[known >= min(_FIRST_LEVEL, known[-1])]
    mean = np.bincount(level, depth_mm)[known] / count[known]
    spread = np.sqrt(np.maximum(np.bincount(level, depth_mm**2)[known] / count[known] - mean**2, 0))
    rising = np.asarray(isotonic_regression(mean, weights=count[known]).x)
    return anchor_depth_curve_at_zero(signal, known * _LEVEL[signal], rising, spread)


def anchor_depth_curve_at_zero(
    signal: BrightnessSignal, darkening: Float[Array, " k"], depth_mm: Float[Array, " k"], error_mm: Float[Array, " k"]
) -> DepthCurve:
    """Return the depth curve with a first knot of zero depth at zero darkening."""
    above = darkening > 0
    return DepthCurve(
        signal,
        (0.0, *darkening[above].tolist()),
        (0.0, *depth_mm[above].tolist()),
        (float(error_mm[0]), *error_mm[above].tolist()),
    )


_KNOT_COUNT = 25
_MIN_PIXELS_PER_KNOT = 30
"""Smallest number of pixels at a depth for which the brightness model is corrected there."""
_MIN_DISC_THINNING_MM = 0.05
"""Thinning below which a pixel is left out of the disc: the ball's edge is near, and light is scattered from it. On a base that
yields, skin around the ball lies low over gel that is no thinner."""
_CONTINUATION_KNOT_COUNT = 8
"""Number of knots of the curve beyond the depth of the press."""
_MAX_DEPTH_PER_THICKNESS = 0.9
"""Fraction of the gel's thickness to which the curve continues beyond the depth of the press."""
_MIN_CONTINUATION_MM = 0.05
"""Length of the shortest continuation."""
_CONTINUATION_ERROR_PER_MM = 0.2
"""Error of the curve beyond the depth of the press, in mm per mm."""
_MAX_BULGE_MM = 1.0
"""Largest height that the curve of bulges covers."""
_STIFFENING_BOUNDS = 0.0, 4.0
"""Range of the factor on the stiffening of the base (`BaseDeflection.stiffening`)."""
_FLOORS = (0.01, 0.03, 0.1)
"""The floors of the deblurring that are tried, from sharp to smooth."""
_SHARPNESS_COST_MM, _SHARPNESS_COST = 0.003, 0.2
"""Error of the ball's reconstruction that a sharper one may add, and the share that it may add where this is more. A ball is smooth
and gains nothing from sharpness; edges do."""


def depth_curve_of_brightness_model(light: BrightnessModel, deepest_mm: float) -> DepthCurve:
    """Return a brightness model as a depth curve down to this thinning of the gel, without errors."""
    depth_mm = np.linspace(0, deepest_mm, _KNOT_COUNT)
    darkening = np.abs(light.brightness_change(-depth_mm))
    brightening = light.brightening_per_mm * _MAX_BULGE_MM
    bulges = ((0.0, brightening), (0.0, _MAX_BULGE_MM)) if brightening > 0 else ((0.0,), (0.0,))
    return DepthCurve("ratio", tuple(darkening.tolist()), tuple(depth_mm.tolist()), (0.0,) * _KNOT_COUNT, *bulges)


@dataclass(frozen=True)
class TwinBallFit(BallFit):
    """The fit of the method `physics`: the depth curve follows from the brightness model of the twin that explains the image."""

    twin_fit: TwinFit

    @property
    def method(self) -> DepthMethod:
        """The method of the fit."""
        return "physics"

    @cached_property
    def height_mm(self) -> Float32[Array, "rows cols"]:
        """Height of the fitted skin on every pixel's line of sight, bulges included."""
        return self._on_sightlines(np.asarray(self.twin_fit.contact.height_mm, np.float32))

    @cached_property
    def thickness_change_mm(self) -> Float32[Array, "rows cols"]:
        """Change of the fitted gel's thickness on every pixel's line of sight."""
        return self._on_sightlines(np.asarray(self.twin_fit.contact.thickness_change_mm, np.float32))

    def _on_sightlines(self, field: Float32[Array, "skin_rows skin_cols"]) -> Float32[Array, "rows cols"]:
        """Return a field of the fitted skin on every pixel's line of sight."""
        x, y = self.twin_fit.problem.observed.positions_mm
        height_mm = np.asarray(self.twin_fit.contact.height_mm, np.float32)
        sightlines = SightlineGrid(x, y, self.twin_fit.light.inverse_distance_per_mm)
        patch = self.twin_fit.contact.skin.grid
        return sightlines.sample(patch, self.twin_fit.press.centre_mm, height_mm, field)

    @cached_property
    def base_deflection(self) -> BaseDeflection:
        """The deflection of the base of the fitted gel, with the stiffening that gives the depth of this ball best."""
        thinner, height_mm = self.disc, self.height_mm
        usual = BaseDeflection(self.twin_fit.gel)

        def error_mm(stiffening: float) -> float:
            deflection_mm = replace(usual, stiffening=stiffening)(self.thickness_change_mm, self.press.before.mm_per_px)
            return float(np.abs(self.thickness_change_mm + deflection_mm - height_mm)[thinner].mean())

        if usual.gel.has_rigid_base or not thinner.any():
            return usual
        best = minimize_scalar(error_mm, bounds=_STIFFENING_BOUNDS, method="bounded", options={"xatol": 0.02})
        return replace(usual, stiffening=float(best.x))

    @cached_property
    def disc(self) -> Bool[Array, "rows cols"]:
        """The pixels of thinner gel that are at least a point spread away from the edge, where brightness does not determine a
        single depth.
        """
        pressed = (self.thickness_change_mm < -_MIN_DISC_THINNING_MM).astype(np.uint8)
        reach = int(np.ceil(self.twin_fit.light.point_spread_mm / self.press.before.mm_per_px))
        ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
        return np.asarray(cv2.erode(pressed, ellipse) > 0)

    @property
    def max_indentation_mm(self) -> float:
        """Depth of the ball's lowest point."""
        return self.twin_fit.press.depth_mm

    @property
    def loss(self) -> GlobalDimmingModel:
        """The loss of light of the whole image."""
        return GlobalDimmingModel(self.twin_fit.light.global_dimming)

    @cached_property
    def deblurring(self) -> Deblurring:
        """The removal of the point spread: the sharpest that reconstructs this ball nearly as well as any."""
        blur_mm = self.twin_fit.problem.observed.blur_mm
        sigma_mm = np.sqrt(max(self.twin_fit.light.point_spread_mm**2 - blur_mm**2, 0))
        candidates = [Deblurring(float(sigma_mm), floor) for floor in _FLOORS]
        errors_mm = [
            self.reading_error_mm(self.press_reader(self._model_curve, each), self.disc) for each in candidates
        ]
        least_mm = min(errors_mm)
        return next(
            each
            for each, error_mm in zip(candidates, errors_mm, strict=True)
            if error_mm <= least_mm + max(_SHARPNESS_COST_MM, _SHARPNESS_COST * least_mm)
        )

    @cached_property
    def _model_curve(self) -> DepthCurve:
        """The brightness model as a depth curve, without errors and without continuation."""
        return depth_curve_of_brightness_model(self.twin_fit.light, self._calibrated_thinning_mm)

    @property
    def _calibrated_thinning_mm(self) -> float:
        """Thinning of the gel at which the calibrated curve ends."""
        return float(min(-self.twin_fit.contact.thickness_change_mm.min(), 0.95 * self.twin_fit.light.thickness_mm))

    @property
    def _depth_per_thinning(self) -> float:
        """Depth of the press over the thinning of the gel; a base that yields adds its deflection."""
        return self.max_indentation_mm / self._calibrated_thinning_mm

    @property
    def range_mm(self) -> float:
        """Depth to which the curve is calibrated, that of the press."""
        return self.curve.max_indentation_mm * self._depth_per_thinning

    @cached_property
    def _restored_darkening(self) -> Float32[Array, "rows cols"]:
        """Darkening of the ball image after the corrections of a reconstruction: lost and scattered light are restored."""
        index = self.press_reader(self._model_curve, self.deblurring).index(self.press.after.grey)
        return FINE_SMOOTHING(1 - index.astype(np.float32) / np.float32(TABLE_STEPS["ratio"]))

    def fit_curve(self, where: Bool[Array, "rows cols"]) -> DepthCurve:
        """Return the brightness model as a depth curve, corrected by the measured darkening in this region of the ball, because the
        form of the model is an idealisation.
        """
        knot_thinning_mm = np.array(self._model_curve.indentation_mm)
        knot_darkening = np.array(self._model_curve.darkening)
        thinning_mm = self.thinning_mm[where]
        residual = self._restored_darkening[where] - np.interp(thinning_mm, knot_thinning_mm, knot_darkening)
        knot = np.rint(thinning_mm / knot_thinning_mm[1]).astype(int)
        count = np.bincount(knot, minlength=_KNOT_COUNT)[:_KNOT_COUNT]
        mean = np.bincount(knot, residual, minlength=_KNOT_COUNT)[:_KNOT_COUNT] / np.maximum(count, 1)
        known = 1 + np.flatnonzero(count[1:] > _MIN_PIXELS_PER_KNOT)  # untouched gel does not darken
        correction = np.interp(np.arange(_KNOT_COUNT), np.append(0, known), np.append(0.0, mean[known]))
        corrected = knot_darkening + gaussian_filter1d(correction, 1.0)
        rising = np.maximum.accumulate(corrected) + 1e-6 * np.arange(_KNOT_COUNT)
        darkening = rising - rising[0]
        continuation = self._continue_model_curve(float(darkening[-1]))
        return replace(self._model_curve, darkening=tuple(darkening.tolist()), beyond=continuation)

    def _continue_model_curve(self, max_darkening: float) -> CurveContinuation:
        """Return the curve beyond the depth of the press, where the brightness model continues from this darkening; nothing for a
        press that left little of the gel."""
        light = self.twin_fit.light
        start_mm = self._calibrated_thinning_mm
        end_mm = _MAX_DEPTH_PER_THICKNESS * min(self.twin_fit.press.thickness_mm, light.thickness_mm)
        if end_mm < start_mm + _MIN_CONTINUATION_MM:
            return CurveContinuation()
        depth_mm = np.linspace(start_mm, end_mm, _CONTINUATION_KNOT_COUNT + 1)
        darkening = np.abs(light.brightness_change(-depth_mm))
        return CurveContinuation(
            tuple((max_darkening + (darkening - darkening[0])[1:]).tolist()),
            tuple(depth_mm[1:].tolist()),
            (0.0,) * _CONTINUATION_KNOT_COUNT,
        )

    def with_errors(self, curve: DepthCurve) -> DepthCurve:
        """Return the curve with its errors: cross-validation on the ball, and the uncertainty of the depth of the press."""
        reconstruction_error_mm = np.hypot(self.error_mm(curve, self.disc), self.cross_validation_mae_mm)
        depth_mm = self._depth_per_thinning * np.array(curve.indentation_mm)
        depth_error_mm = self.twin_fit.relative_depth_std * depth_mm
        error_mm = np.hypot(reconstruction_error_mm, depth_error_mm)
        extrapolated_mm = np.array(curve.beyond.indentation_mm) - curve.max_indentation_mm
        continuation_error_mm = error_mm[-1] + _CONTINUATION_ERROR_PER_MM * extrapolated_mm
        continuation = replace(curve.beyond, error_mm=tuple(continuation_error_mm.tolist()))
        return replace(curve, error_mm=tuple(error_mm.tolist()), beyond=continuation)
