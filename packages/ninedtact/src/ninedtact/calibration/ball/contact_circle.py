"""Detection of the contact circle of a ball in a rectified image, and the checks of whether the press can calibrate depth.

Indented gel is darker, and the rim that bulges around it is brighter; between them the change is zero, and that circle is the edge
of the disc. No threshold is needed: the background far away defines the zero. A press that is too shallow, not round, cut by the
border or unlike a ball is refused with `BallPressUnusable`. An asymmetric one is not: a check of the certificate warns of it.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array
from scipy import ndimage
from scipy.optimize import least_squares

from ninedtact.calibration.brightness_change import estimate_pixel_noise, smooth_gaussian
from ninedtact.design import BallGauge
from ninedtact.errors import CalibrationError
from ninedtact.quantities import BgrImage

_SMOOTHING_PX = 2.0
_EDGE_SMOOTHING_PX = 1.0
"""Standard deviation of the Gaussian at the edge; it is smaller because smoothing moves the zero towards the flatter side."""
_RAY_COUNT = 120
_RAY_STEP_PX = 0.25
_MIN_DARKENING = 3.0
"""Smallest darkening of a contact in grey levels; the drift between two images without contact stays below it (real images: 0.6).
"""
_SECOND_CONTACT = 0.35
"""A second spot with this fraction of the largest darkening is another contact."""
_MAX_GLARE_AREA = 0.2
"""Area of a bright place, relative to that of the dark disc, up to which it is a reflection."""
_BLACK_LEVEL = 2.0
_MAX_BLACK_SHARE = 0.01
"""Largest fraction of the disc at `_BLACK_LEVEL` or below."""
_MIN_EDGE_SHARE = 0.6
"""Smallest fraction of the rays that must reach the edge."""
_MAX_EDGE_SCATTER = 0.12
"""Largest scatter of the edge, relative to the radius: a sheared ball press has 0.03, other objects have far more."""


class BallPressUnusable(CalibrationError):
    """The ball image cannot calibrate depth; the message says why."""


@dataclass(frozen=True)
class ContactCircle:
    """The edge of the contact disc in rectified pixels, and the asymmetry of the press."""

    centre_px: tuple[float, float]
    """(x, y)"""
    radius_px: float
    edge_scatter_px: float
    darkening_grey_levels: float
    """Darkening at the deepest point."""
    asymmetry_vector: tuple[float, float]
    """Uneven brightness of the bulge around the disc, as a fraction of the darkening: the first harmonic, pointing to the brighter
    side."""

    @property
    def asymmetry(self) -> float:
        """Magnitude of the uneven brightness of the bulge, as a fraction of the darkening."""
        return float(np.hypot(*self.asymmetry_vector))

    def distance_px(self, shape: tuple[int, ...]) -> Float[Array, "rows cols"]:
        """Return the distance of every pixel from the disc's centre."""
        rows, cols = np.indices(shape)
        return np.hypot(cols - self.centre_px[0], rows - self.centre_px[1])


def find_contact_circle(change: Float32[Array, "rows cols"], highest_bulge: float = 1.0) -> ContactCircle:
    """Return the one round contact in a rectified relative change (grey levels); raises `BallPressUnusable` with the reason.

    highest_bulge: largest brightening beside the contact relative to the darkening in it; more is a pair of swapped images.
    """
    smoothed = smooth_gaussian(change, _SMOOTHING_PX)
    smoothed = smoothed - np.median(smoothed)
    _require_contact(smoothed, estimate_pixel_noise(change), highest_bulge)
    spot = _darkest_region(smoothed)
    _require_single_contact(smoothed, spot)
    row, column = ndimage.center_of_mass(spot)
    sharp = smooth_gaussian(change, _EDGE_SMOOTHING_PX)
    edge = _find_edge_points(sharp - np.median(sharp), (column, row))
    return _fit_circle(smoothed, edge)


def _require_contact(smoothed: Float32[Array, "rows cols"], noise: float, highest_bulge: float) -> None:
    """Refuse an image without contact and a swapped pair."""
    drop, rise = -float(smoothed.min()), float(smoothed.max())
    needed = max(_MIN_DARKENING, 3 * noise)
    if max(drop, rise) < needed:
        raise BallPressUnusable(
            expected=f"a dark disc, at least {needed:.0f} grey levels darker than the reference",
            got=f"no contact (largest change {max(drop, rise):.1f} levels)",
            remedy="press while the second image is taken",
        )
    if rise > highest_bulge * drop and not _is_glare(smoothed):
        raise BallPressUnusable(
            expected="a dark disc where the object presses",
            got=f"a bright one (+{rise:.0f} against −{drop:.0f} grey levels)",
            remedy="the images look swapped: give the image without contact as the reference",
        )


