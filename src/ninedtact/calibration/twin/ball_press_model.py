"""What is fitted: names, bounds, and how far to step when asking what a parameter does.

A ball press as numbers to fit: brightness relative to untouched skin at points around the contact.

Parameters → the image that they predict: contact mechanics, then light, then lines of sight.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.brightness import smooth_gaussian
from ninedtact.design import SensorDesign
from ninedtact.mechanics.alternating_solver import SolverSettings
from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.indenter_primitives import Ball
from ninedtact.mechanics.layer_compliance import bonded_layer_compliance
from ninedtact.mechanics.periodic_grid import PeriodicGrid
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import Skin
from ninedtact.quantities import Rectified
from ninedtact.shape.rectification import skin_grid_mm
from ninedtact.simulation.illumination import saturating_response_mm
from ninedtact.simulation.pixel_map import (
    REFINEMENT,
    SightlineGrid,
    blur_and_refine_fields,
    grid_coordinates,
    sample_periodic,
)


@dataclass(frozen=True)
class _FitParameter:
    """One number to be found."""

    name: str
    least: float
    most: float
    step: float
    """For the difference quotient: small against what matters, large against the solver's tolerance."""
    scale: float = 1.0


FIT_PARAMETERS = (
    _FitParameter("x_mm", -12, 12, 0.02),
    _FitParameter("y_mm", -9, 9, 0.02),
    _FitParameter("depth_mm", 0.1, 3.0, 0.02),
    _FitParameter("drag_x_mm", -4, 4, 0.03),
    _FitParameter("drag_y_mm", -4, 4, 0.03),
    _FitParameter("thickness_mm", 0.8, 6.0, 0.03),
    _FitParameter("point_spread_mm", 0.05, 1.5, 0.02, 0.3),
    _FitParameter("saturation", 0.0, 5.0, 0.05, 0.5),
    _FitParameter("inverse_distance_per_mm", 0.0, 0.08, 0.004, 0.05),
)
"""Those that the image depends on in no simple way. Given them, three more are a linear problem: the level 1 + c, and
(1 + c) times the slopes of dark and bright."""
PARAMETER_NAMES = tuple(parameter.name for parameter in FIT_PARAMETERS)

ParameterVector = Float[Array, " parameters"]


def parameter_bounds() -> tuple[ParameterVector, ParameterVector]:
    """Lower and upper bounds of what is searched."""
    return np.array([p.least for p in FIT_PARAMETERS], float), np.array([p.most for p in FIT_PARAMETERS], float)


def parameter_scales() -> ParameterVector:
    """Of how much of each parameter matters."""
    return np.array([p.scale for p in FIT_PARAMETERS])


def step_parameter(vector: ParameterVector, index: int) -> tuple[ParameterVector, float]:
    """The vector with one parameter moved, inside its bounds, and by how much."""
    parameter = FIT_PARAMETERS[index]
    step = parameter.step if vector[index] + parameter.step < parameter.most else -parameter.step
    moved = vector.copy()
    moved[index] += step
    return moved, step


REACH_MM = 8.0
"""Radius around the contact within which the image is fitted."""
SMOOTHING_PX = 1.5
EVERY_PX = 2
"""Of rows and columns; smoothing has made neighbours alike."""
DIMMEST = 1.0


@dataclass(frozen=True)
class ObservedBallPress:
    """Two rectified images, before and after, around the contact."""

    before: Rectified
    after: Rectified
    middle_mm: tuple[float, float]
    """Roughly of the contact."""

    @cached_property
    def ratio(self) -> Float32[Array, "rows cols"]:
        """Brightness relative to untouched skin, calmed."""
        return smooth_gaussian(self.after.grey / np.maximum(self.before.grey, DIMMEST), SMOOTHING_PX)

    @cached_property
    def place_mm(self) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """x and y of every pixel."""
        return skin_grid_mm(self.before.grey.shape, self.before.mm_per_px)

    @cached_property
    def chosen(self) -> Bool[Array, "rows cols"]:
        """The pixels that are fitted."""
        x, y = self.place_mm
        near = np.hypot(x - self.middle_mm[0], y - self.middle_mm[1]) < REACH_MM
        every = np.zeros_like(near)
        every[::EVERY_PX, ::EVERY_PX] = True
        return np.asarray(near & every)

    @cached_property
    def points_mm(self) -> tuple[Float32[Array, "1 n"], Float32[Array, "1 n"]]:
        """x and y of the chosen pixels."""
        x, y = (axis[self.chosen][None] for axis in self.place_mm)
        return x, y

    @cached_property
    def relative_brightness(self) -> Float[Array, " n"]:
        """Relative brightness of the chosen pixels."""
        return self.ratio[self.chosen].astype(float)

    @property
    def blur_mm(self) -> float:
        """Standard deviation of the calming, which is part of the point-spread that is fitted."""
        return SMOOTHING_PX * self.before.mm_per_px

    @property
    def mean_grey(self) -> float:
        """Of the untouched image: what turns relative brightness into grey levels."""
        return float(self.before.grey.mean())

    def image(self, values: Float[Array, " n"]) -> Float[Array, "few_rows few_cols"]:
        """Values of the chosen pixels as a coarse image, not-a-number elsewhere."""
        whole = np.full(self.chosen.shape, np.nan)
        whole[self.chosen] = values
        return whole[::EVERY_PX, ::EVERY_PX]


