"""A second press on the gel of the calibration's ball, which is fitted together with the first: of another ball, or of the flat end
of a rod that a stop lets in to a known depth. It tells the base of the gel, and so the true depth.

`PressedObject` is the interface of what is pressed. In: the design, and raw images of the skin before each press and under it.
Out: `ObjectPress`, by `find_second_presses`.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.ball.ball_press import (
    RoundPress,
    find_usable_contact_circle,
    rectified_flat_fielded_change,
    rectify_pair,
)
from ninedtact.calibration.ball.contact_circle import (
    BallPressUnusable,
    ContactCircle,
    find_contact_circle,
    require_disc_above_black,
    spherical_cap_height_mm,
)
from ninedtact.calibration.brightness_change import relative_brightness
from ninedtact.design import BallGauge, FlatEndGauge, SecondKind, SensorDesign
from ninedtact.errors import InputError
from ninedtact.mechanics.indenter import Ball, FlatPunch, Indenter
from ninedtact.quantities import BgrImage, Rectified, skin_grid_mm
from ninedtact.shape.depth import DepthMethod
from ninedtact.shape.lens_and_rectification import Rectification
from ninedtact.simulation.calibration_images import FLAT_END_EDGE_MM

_EDGE_RULE_BIAS_MM = 0.1
"""Usual excess of the depth that the rule of the disc's edge gives."""
_WIDE_DISC_RADIUS = 0.95
"""Radius of the disc for the initial guess, as a fraction of the ball's radius, where the disc is wider than the ball (as in thick
gel) and does not determine the depth.
"""
_MAX_BALL_RESIDUAL, _MAX_FLAT_RESIDUAL = 0.04, 0.06
"""Fraction of the darkening that may stay unexplained by gel and light of the first press; a flat end is shallower."""
_LEAST_RIM_DARKENING = 0.92
"""Darkening half-way out to the rim over that in the middle of a disc, below which no flat end is pressed: under one, the gel is as
thin there, or thinner."""
_DISC_BEYOND_RIM_MM = (-0.4, 1.4)
"""Radius of the disc of a flat end, less that of the rod: the skin is drawn down beside it."""
_HIGHEST_BULGE = 2.0
"""Largest brightening beside a flat end relative to the darkening under it: it displaces much gel for its depth."""
_MAX_TILT_DARKENING = 0.4
"""Largest change of the darkening from the middle of a flat end to its rim, relative to that in the middle. A drag changes it
too, on a base that yields."""
_MAX_FLAT_DEPTH = 0.7
"""Largest depth of a flat end as a fraction of the thickness of the gel."""


class PressedObject(ABC):
    """A round object that is pressed on the gel: the calibration's ball, another one, or the flat end of a rod."""

    kind: ClassVar[SecondKind]
    """What it is where it is pressed second."""
    radius_mm: float
    """Radius of the ball or of the rod."""

    @property
    @abstractmethod
    def indenter(self) -> Indenter:
        """The object over the skin."""

    @property
    def known_depth(self) -> tuple[float, float] | None:
        """Depth in mm and its standard deviation, where a stop sets it."""
        return None

    @property
    def face_radius_mm(self) -> float | None:
        """Radius of a flat face; None for a ball."""
        return None

    @abstractmethod
    def find_contact(self, before: Rectified, after: Rectified, method: DepthMethod) -> ContactCircle:
        """Return the contact circle in two rectified images; raises `BallPressUnusable`."""

    @abstractmethod
    def estimate_depth_mm(self, edge_radius_mm: float) -> float:
        """Return the approximate depth of a press from the radius of its contact circle."""

    @abstractmethod
    def require_explained(self, rmse_grey: float, circle: ContactCircle) -> None:
        """Refuse a press that gel and light of the first do not explain; raises `BallPressUnusable`."""

    def as_pressed(self, before: Rectified, after: Rectified, circle: ContactCircle) -> "PressedObject":
        """Return the object with what its press shows of how it was held."""
        return self

    @property
    def name(self) -> str:
        """The object in words."""
        return self.kind.replace("_", " ")


