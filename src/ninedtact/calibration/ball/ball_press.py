"""A ball pressed on the skin, as two rectified images and the contact disc in them: the pairs of darkening and depth, and the
monotone depth curve through them.

The depth of a pixel is that at which its line of sight meets the ball. The camera stands `distance_mm` below the centre of the
skin; the line through a point of the undeformed plane is followed until it meets the sphere that cuts the plane in the contact
circle. (Refraction on the way is included in the lens model and in the distance; docs/accuracy.md gives what remains.) The depth
curve rises, has no gaps and starts at zero.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.optimize import isotonic_regression, minimize

from ninedtact.calibration.ball.contact_circle import ContactCircle
from ninedtact.calibration.press_brightness import smooth_gaussian
from ninedtact.design import BallGauge, CameraGeometry
from ninedtact.quantities import HeightSource, Rectified, skin_grid_mm
from ninedtact.shape.depth import BrightnessSignal, DepthCurve, DepthReader, Smoothing

LEVEL: dict[BrightnessSignal, float] = {"difference": 1.0, "ratio": 1 / 160}
"""Width of one bin of darkening: one grey level, and its equivalent in the ratio for an image of usual brightness."""
FIRST_LEVEL = 4
"""Bin below which the curve is a straight line from zero. The edge of the disc is blurred, so the first bins would turn a drift of
one grey level into a tenth of a millimetre.
"""


def fit_monotone_depth_curve(
    signal: BrightnessSignal, darkening: Float[Array, " n"], depth_mm: Float[Array, " n"]
) -> DepthCurve:
    """Return the mean depth of every bin of darkening, made monotone by isotonic regression (weights: pixels per bin).

    Empty bins are interpolated; brightening pixels near the edge count as bin zero.
    """
    level = np.maximum(np.round(darkening / LEVEL[signal]), 0).astype(int)
    count = np.bincount(level)
    known = np.flatnonzero(count)
    known = known[known >= min(FIRST_LEVEL, known[-1])]
    mean = np.bincount(level, depth_mm)[known] / count[known]
    spread = np.sqrt(np.maximum(np.bincount(level, depth_mm**2)[known] / count[known] - mean**2, 0))
    rising = np.asarray(isotonic_regression(mean, weights=count[known]).x)
    return anchor_depth_curve_at_zero(signal, known * LEVEL[signal], rising, spread)


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


def _visible_ball_depth_mm(
    shape: tuple[int, int],
    mm_per_px: float,
    centre_mm: tuple[float, float],
    edge_radius_mm: float,
    ball_radius_mm: float,
    camera_distance_mm: float,
) -> Float[Array, "rows cols"]:
    """Return the depth of the ball's surface on every pixel's line of sight, zero where the line misses the disc."""
    camera = np.array([0.0, 0.0, -camera_distance_mm])
    ball = np.array([*centre_mm, np.sqrt(ball_radius_mm**2 - edge_radius_mm**2)])
    x, y = skin_grid_mm(shape, mm_per_px)
    sight = np.stack([x, y, np.full_like(x, camera_distance_mm)], axis=-1).astype(float)
    ray_fraction = intersect_rays_with_sphere(camera - ball, sight, ball_radius_mm)
    return np.maximum(camera_distance_mm * (1 - ray_fraction), 0)


def intersect_rays_with_sphere(
    start: Float[Array, "3"], sight: Float[Array, "rows cols 3"], radius: float
) -> Float[Array, "rows cols"]:
    """Return the smaller t at which start + t·sight lies on the sphere about zero; 1 (the plane) where there is no intersection."""
    square = (sight**2).sum(axis=-1)
    product = sight @ start
    discriminant = product**2 - square * (start @ start - radius**2)
    return np.where(discriminant > 0, (-product - np.sqrt(np.maximum(discriminant, 0))) / square, 1)


CENTRING_PX = 1.0
CENTRING_TERMS = 7


@dataclass(frozen=True)
class BallPressImages:
    """The reference image, the image of the press, the contact disc found in them, and the ball."""

    before: Rectified
    after: Rectified
    circle: ContactCircle
    ball: BallGauge
    camera: CameraGeometry
    smoothing: Smoothing

    def about(self, centre_px: Float[Array, "2"]) -> "BallPressImages":
        """Return the same press with the ball's centre at another pixel."""
        return replace(self, circle=replace(self.circle, centre_px=(float(centre_px[0]), float(centre_px[1]))))

    @cached_property
    def depth_mm(self) -> Float[Array, "rows cols"]:
        """Depth of the ball's surface on every pixel's line of sight, zero outside the disc."""
        shape = self.before.grey.shape
        mm_per_px = self.before.mm_per_px
        x, y = self.circle.centre_px
        centre_mm = (x - (shape[1] - 1) / 2) * mm_per_px, (y - (shape[0] - 1) / 2) * mm_per_px
        return _visible_ball_depth_mm(
            shape, mm_per_px, centre_mm, self.edge_radius_mm, self.ball.radius_mm, self.camera.distance_mm
        )

    @cached_property
    def disc(self) -> Bool[Array, "rows cols"]:
        """The pixels at which the ball touches, by the rule that the edge of the disc is at depth zero."""
        return self.circle.distance_px(self.before.grey.shape) < self.circle.radius_px

    @property
    def edge_radius_mm(self) -> float:
        """Return the radius of the contact disc in mm."""
        return self.circle.radius_px * self.before.mm_per_px

    def curve(self, signal: BrightnessSignal, where: Bool[Array, "rows cols"]) -> DepthCurve:
        """Return the monotone curve through the pixels of a region."""
        before, after = self.before.grey[where], self.after.grey[where]
        darkening = before - after if signal == "difference" else 1 - after / np.maximum(before, 1)
        return fit_monotone_depth_curve(signal, darkening, self.depth_mm[where])

    def error_mm(self, curve: DepthCurve, where: Bool[Array, "rows cols"]) -> float:
        """Return the mean absolute error of the reconstructed height, filters included, over a region."""
        everywhere = np.full(where.shape, HeightSource.MEASURED, np.uint8)
        height = DepthReader(curve, self.before, everywhere, self.smoothing)(self.after)
        return float(np.abs(height.indentation_mm - self.depth_mm)[where].mean())

    def halves(self) -> list[Bool[Array, "rows cols"]]:
        """Return the left, right, upper and lower half of the image about the disc's centre."""
        rows, cols = np.indices(self.before.grey.shape)
        left, upper = cols < self.circle.centre_px[0], rows < self.circle.centre_px[1]
        return [np.asarray(half) for half in (left, ~left, upper, ~upper)]


def refine_ball_centre(press: BallPressImages) -> BallPressImages:
    """Return the press with its centre moved to where darkening is most nearly a function of depth alone.

    The edge determines the disc's size well but its centre only roughly, because the bulge around it is never quite even.
    """
    darkening = smooth_gaussian(1 - press.after.grey / np.maximum(press.before.grey, 1), CENTRING_PX)

    def scatter(centre_px: Float[Array, "2"]) -> float:
        depth_mm = press.about(centre_px).depth_mm
        inside = depth_mm > 0
        powers = np.vander(depth_mm[inside], CENTRING_TERMS)
        fitted = powers @ np.linalg.lstsq(powers, darkening[inside], rcond=None)[0]
        return float(np.std(darkening[inside] - fitted))

    best = minimize(scatter, press.circle.centre_px, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 1e-7})
    return press.about(best.x)