PATCH = PeriodicGrid(128, 128, 0.2)
"""25.6 mm square around the contact: what is beyond is too faint to matter."""
FRICTION = 1.0
"""Silicone on anything clean; between 0.5 and 1 the fit hardly changes."""
PRESS_STEP_MM, DRAG_STEP_MM = 0.5, 0.35
EFFORT = SolverSettings(tolerance=2e-3, must_converge=False)
KEPT_CONTACTS = 64


@dataclass(frozen=True)
class _BallPress:
    """A ball pressed into gel and dragged; the unit of pressure is the gel's shear modulus."""

    depth_mm: float
    drag_mm: tuple[float, float]
    thickness_mm: float

    def poses(self) -> list[Pose]:
        """Down in steps, then along in steps, ending at the origin."""
        x, y = self.drag_mm
        down, along = (int(np.ceil(way)) for way in (self.depth_mm / PRESS_STEP_MM, np.hypot(x, y) / DRAG_STEP_MM))
        presses = [Pose(-x, -y, self.depth_mm * (n + 1) / down) for n in range(down)]
        drags = [Pose(-x * (1 - (n + 1) / along), -y * (1 - (n + 1) / along), self.depth_mm) for n in range(along)]
        return presses + drags


@dataclass(frozen=True)
class BallPressModel:
    """The prediction for one observed press under a design."""

    observed: ObservedBallPress
    design: SensorDesign

    @cached_property
    def contacts(self) -> dict[_BallPress, Contact]:
        """Return the cache of the contacts that were solved last."""
        return {}

    def contact(self, press: _BallPress) -> Contact:
        """The skin under this press."""
        if press not in self.contacts:
            if len(self.contacts) >= KEPT_CONTACTS:
                self.contacts.pop(next(iter(self.contacts)))
            model = ContactModel(
                _gel_of_unit_modulus(press.thickness_mm, self.design.gel.poisson_ratio), FRICTION, EFFORT
            )
            *_, self.contacts[press] = model.follow(Ball(self.design.ball.radius_mm), press.poses())
        return self.contacts[press]

    def columns(self, vector: ParameterVector) -> Float[Array, "n 3"]:
        """What level, dark and bright slope are multiplied by to give the brightness at each observed point."""
        named = dict(zip(PARAMETER_NAMES, vector.tolist(), strict=True))
        seen = self.seen_mm(named)
        diffuse = blur_and_refine_fields(PATCH, named["point_spread_mm"], *self.laws(seen, named["saturation"]))
        at = grid_coordinates(PATCH, self.observed.middle_mm, *self.observed.points_mm, REFINEMENT)
        dark, bright = (sample_periodic(field, *at) for field in diffuse)
        return np.column_stack([np.ones(dark.size), dark.ravel(), bright.ravel()])

    def seen_mm(self, named: dict[str, float]) -> Float32[Array, "rows cols"]:
        """Height of the skin as the plane shows it, on a grid around the middle of the observed press."""
        height = np.asarray(self.contact(ball_press_of(named)).height_mm, np.float32)
        x, y = (
            np.ascontiguousarray(axis + middle, np.float32)
            for axis, middle in zip(PATCH.positions_mm, self.observed.middle_mm, strict=True)
        )
        return SightlineGrid(x, y, named["inverse_distance_per_mm"]).height_mm(
            PATCH, (named["x_mm"], named["y_mm"]), height
        )

    def laws(
        self, height_mm: Float32[Array, "rows cols"], saturation: float
    ) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """Brightness by indentation and by bulge, for slopes of one."""
        thickness = self.design.gel.thickness_mm
        dark = saturating_response_mm(np.clip(height_mm, -thickness, 0), saturation, thickness)
        return dark.astype(np.float32), np.maximum(height_mm, 0)

    def fit_linear_terms(self, vector: ParameterVector) -> tuple[Float[Array, "3"], Float[Array, " n"]]:
        """The best level and slopes for these parameters, and what they leave unexplained, in grey levels."""
        columns, seen = self.columns(vector), self.observed.relative_brightness
        slopes = np.linalg.solve(columns.T @ columns, columns.T @ seen)
        return slopes, (seen - columns @ slopes) * self.observed.mean_grey


def ball_press_of(named: dict[str, float]) -> _BallPress:
    """Return the press that the mechanical parameters describe."""
    return _BallPress(named["depth_mm"], (named["drag_x_mm"], named["drag_y_mm"]), named["thickness_mm"])


@lru_cache(maxsize=64)
def _gel_of_unit_modulus(thickness_mm: float, poisson_ratio: float) -> Skin:
    """Gel of this thickness with a shear modulus of one."""
    from ninedtact.design import Gel

    gel = replace(Gel(), thickness_mm=thickness_mm, shear_modulus_mpa=1.0, poisson_ratio=poisson_ratio)
    return Skin(PATCH, lambda wave_number: bonded_layer_compliance(wave_number, gel), np.zeros((), np.float32))
