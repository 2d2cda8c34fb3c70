"""One press of a ball of known radius → depth curve.

Inside the disc the skin lies on the ball, so the depth that every line of sight meets is known; it is paired with the
pixel's darkening. The camera is near, so a line of sight meets deep skin farther in than shallow skin: left out, as in
the paper, it doubles the error of `ratio` on a real press (benchmarks/ball_accuracy.py). The
rule "the disc's edge is at depth zero" is the paper's: real gel piles up at the rim, which makes it some 0.1–0.2 mm too
deep (docs/accuracy.md).

Methods: `table` is the paper's mapping list of grey differences, made right; `ratio` does the same with the brightness
factor, which holds all over the picture.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.calibration.ball.contact_circle import find_contact_circle
from ninedtact.calibration.ball.judgement import cap_height_mm, require_depth, warnings
from ninedtact.calibration.ball.press import BallPress, centred
from ninedtact.calibration.brightness import (
    Image,
    grey_float,
    noise_levels,
    relative_change,
    require_same_size,
    require_usable,
)
from ninedtact.design import SensorDesign
from ninedtact.quantities import Frame, Rectified
from ninedtact.shape.depth import DepthCurve, DepthReader, Signal, Smoothing
from ninedtact.shape.rectification import Rectification

Method = Literal["table", "ratio"]
SIGNAL: dict[Method, Signal] = {"table": "difference", "ratio": "ratio"}


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
