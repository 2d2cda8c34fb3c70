"""Whether a ball press can calibrate, and what a person should know about it."""

import numpy as np

from ninedtact.calibration.ball.contact_circle import BallRefused, ContactCircle
from ninedtact.calibration.brightness import Image
from ninedtact.design import BallGauge

WIDEST_BY_PHYSICS = 1.06
"""Of the ball's radius. Skin dips beside the ball too, the wider the thicker the gel; mechanics know that, the edge's rule not."""
SHALLOWEST_MM = 0.4
"""A press below this covers too little of the range to calibrate it."""
UNEVEN = 0.08
"""Asymmetry of the bulge above which a press counts as sheared (straight real press 0.013, sheared one 0.22)."""
WORST_REST = 0.06
"""Part of the darkening that may stay unexplained (a straight real press 0.008, a sheared one 0.04, a roller 0.07)."""
REFERENCE_DRIFT = 3.0
"""Grey levels of change between two untouched images that deserve a word."""


def require_depth(ball: BallGauge, circle: ContactCircle, mm_per_px: float, widest: float = 1.0) -> None:
    """Refuse a disc wider than the ball (or than `widest` of it), or too shallow a press."""
    radius_mm = circle.radius_px * mm_per_px
    if radius_mm >= widest * ball.radius_mm:
        raise BallRefused(
            f"expected a disc smaller than the ball (radius {ball.radius_mm:g} mm), got one of {radius_mm:.2f} mm; "
            "check the ball's radius, or press less deep"
        )
    depth_mm = cap_height_mm(ball.radius_mm, min(radius_mm, ball.radius_mm))
    if depth_mm < SHALLOWEST_MM:
        raise BallRefused(
            f"expected a press at least {SHALLOWEST_MM} mm deep, got {depth_mm:.2f} mm; press deeper, 1 to 2 mm"
        )


def require_like_ball(rest_grey: float, circle: ContactCircle) -> None:
    """Refuse a press that no ball in gel looks like."""
    if rest_grey > WORST_REST * circle.drop:
        raise BallRefused(
            f"expected a press that a ball explains to {WORST_REST:.0%} of its darkening, got {rest_grey:.1f} of "
            f"{circle.drop:.0f} grey levels unexplained; press a clean ball of the stated radius straight down, or choose "
            "another method"
        )


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
        f"the untouched images before the board and before the ball differ by {drift:.1f} grey levels (at most "
        f"{REFERENCE_DRIFT:.0f} expected): fix exposure and white balance, let the light warm up, and check the gel",
    )