def _is_glare(smoothed: Float32[Array, "rows cols"]) -> bool:
    """Return whether the brightest place is small or at the border: a reflection, and not a ball in swapped images."""
    bright, dark = _darkest_region(-smoothed), _darkest_region(smoothed)
    at_border = any(side.any() for side in (bright[0], bright[-1], bright[:, 0], bright[:, -1]))
    return bool(at_border or bright.sum() < _MAX_GLARE_AREA * dark.sum())


def _darkest_region(smoothed: Float32[Array, "rows cols"]) -> Bool[Array, "rows cols"]:
    """Return the connected region around the darkest pixel that is darker than half of it."""
    labels, _ = ndimage.label(smoothed < smoothed.min() / 2)
    return np.asarray(labels == labels[np.unravel_index(smoothed.argmin(), smoothed.shape)])


def _require_single_contact(smoothed: Float32[Array, "rows cols"], spot: Bool[Array, "rows cols"]) -> None:
    """Refuse a second contact, and a disc at the border."""
    border = np.ones_like(spot)
    border[1:-1, 1:-1] = False
    if (spot & border).any():
        raise BallPressUnusable(
            expected="the whole disc in view", got="one cut by the image's border", remedy="press nearer to the middle"
        )
    labels, count = ndimage.label(smoothed < _SECOND_CONTACT * smoothed.min())
    sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
    rivals = int((sizes > 0.1 * sizes.max()).sum())
    if rivals > 1:
        raise BallPressUnusable(expected="one contact", got=f"{rivals}", remedy="press with one object alone")


def _find_edge_points(smoothed: Float32[Array, "rows cols"], centre_px: tuple[float, float]) -> Float[Array, "n 2"]:
    """Return, along each ray from the centre, the first point (x, y) that is no darker than skin without contact."""
    angles = np.arange(_RAY_COUNT) * (2 * np.pi / _RAY_COUNT)
    radii = np.arange(_RAY_STEP_PX, max(smoothed.shape), _RAY_STEP_PX)
    directions = np.column_stack([np.cos(angles), np.sin(angles)])
    points = centre_px + radii[:, None, None] * directions
    seen = ndimage.map_coordinates(smoothed, points[..., ::-1].transpose(2, 0, 1), order=1, cval=np.nan)
    risen = seen >= 0  # never where a ray has left the view: samples there are not-a-number
    reached = np.asarray(risen.any(axis=0))
    _require_whole_disc(reached)
    return np.asarray(np.take_along_axis(points, risen.argmax(axis=0)[None, :, None], axis=0)[0, reached])


def _require_whole_disc(reached: Bool[Array, " rays"]) -> None:
    """Refuse a disc whose edge lies outside the view for too many rays."""
    if reached.mean() < _MIN_EDGE_SHARE:
        raise BallPressUnusable(
            expected="the disc's edge all around",
            got=f"it on {reached.mean():.0%} of the circle",
            remedy="the rest is outside the view or has no bright rim: press nearer to the middle, with one object "
            "alone",
        )


def _fit_circle(smoothed: Float32[Array, "rows cols"], edge: Float[Array, "n 2"]) -> ContactCircle:
    """Return the robust least-squares circle through the edge points."""
    middle = edge.mean(axis=0)
    start = [*middle, np.hypot(*(edge - middle).T).mean()]

    def residual(circle: Float[Array, "3"]) -> Float[Array, " n"]:
        return np.asarray(np.hypot(edge[:, 0] - circle[0], edge[:, 1] - circle[1]) - circle[2])

    x, y, radius = least_squares(residual, start, loss="soft_l1").x
    scatter = float(np.std(np.hypot(edge[:, 0] - x, edge[:, 1] - y)))
    _require_round_edge(smoothed.shape, (x, y), radius, scatter)
    drop = -float(smoothed.min())
    harmonic = _bulge_first_harmonic(smoothed, (x, y), radius)
    return ContactCircle((float(x), float(y)), float(radius), scatter, drop, (harmonic[0] / drop, harmonic[1] / drop))


def _require_round_edge(
    shape: tuple[int, ...], centre_px: tuple[float, float], radius_px: float, scatter_px: float
) -> None:
    """Refuse a contact that is not round, or not wholly in view."""
    if scatter_px > _MAX_EDGE_SCATTER * radius_px:
        raise BallPressUnusable(
            expected="a round disc",
            got=f"an edge that strays {scatter_px / radius_px:.0%} of its radius from a circle",
            remedy="press with a ball, straight down",
        )
    x, y = centre_px
    if min(x, y, shape[1] - 1 - x, shape[0] - 1 - y) < radius_px:
        raise BallPressUnusable(
            expected="the whole disc in view", got="one cut by the image's border", remedy="press nearer to the middle"
        )