@dataclass(frozen=True)
class PressedBall(PressedObject):
    """A ball of this radius."""

    radius_mm: float
    kind: ClassVar[SecondKind] = "second_ball"

    @property
    def indenter(self) -> Ball:
        """The ball."""
        return Ball(self.radius_mm)

    def find_contact(self, before: Rectified, after: Rectified, method: DepthMethod) -> ContactCircle:
        """Return the contact circle of a ball that can calibrate depth."""
        return find_usable_contact_circle(before, after, BallGauge(self.radius_mm, self.radius_mm), method)

    def estimate_depth_mm(self, edge_radius_mm: float) -> float:
        """Return the depth by the rule of the disc's edge, less its usual bias."""
        is_wide = edge_radius_mm >= self.radius_mm
        disc_mm = _WIDE_DISC_RADIUS * self.radius_mm if is_wide else edge_radius_mm
        return spherical_cap_height_mm(self.radius_mm, disc_mm) - _EDGE_RULE_BIAS_MM

    def require_explained(self, rmse_grey: float, circle: ContactCircle) -> None:
        """Refuse a press of a ball of another radius than the stated one."""
        if rmse_grey > _MAX_BALL_RESIDUAL * circle.darkening_grey_levels:
            raise BallPressUnusable(
                expected=f"a second press that a ball of radius {self.radius_mm:g} mm explains to {_MAX_BALL_RESIDUAL:.0%} of its "
                "darkening, on the gel of the first",
                got=f"{rmse_grey:.1f} of {circle.darkening_grey_levels:.0f} grey levels unexplained",
                remedy="measure the second ball with a calliper and correct its radius, press it straight down on the same "
                "sensor, or leave it out",
            )


@dataclass(frozen=True)
class PressedFlatEnd(PressedObject):
    """The flat end of a rod, pressed to a known depth. Its rim is not fitted, and its tilt is taken out of the image."""

    gauge: FlatEndGauge
    tilt_mm: float = 0.0
    """Height of the highest point of its rim over its middle."""
    kind: ClassVar[SecondKind] = "flat_end"

    @property
    def radius_mm(self) -> float:  # type: ignore[override]
        """Radius of the rod."""
        return self.gauge.radius_mm

    @property
    def indenter(self) -> FlatPunch:
        """The rod with a lightly broken edge."""
        return FlatPunch(self.gauge.radius_mm, FLAT_END_EDGE_MM)

    @property
    def known_depth(self) -> tuple[float, float]:
        """Depth of the middle and its error: the first touch was between that of the lowest point of the rim and of the middle."""
        error_mm = float(np.hypot(self.gauge.depth_error_mm, self.tilt_mm / np.sqrt(12)))
        return self.gauge.depth_mm - self.tilt_mm / 2, error_mm

    @property
    def face_radius_mm(self) -> float:
        """Radius of the rod."""
        return self.gauge.radius_mm

    def find_contact(self, before: Rectified, after: Rectified, method: DepthMethod) -> ContactCircle:
        """Return the contact circle of a flat end of this radius that is not tilted much."""
        change = rectified_flat_fielded_change(before, after)
        circle = find_contact_circle(change, _HIGHEST_BULGE)
        self._require_radius(circle.radius_px * before.mm_per_px)
        require_disc_above_black(after.grey, circle)
        self._require_flat_face(before, after, circle)
        return circle

    def as_pressed(self, before: Rectified, after: Rectified, circle: ContactCircle) -> "PressedFlatEnd":
        """Return the flat end with the tilt that the slope of the darkening across its face shows."""
        return replace(self, tilt_mm=self.gauge.depth_mm * self._slope_to_rim(*_darkening_about(before, after, circle)))

    def _require_radius(self, disc_mm: float) -> None:
        least, most = (self.gauge.radius_mm + beyond for beyond in _DISC_BEYOND_RIM_MM)
        if not least < disc_mm < most:
            raise BallPressUnusable(
                expected=f"a disc of {least:.1f} to {most:.1f} mm, for its radius of {self.gauge.radius_mm:g} mm",
                got=f"one of {disc_mm:.2f} mm",
                remedy="measure the rod with a calliper and give its radius, and press its flat end alone, wholly in view",
            )

    def _require_flat_face(self, before: Rectified, after: Rectified, circle: ContactCircle) -> None:
        """Refuse a face that is not flat, as a ball's, and one that is tilted too far to count its depth as known."""
        darkening, x_mm, y_mm = _darkening_about(before, after, circle)
        distance_mm, radius_mm = np.hypot(x_mm, y_mm), self.gauge.radius_mm
        middle = float(darkening[distance_mm < radius_mm / 4].mean())
        half_way = float(darkening[np.abs(distance_mm / radius_mm - 0.55) < 0.1].mean())
        if half_way < _LEAST_RIM_DARKENING * middle:
            raise BallPressUnusable(
                expected="a face under which the gel is as dark towards the rim as in the middle",
                got=f"{half_way / middle:.0%} of the darkening half-way to the rim, as under a ball",
                remedy="press the flat end of a rod, or give the image of a ball with --second-ball",
            )
        to_rim = self._slope_to_rim(darkening, x_mm, y_mm)
        if to_rim > _MAX_TILT_DARKENING:
            tilt_deg = np.degrees(to_rim * self.gauge.depth_mm / radius_mm)
            raise BallPressUnusable(
                expected=f"a face that lies flat (darkening even to {_MAX_TILT_DARKENING:.0%} from its middle to its rim)",
                got=f"{to_rim:.0%}, a tilt of about {tilt_deg:.1f}°",
                remedy="guide the rod, such as in a drilled block, and press it straight down",
            )

    def _slope_to_rim(
        self, darkening: Float32[Array, "rows cols"], x_mm: Float[Array, "rows cols"], y_mm: Float[Array, "rows cols"]
    ) -> float:
        """Return the change of the darkening from the middle of the face to its rim, relative to that in the middle."""
        on_face = np.hypot(x_mm, y_mm) < 0.7 * self.gauge.radius_mm
        columns = np.column_stack([np.ones(on_face.sum()), x_mm[on_face], y_mm[on_face]])
        level, *slopes = np.linalg.lstsq(columns, darkening[on_face], rcond=None)[0].tolist()
        return float(np.hypot(*slopes)) * self.gauge.radius_mm / level

    def estimate_depth_mm(self, edge_radius_mm: float) -> float:
        """Return the depth of the stop."""
        return self.gauge.depth_mm

    def require_explained(self, rmse_grey: float, circle: ContactCircle) -> None:
        """Refuse a press of another depth or radius than the stated one."""
        if rmse_grey > _MAX_FLAT_RESIDUAL * circle.darkening_grey_levels:
            raise BallPressUnusable(
                expected=f"an image that a flat end of radius {self.gauge.radius_mm:g} mm, {self.gauge.depth_mm:g} mm deep, "
                f"explains to {_MAX_FLAT_RESIDUAL:.0%} of its darkening, on the gel of the ball",
                got=f"{rmse_grey:.1f} of {circle.darkening_grey_levels:.0f} grey levels unexplained",
                remedy="measure rod and stop and correct radius and depth, press it on the same sensor, or leave it out",
            )


