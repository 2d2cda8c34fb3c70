"""One press of a ball of known radius → depth curve.

Inside the disc the skin lies on the ball, so the depth that every line of sight meets is known; it is paired with the
pixel's darkening. The camera is near, so a line of sight meets deep skin farther in than shallow skin: left out, as in
the paper, this alone scatters the pairs of a real press to twice as much (benchmarks/ball_accuracy.py). The
rule "the disc's edge is at depth zero" is the paper's: real gel piles up at the rim, which makes it some 0.1–0.2 mm too
deep (docs/accuracy.md).

Methods: `table` is the paper's mapping list of grey differences, made right; `ratio` does the same with the brightness
factor, which holds all over the picture.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array
from scipy.optimize import minimize

from ninedtact.calibration.ball.contact_circle import BallRefused, ContactCircle, find_contact_circle
from ninedtact.calibration.ball.depth_curve import monotone_curve
from ninedtact.calibration.ball.seen_ball import seen_depth_mm
from ninedtact.calibration.brightness import (
    Image,
    grey_float,
    noise_levels,
    relative_change,
    require_same_size,
    require_usable,
    smoothed,
)
from ninedtact.design import BallGauge, Camera, SensorDesign
from ninedtact.quantities import Coverage, Frame, Rectified
from ninedtact.shape.depth import DepthCurve, DepthReader, Signal, Smoothing
from ninedtact.shape.rectification import Rectification

Method = Literal["table", "ratio"]
SIGNAL: dict[Method, Signal] = {"table": "difference", "ratio": "ratio"}

SHALLOWEST_MM = 0.4
"""A press below this covers too little of the range to calibrate it."""
UNEVEN = 0.08
"""Asymmetry of the bulge above which a press counts as sheared (straight real press 0.013, sheared one 0.22)."""
CENTRING_PX = 1.0
CENTRING_TERMS = 7
REFERENCE_DRIFT = 3.0
"""Grey levels of change between two untouched pictures that deserve a word."""


@dataclass(frozen=True)
class BallPress:
    """The untouched and the pressed picture, the disc found in them, and the ball that made it."""

    before: Rectified
    after: Rectified
    circle: ContactCircle
    ball: BallGauge
    camera: Camera
    smoothing: Smoothing

    def about(self, centre_px: Float[Array, "2"]) -> "BallPress":
        """The same press with the ball's centre elsewhere."""
        return replace(self, circle=replace(self.circle, centre_px=(float(centre_px[0]), float(centre_px[1]))))

    @cached_property
    def depth_mm(self) -> Float[Array, "rows cols"]:
        """Depth of the ball's surface on every pixel's line of sight, zero outside the disc."""
        shape, mm_per_px = self.before.grey.shape, self.before.mm_per_px
        x, y = self.circle.centre_px
        centre_mm = (x - (shape[1] - 1) / 2) * mm_per_px, (y - (shape[0] - 1) / 2) * mm_per_px
        return seen_depth_mm(
            shape, mm_per_px, centre_mm, self.edge_radius_mm, self.ball.radius_mm, self.camera.distance_mm
        )

    @cached_property
    def disc(self) -> Bool[Array, "rows cols"]:
        """Where the ball touches, by the rule that the edge of the disc is at depth zero."""
        return self.circle.distance_px(self.before.grey.shape) < self.circle.radius_px

    @property
    def edge_radius_mm(self) -> float:
        """Radius of the disc."""
        return self.circle.radius_px * self.before.mm_per_px

    def curve(self, signal: Signal, where: Bool[Array, "rows cols"]) -> DepthCurve:
        """The monotone curve through the pixels of a region."""
        before, after = self.before.grey[where], self.after.grey[where]
        darkening = before - after if signal == "difference" else 1 - after / np.maximum(before, 1)
        return monotone_curve(signal, darkening, self.depth_mm[where])

    def error_mm(self, curve: DepthCurve, where: Bool[Array, "rows cols"]) -> float:
        """Mean absolute error of the reconstructed height, filters included, over a region."""
        everywhere = np.full(where.shape, Coverage.MEASURED, np.uint8)
        height = DepthReader(curve, self.before, everywhere, self.smoothing)(self.after)
        return float(np.abs(height.indentation_mm - self.depth_mm)[where].mean())

    def halves(self) -> list[Bool[Array, "rows cols"]]:
        """Left, right, upper and lower half of the picture about the disc's centre."""
        rows, cols = np.indices(self.before.grey.shape)
        left, upper = cols < self.circle.centre_px[0], rows < self.circle.centre_px[1]
        return [np.asarray(half) for half in (left, ~left, upper, ~upper)]


@dataclass(frozen=True)
class BallFit:
    """The depth curve with what it rests on."""

    method: Method
    curve: DepthCurve
    press: BallPress
    fit_mae_mm: float
    """Mean absolute error of the reconstructed height inside the disc."""
    half_mae_mm: float
    """The same on one half of the disc with the curve of the other half, mean over four cuts."""
    warnings: tuple[str, ...]
    noise_mm: float = 0.0
    """Standard deviation of one pixel's height from picture to picture, filters included."""

    @property
    def deepest_mm(self) -> float:
        """Depth of the ball's lowest point."""
        return cap_height_mm(self.press.ball.radius_mm, self.press.edge_radius_mm)