def _bulge_first_harmonic(
    smoothed: Float32[Array, "rows cols"], centre_px: tuple[float, float], radius_px: float
) -> tuple[float, float]:
    """Return the amplitudes of cos θ and sin θ in the brightness just outside the disc."""
    rows, cols = np.indices(smoothed.shape)
    x, y = np.asarray(cols - centre_px[0]), np.asarray(rows - centre_px[1])
    distance = np.hypot(x, y)
    ring = (distance > 1.1 * radius_px) & (distance < 1.6 * radius_px)
    columns = np.column_stack([np.ones(ring.sum()), x[ring] / distance[ring], y[ring] / distance[ring]])
    amplitudes = np.linalg.pinv(columns) @ smoothed[ring]
    return float(amplitudes[1]), float(amplitudes[2])


MAX_RADIUS_BY_PHYSICS = 1.06
"""Largest radius of the disc, as a fraction of the ball's radius, for the method `physics`. Skin is also indented beside the ball,
and more widely in thicker gel; the contact mechanics include that, the rule of the disc's edge does not.
"""
MIN_PRESS_DEPTH_MM = 0.4
"""Smallest depth of a press; a shallower one covers too little of the range to calibrate it."""
_MAX_RESIDUAL = 0.06
"""Fraction of the darkening that may stay unexplained (a straight real press 0.008, a sheared one 0.04, a roller 0.07)."""
_MAX_REFERENCE_DIFFERENCE = 3.0
"""Change in grey levels between two reference images above which a warning is given."""


def require_usable_depth(
    ball: BallGauge, circle: ContactCircle, mm_per_px: float, max_relative_radius: float = 1.0
) -> None:
    """Refuse a disc wider than the ball (or than the fraction `max_relative_radius` of it), and a press that is too shallow."""
    radius_mm = circle.radius_px * mm_per_px
    if radius_mm >= max_relative_radius * ball.radius_mm:
        raise BallPressUnusable(
            expected=f"a disc smaller than the ball (radius {ball.radius_mm:g} mm)",
            got=f"one of {radius_mm:.2f} mm",
            remedy="check the ball's radius and the pitch of the board's pins, or press less deep",
        )
    depth_mm = spherical_cap_height_mm(ball.radius_mm, min(radius_mm, ball.radius_mm))
    if depth_mm < MIN_PRESS_DEPTH_MM:
        raise BallPressUnusable(
            expected=f"a press at least {MIN_PRESS_DEPTH_MM} mm deep",
            got=f"{depth_mm:.2f} mm",
            remedy="press deeper, 1 to 2 mm",
        )


def require_disc_above_black(after: Float32[Array, "rows cols"], circle: ContactCircle) -> None:
    """Refuse a disc whose bottom is black in the press image (rows, cols) of grey levels: its depth cannot be read."""
    disc = after[circle.distance_px(after.shape) < circle.radius_px]
    black = float((disc <= _BLACK_LEVEL).mean())
    if black > _MAX_BLACK_SHARE:
        raise BallPressUnusable(
            expected="the bottom of the disc to be brighter than black",
            got=f"{black:.0%} of it at {_BLACK_LEVEL:g} grey levels or below, where brightness no longer shows depth",
            remedy="give more light or a longer exposure, or press less deep",
        )


def require_explained_by_ball(rmse_grey: float, circle: ContactCircle) -> None:
    """Refuse a press whose image the model of a ball in gel does not explain."""
    if rmse_grey > _MAX_RESIDUAL * circle.darkening_grey_levels:
        raise BallPressUnusable(
            expected=f"a press that a ball explains to {_MAX_RESIDUAL:.0%} of its darkening",
            got=f"{rmse_grey:.1f} of {circle.darkening_grey_levels:.0f} grey levels unexplained",
            remedy="press a clean ball of the stated radius straight down, or choose another method",
        )


def spherical_cap_height_mm(radius_mm: float, edge_radius_mm: float) -> float:
    """Return the height of the cap that a circle cuts off a sphere."""
    return float(radius_mm - np.sqrt(radius_mm**2 - edge_radius_mm**2))


def reference_mismatch_warnings(board_reference: BgrImage, ball_reference: BgrImage) -> tuple[str, ...]:
    """Return a warning where the two reference images, before the board and before the ball, differ."""
    if board_reference.shape != ball_reference.shape:
        return ()
    drift = np.abs(board_reference.mean(axis=2) - ball_reference.mean(axis=2)).mean()
    if drift <= _MAX_REFERENCE_DIFFERENCE:
        return ()
    return (
        f"the reference images before the board and before the ball differ by {drift:.1f} grey levels (at most "
        f"{_MAX_REFERENCE_DIFFERENCE:.0f} expected): fix exposure and white balance, let the light warm up, and check the gel",
    )