def _darkening_about(
    before: Rectified, after: Rectified, circle: ContactCircle
) -> tuple[Float32[Array, "rows cols"], Float[Array, "rows cols"], Float[Array, "rows cols"]]:
    """Return the relative darkening of every pixel, and its x and y in mm from the centre of a contact."""
    shape, mm_per_px = before.grey.shape, before.mm_per_px
    darkening = 1 - relative_brightness(after, before)
    x, y = skin_grid_mm(shape, mm_per_px)
    centre_x, centre_y = RoundPress(before, after, circle).centre_mm
    return np.asarray(darkening - np.median(darkening), np.float32), x - centre_x, y - centre_y


@dataclass(frozen=True)
class ObjectPress(RoundPress):
    """The press of a ball, or of a flat end, with what is known of it."""

    object: PressedObject


def second_object(kind: SecondKind, design: SensorDesign) -> PressedObject:
    """Return what a design presses second; raises `InputError` for a flat end deeper than the gel allows."""
    if kind == "second_ball":
        return PressedBall(design.ball.second_radius_mm)
    deepest_mm = _MAX_FLAT_DEPTH * design.gel.thickness_mm
    if design.flat_end.depth_mm > deepest_mm:
        raise InputError(
            expected=f"a flat end at most {deepest_mm:.1f} mm deep in a gel of {design.gel.thickness_mm:g} mm",
            got=f"{design.flat_end.depth_mm:g} mm",
            remedy="choose a stop that lets it in less far",
        )
    return PressedFlatEnd(design.flat_end)


def find_second_presses(
    rectify: Rectification,
    pairs: Mapping[SecondKind, tuple[BgrImage, BgrImage]],
    design: SensorDesign,
    method: DepthMethod,
) -> tuple[ObjectPress, ...]:
    """Return the second presses, which are fitted together with that of the ball.

    pairs: the raw images of the skin before each object and under it. Raises `BallPressUnusable`, whose message names the object,
    and `InputError` for another method than `physics`.
    """
    return tuple(_find_second_press(rectify, pair, second_object(kind, design), method) for kind, pair in pairs.items())


def _find_second_press(
    rectify: Rectification, pair: tuple[BgrImage, BgrImage], pressed: PressedObject, method: DepthMethod
) -> ObjectPress:
    if method != "physics":
        raise InputError(
            expected=f"the method physics for a {pressed.name}, which is fitted together with the first ball",
            got=f"the method {method}",
            remedy=f"leave out the {pressed.name}, or choose physics",
        )
    before, after = rectify_pair(rectify, *pair, pressed.name)
    try:
        circle = pressed.find_contact(before, after, method)
    except BallPressUnusable as refusal:
        raise BallPressUnusable(
            expected=f"of the {pressed.name} {refusal.expected}", got=refusal.got, remedy=refusal.remedy
        ) from refusal
    return ObjectPress(before, after, circle, pressed.as_pressed(before, after, circle))
