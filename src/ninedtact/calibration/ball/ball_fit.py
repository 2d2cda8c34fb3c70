"""The depth curve from one press of a ball of known radius. In: the raw reference image and the raw image of the pressed ball. Out:
`BallFit`, from `fit_ball`, by one of three methods.

`physics`, the default, fits contact mechanics and light to the whole image (ball/physics_method.py). `ratio` and `table` use the
contact disc only. Inside it the skin lies on the ball, so the depth at which every line of sight meets the skin is known; it is
paired with the pixel's darkening. `table` is the paper's mapping list of grey differences, with two corrections; `ratio` pairs
depth with the brightness factor, which is uniform over the image.

The camera is near, so a line of sight meets deep skin farther inwards than shallow skin. Without this correction, as in the paper,
the error of `ratio` doubles on a real press (benchmarks/ball_accuracy.py). The rule that the disc's edge is at depth zero is the
paper's; real gel piles up at the rim, so that the rule gives depths some 0.1–0.2 mm too large (docs/accuracy.md).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.calibration.ball.ball_press import BallPress, refine_ball_centre
from ninedtact.calibration.ball.contact_circle import (
    WIDEST_BY_PHYSICS,
    asymmetry_warnings,
    find_contact_circle,
    require_disc_above_black,
    require_explained_by_ball,
    require_usable_depth,
    spherical_cap_height_mm,
)
from ninedtact.calibration.ball.physics_method import PhysicsDepthFit
from ninedtact.calibration.brightness import (
    BgrImage,
    estimate_pixel_noise,
    relative_brightness_change,
    require_same_image_size,
    require_usable_exposure,
    to_grey_float,
)
from ninedtact.calibration.twin.ball_press_fit import ParameterPrior, fit_twin
from ninedtact.calibration.twin.ball_press_model import ParameterVector
from ninedtact.design import SensorDesign
from ninedtact.quantities import Frame, Rectified
from ninedtact.shape.depth import (
    FINE_SMOOTHING,
    BrightnessSignal,
    Deblurring,
    DepthCurve,
    DepthMethod,
    DepthReader,
    LightLoss,
    Smoothing,
)
from ninedtact.shape.rectification import Rectification

SIGNAL: dict[DepthMethod, BrightnessSignal] = {"table": "difference", "ratio": "ratio"}


@dataclass(frozen=True)
class BallFit:
    """The depth curve, with the press, the errors and the warnings of its fit."""

    method: DepthMethod
    curve: DepthCurve
    press: BallPress
    reconstruction_mae_mm: float
    """Mean absolute error of the reconstructed height inside the disc."""
    cross_validation_mae_mm: float
    """Mean absolute error of one half of the disc, reconstructed with the curve of the other half; the mean over four cuts."""
    warnings: tuple[str, ...]
    noise_mm: float = 0.0
    """Standard deviation of one pixel's height from image to image, filters included."""
    physical: PhysicsDepthFit | None = None
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
    def loss(self) -> LightLoss:
        """The loss of light of the whole image; none where the method does not determine it."""
        return LightLoss() if self.physical is None else LightLoss(self.physical.fit.light.global_dimming)

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
    beliefs: tuple[ParameterPrior, ...] = (),
    near: ParameterVector | None = None,
) -> BallFit:
    """Find the contact disc and fit the depth curve; raises `BallPressUnusable`, `ImageUnusable`, `WrongImageSize`.

    reference, press: raw images (rows, cols, 3) of the skin without contact and of the ball pressed on it. beliefs, near: as for
    `fit_twin`.
    """
    require_same_image_size("ball image", reference, press)
    require_usable_exposure("ball reference", reference)
    require_usable_exposure("ball image", press)
    before, after = rectify(Frame(reference)), rectify(Frame(press))
    circle = find_contact_circle(rectified_brightness_change(before, after))
    require_disc_above_black(after.grey, circle)
    require_usable_depth(design.ball, circle, rectify.mm_per_px, WIDEST_BY_PHYSICS if method == "physics" else 1.0)
    seen = BallPress(before, after, circle, design.ball, design.camera, smoothing)
    fit = (
        _fit_by_physics(seen, design, beliefs, near)
        if method == "physics"
        else _fit_by_contact_disc(refine_ball_centre(seen), method)
    )
    # The difference contains the noise of two images; a height against an averaged reference contains that of one.
    noise = estimate_pixel_noise(relative_brightness_change(reference, press)) / np.sqrt(2)
    reader = partial(fit.reader, source=rectify.height_source)
    return replace(fit, noise_mm=simulate_height_noise_mm(reader, rectify, reference, noise))


def _fit_by_physics(
    press: BallPress,
    design: SensorDesign,
    beliefs: tuple[ParameterPrior, ...] = (),
    near: ParameterVector | None = None,
) -> BallFit:
    """Fit mechanics and light together, and measure how well the result reconstructs the ball."""
    physical = PhysicsDepthFit(fit_twin(press.before, press.after, press.circle, design, beliefs, near))
    require_explained_by_ball(physical.fit.image_rmse_grey_levels, press.circle)
    curve, cross_validation_mae_mm = physical.curve(physical.disc), physical.cross_validation_mae_mm()
    placed = press.about(physical.centre_px)
    reconstruction_mae_mm, honest = (
        physical.error_mm(curve, physical.disc),
        physical.honest(curve, cross_validation_mae_mm),
    )
    return BallFit(
        "physics",
        honest,
        placed,
        reconstruction_mae_mm,
        cross_validation_mae_mm,
        asymmetry_warnings(press.circle),
        physical=physical,
    )


def _fit_by_contact_disc(press: BallPress, method: DepthMethod) -> BallFit:
    """Pair depth with darkening, and measure how well the result reconstructs the ball."""
    signal = SIGNAL[method]
    curve = press.curve(signal, press.disc)
    half_errors = [
        press.error_mm(press.curve(signal, press.disc & half), press.disc & ~half) for half in press.halves()
    ]
    cross_validation_mae_mm = float(np.mean(half_errors))
    honest = replace(curve, error_mm=tuple(np.hypot(curve.error_mm, cross_validation_mae_mm).tolist()))
    return BallFit(
        method,
        honest,
        press,
        press.error_mm(curve, press.disc),
        cross_validation_mae_mm,
        asymmetry_warnings(press.circle),
    )


def rectified_brightness_change(before: Rectified, after: Rectified) -> Float32[Array, "rows cols"]:
    """Return the relative change of brightness, times the mean brightness of the reference, in grey levels."""
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
    height = replace(reader(before), loss=LightLoss())(after)
    return float(np.std(height.z_mm[height.in_view]))