def fit_ball(
    rectify: Rectification,
    reference: Image,
    press: Image,
    design: SensorDesign,
    method: Method = "ratio",
    smoothing: Smoothing = Smoothing(),
) -> BallFit:
    """Find the disc and fit the curve; raises `BallRefused`, `PictureUnusable`, `WrongPictureSize`.

    reference, press: raw pictures (rows, cols, 3) of the untouched skin and of the ball pressed on it.
    """
    require_same_size("ball picture", reference, press)
    require_usable("ball reference", reference)
    require_usable("ball picture", press)
    before, after = rectify(Frame(reference)), rectify(Frame(press))
    circle = find_contact_circle(uniform_change(before, after))
    require_depth(design.ball, circle, rectify.mm_per_px)
    fit = fit_curve(centred(BallPress(before, after, circle, design.ball, design.camera, smoothing)), method)
    # Two pictures' noise is in their difference; a reading against an averaged reference has one picture's.
    noise = noise_levels(relative_change(reference, press)) / np.sqrt(2)
    return replace(fit, noise_mm=repeatability_mm(fit.curve, smoothing, rectify, reference, noise))


def centred(press: BallPress) -> BallPress:
    """The press about the point that makes darkness most nearly a function of depth alone.

    The edge gives the disc's size well and its middle only roughly, because the bulge around it is never quite even.
    """
    darkening = smoothed(1 - press.after.grey / np.maximum(press.before.grey, 1), CENTRING_PX)

    def scatter(centre_px: Float[Array, "2"]) -> float:
        depth_mm = press.about(centre_px).depth_mm
        inside = depth_mm > 0
        powers = np.vander(depth_mm[inside], CENTRING_TERMS)
        fitted = powers @ np.linalg.lstsq(powers, darkening[inside], rcond=None)[0]
        return float(np.std(darkening[inside] - fitted))

    best = minimize(scatter, press.circle.centre_px, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-7})
    return press.about(best.x)


def fit_curve(press: BallPress, method: Method) -> BallFit:
    """Pair depth with darkening, and measure how well the result reads the ball back."""
    signal = SIGNAL[method]
    curve = press.curve(signal, press.disc)
    half_errors = [
        press.error_mm(press.curve(signal, press.disc & half), press.disc & ~half) for half in press.halves()
    ]
    half_mae_mm = float(np.mean(half_errors))
    honest = replace(curve, error_mm=tuple(np.hypot(curve.error_mm, half_mae_mm).tolist()))
    return BallFit(method, honest, press, press.error_mm(curve, press.disc), half_mae_mm, warnings(press.circle))


def uniform_change(before: Rectified, after: Rectified) -> Float32[Array, "rows cols"]:
    """Relative change in grey levels of the mean brightness."""
    return (after.grey / np.maximum(before.grey, 1) - 1) * before.grey.mean()


def require_depth(ball: BallGauge, circle: ContactCircle, mm_per_px: float) -> None:
    """Refuse a disc wider than the ball, or too shallow a press."""
    radius_mm = circle.radius_px * mm_per_px
    if radius_mm >= ball.radius_mm:
        raise BallRefused(
            f"expected a disc smaller than the ball (radius {ball.radius_mm:g} mm), got one of {radius_mm:.2f} mm; "
            "check the ball's radius, or press less deep"
        )
    depth_mm = cap_height_mm(ball.radius_mm, radius_mm)
    if depth_mm < SHALLOWEST_MM:
        raise BallRefused(
            f"expected a press at least {SHALLOWEST_MM} mm deep, got {depth_mm:.2f} mm; press deeper, 1 to 2 mm"
        )


def repeatability_mm(
    curve: DepthCurve, smoothing: Smoothing, rectify: Rectification, reference: Image, noise: float, seed: int = 0
) -> float:
    """Scatter of the height when the camera's noise is put on an even press half-way down the range.

    noise: standard deviation of one raw pixel, grey levels. Lens and filters are passed through, so what they leave of
    the noise is what a reading has.
    """
    raw = grey_float(reference)
    half_way = curve.darkening[-1] / 2
    pressed = raw - half_way if curve.signal == "difference" else raw * (1 - half_way)
    noisy = pressed + np.random.default_rng(seed).normal(0, noise, raw.shape).astype(np.float32)
    before, after = (Rectified(rectify.resampled(picture), rectify.mm_per_px) for picture in (raw, noisy))
    height = DepthReader(curve, before, rectify.coverage, smoothing)(after)
    return float(np.std(height.z_mm[height.in_view]))


def cap_height_mm(radius_mm: float, edge_radius_mm: float) -> float:
    """Height of the cap that a circle cuts off a sphere."""
    return float(radius_mm - np.sqrt(radius_mm**2 - edge_radius_mm**2))


def warnings(circle: ContactCircle) -> tuple[str, ...]:
    """What a person should know about this press."""
    if circle.asymmetry <= UNEVEN:
        return ()
    return (
        f"the ball press is asymmetric (uneven bulge {circle.asymmetry:.0%} of the drop, at most {UNEVEN:.0%} expected): it was "
        "sheared; depths may be off by a tenth of a millimetre, press straight down and calibrate again",
    )


def reference_warnings(board_reference: Image, ball_reference: Image) -> tuple[str, ...]:
    """A word when the skin looked different before the two presses."""
    if board_reference.shape != ball_reference.shape:
        return ()
    drift = np.abs(board_reference.mean(axis=2) - ball_reference.mean(axis=2)).mean()
    if drift <= REFERENCE_DRIFT:
        return ()
    return (
        f"the untouched pictures before the board and before the ball differ by {drift:.1f} grey levels (at most "
        f"{REFERENCE_DRIFT:.0f} expected): fix exposure and white balance, let the light warm up, and check the gel",
    )
