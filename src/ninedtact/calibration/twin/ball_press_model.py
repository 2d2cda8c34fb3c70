"""The forward model of a ball press: parameters → the predicted image, by contact mechanics, then light, then lines of sight.

The module defines the fitted parameters with their bounds and difference steps, the observation (brightness relative to the
reference image at points around the contact), and the model that predicts it. `ball_press_fit` fits the parameters.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.press_brightness import smooth_gaussian
from ninedtact.design import SensorDesign
from ninedtact.mechanics.alternating_solver import SolverSettings
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import finite_strain_ball_change_mm
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.layer_compliance import bonded_layer_compliance
from ninedtact.mechanics.periodic_grid import PeriodicGrid
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.surface_displacement import Skin
from ninedtact.quantities import Rectified, skin_grid_mm
from ninedtact.simulation.gel_brightness import darkening_equivalent_height_mm
from ninedtact.simulation.pixel_to_skin_map import (
    REFINEMENT,
    SightlineGrid,
    blur_and_refine_fields,
    grid_indices_at_positions,
    sample_periodic,
)


@dataclass(frozen=True)
class _FitParameter:
    """One parameter of the fit."""

    name: str
    least: float
    most: float
    step: float
    """Step of the difference quotient: small against the relevant scale, large against the solver's tolerance."""
    scale: float = 1.0
    moves_contact: bool = False
    """Whether the contact must be solved again when the parameter changes."""


FIT_PARAMETERS = (
    _FitParameter("x_mm", -12, 12, 0.02),
    _FitParameter("y_mm", -9, 9, 0.02),
    _FitParameter("depth_mm", 0.1, 3.0, 0.02, moves_contact=True),
    _FitParameter("drag_x_mm", -4, 4, 0.03, moves_contact=True),
    _FitParameter("drag_y_mm", -4, 4, 0.03, moves_contact=True),
    _FitParameter("thickness_mm", 0.8, 6.0, 0.03, moves_contact=True),
    _FitParameter("point_spread_mm", 0.05, 1.5, 0.02, 0.3),
    _FitParameter("saturation", 0.0, 5.0, 0.05, 0.5),
    _FitParameter("inverse_distance_per_mm", 0.0, 0.08, 0.004, 0.05),
    _FitParameter("finite_strain", 0.0, 1.0, 0.1, 0.5),
)
"""The parameters on which the image depends nonlinearly. Given them, three more are a linear problem: the level 1 + c, and (1 + c)
times the slopes of darkening and brightening.
"""
PARAMETER_NAMES = tuple(parameter.name for parameter in FIT_PARAMETERS)

ParameterVector = Float[Array, " parameters"]


def parameter_bounds() -> tuple[ParameterVector, ParameterVector]:
    """Return the lower and upper bounds of the searched parameters."""
    return np.array([p.least for p in FIT_PARAMETERS], float), np.array([p.most for p in FIT_PARAMETERS], float)


def parameter_scales() -> ParameterVector:
    """Return the relevant scale of each parameter."""
    return np.array([p.scale for p in FIT_PARAMETERS])


def perturb_parameter(vector: ParameterVector, index: int) -> tuple[ParameterVector, float]:
    """Return the vector with one parameter moved inside its bounds, and the step."""
    parameter = FIT_PARAMETERS[index]
    step = parameter.step if vector[index] + parameter.step < parameter.most else -parameter.step
    moved = vector.copy()
    moved[index] += step
    return moved, step


SMOOTHING_PX = 1.5
DIMMEST = 1.0


@dataclass(frozen=True)
class ObservedPress(ABC):
    """Two rectified images, before and after a press, of which pixels around the contact are fitted."""

    before: Rectified
    after: Rectified

    every_px: ClassVar[int]
    """Every how many rows and columns a pixel is fitted; smoothing has correlated neighbouring pixels."""

    @property
    @abstractmethod
    def chosen(self) -> Bool[Array, "rows cols"]:
        """The pixels that are fitted."""

    @cached_property
    def ratio(self) -> Float32[Array, "rows cols"]:
        """Smoothed brightness relative to the reference image."""
        return smooth_gaussian(self.after.grey / np.maximum(self.before.grey, DIMMEST), SMOOTHING_PX)

    @cached_property
    def place_mm(self) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """x and y of every pixel, by the lens with which the images were rectified."""
        return skin_grid_mm(self.before.grey.shape, self.before.mm_per_px)

    def thin_out(self, pixels: Bool[Array, "rows cols"]) -> Bool[Array, "rows cols"]:
        """Return those of the pixels that lie in every `every_px`-th row and column."""
        every = np.zeros_like(pixels)
        every[:: self.every_px, :: self.every_px] = True
        return np.asarray(pixels & every)

    @cached_property
    def relative_brightness(self) -> Float[Array, " n"]:
        """Relative brightness of the chosen pixels."""
        return self.ratio[self.chosen].astype(float)

    @property
    def mean_grey(self) -> float:
        """Mean brightness of the reference image, which converts relative brightness to grey levels."""
        return float(self.before.grey.mean())

    def image(self, values: Float[Array, " n"]) -> Float[Array, "few_rows few_cols"]:
        """Return values of the chosen pixels as a coarse image, not-a-number elsewhere."""
        whole = np.full(self.chosen.shape, np.nan)
        whole[self.chosen] = values
        return whole[:: self.every_px, :: self.every_px]


REACH_MM = 8.0
"""Radius around the contact within which the image is fitted."""


@dataclass(frozen=True)
class ObservedBallPress(ObservedPress):
    """A press of the ball, fitted around the contact."""

    middle_mm: tuple[float, float]
    """Approximate centre of the contact."""
    every_px: ClassVar[int] = 2

    @cached_property
    def chosen(self) -> Bool[Array, "rows cols"]:
        """The pixels that are fitted."""
        x, y = self.place_mm
        return self.thin_out(np.hypot(x - self.middle_mm[0], y - self.middle_mm[1]) < REACH_MM)

    @cached_property
    def points_mm(self) -> tuple[Float32[Array, "1 n"], Float32[Array, "1 n"]]:
        """x and y of the chosen pixels."""
        x, y = (axis[self.chosen][None] for axis in self.place_mm)
        return x, y

    @property
    def count(self) -> int:
        """Number of the chosen pixels."""
        return self.relative_brightness.size

    @property
    def blur_mm(self) -> float:
        """Standard deviation of the smoothing, which is part of the fitted point spread."""
        return SMOOTHING_PX * self.before.mm_per_px


PATCH = PeriodicGrid(128, 128, 0.2)
"""Square of 25.6 mm around the contact; the deformation beyond is negligible."""
ROUGH_PATCH = PeriodicGrid(64, 64, 0.4)
"""The same square at a quarter of the points, for the search from a distant start."""
FRICTION = 1.0
"""Coefficient of friction of silicone on a clean surface; between 0.5 and 1 the fit hardly changes."""
PRESS_STEP_MM, DRAG_STEP_MM = 0.5, 0.35
EFFORT = SolverSettings(tolerance=5e-4, must_converge=False)
KEPT_CONTACTS = 64


@dataclass(frozen=True)
class BallPressParameters:
    """A ball pressed into gel and dragged; pressures are in units of the gel's shear modulus."""

    depth_mm: float
    drag_mm: tuple[float, float]
    thickness_mm: float
    finite_strain: float = 0.0
    """Share of the difference between gel at finite strain and the linear layer."""

    def poses(self) -> list[Pose]:
        """Return the poses of the ball in its own frame: down in steps, then along in steps. Presses to different depths share
        their first steps, and presses that are dragged differently all steps down.
        """
        x, y = self.drag_mm
        along = int(np.ceil(np.hypot(x, y) / DRAG_STEP_MM))
        depths_mm = [*np.arange(PRESS_STEP_MM, self.depth_mm, PRESS_STEP_MM).tolist(), self.depth_mm]
        drags = [Pose(x * (n + 1) / along, y * (n + 1) / along, self.depth_mm) for n in range(along)]
        return [*(Pose(depth_mm=depth_mm) for depth_mm in depths_mm), *drags]


@dataclass(frozen=True)
class BallPressModel:
    """The predicted image of one observed press under a design."""

    observed: ObservedBallPress
    design: SensorDesign
    patch: PeriodicGrid = PATCH

    @cached_property
    def contacts(self) -> dict[tuple[float, tuple[Pose, ...]], Contact]:
        """Return the cache of the contacts that were solved last, by the thickness of the gel and the way of the ball."""
        return {}

    def contact(self, press: BallPressParameters) -> Contact:
        """Return the solved contact of the skin under this press, with the heights at finite strain."""
        linear = self._contact_after(press.thickness_mm, tuple(press.poses()))
        distance_mm = np.hypot(*self.patch.positions_mm)  # the fields move with the ball
        change_mm = finite_strain_ball_change_mm(
            distance_mm, self.design.ball.radius_mm, press.depth_mm, press.thickness_mm
        )
        return replace(
            linear, height_mm=linear.height_mm + np.float32(press.finite_strain) * change_mm.astype(np.float32)
        )

    def _contact_after(self, thickness_mm: float, way: tuple[Pose, ...]) -> Contact:
        """Return the contact after the ball took this way from the undeformed skin on."""
        if (thickness_mm, way) not in self.contacts:
            model = ContactModel(
                _gel_of_unit_modulus(self.patch, thickness_mm, self.design.gel.poisson_ratio), FRICTION, EFFORT
            )
            last = self._contact_after(thickness_mm, way[:-1]) if len(way) > 1 else model.initial_contact()
            if len(self.contacts) >= KEPT_CONTACTS:
                self.contacts.pop(next(iter(self.contacts)))
            self.contacts[thickness_mm, way] = model.step(last, Ball(self.design.ball.radius_mm), way[-1])
        return self.contacts[thickness_mm, way]

    def columns(self, vector: ParameterVector) -> Float[Array, "n 3"]:
        """Return the coefficients of level, dark slope and bright slope in the brightness at each observed point."""
        named = dict(zip(PARAMETER_NAMES, vector.tolist(), strict=True))
        seen = self.seen_mm(named)
        diffuse = blur_and_refine_fields(self.patch, named["point_spread_mm"], *self.laws(seen, named["saturation"]))
        at = grid_indices_at_positions(self.patch, self.observed.middle_mm, *self.observed.points_mm, REFINEMENT)
        dark, bright = (sample_periodic(field, *at) for field in diffuse)
        return np.column_stack([np.ones(dark.size), dark.ravel(), bright.ravel()])

    def seen_mm(self, named: dict[str, float]) -> Float32[Array, "rows cols"]:
        """Return the height of the skin on every line of sight, on a grid around the centre of the observed press."""
        height = np.asarray(self.contact(extract_press_parameters(named)).height_mm, np.float32)
        x, y = (
            np.ascontiguousarray(axis + middle, np.float32)
            for axis, middle in zip(self.patch.positions_mm, self.observed.middle_mm, strict=True)
        )
        return SightlineGrid(x, y, named["inverse_distance_per_mm"]).height_mm(
            self.patch, (named["x_mm"], named["y_mm"]), height
        )

    def laws(
        self, height_mm: Float32[Array, "rows cols"], saturation: float
    ) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """Return the brightness by indentation and by bulge, for slopes of one."""
        thickness = self.design.gel.thickness_mm
        dark = darkening_equivalent_height_mm(np.clip(height_mm, -thickness, 0), saturation, thickness)
        return dark.astype(np.float32), np.maximum(height_mm, 0)

    def fit_linear_terms(self, vector: ParameterVector) -> tuple[Float[Array, "3"], Float[Array, " n"]]:
        """Return the best level and slopes for these parameters, and their residual in grey levels."""
        columns, seen = self.columns(vector), self.observed.relative_brightness
        slopes = np.linalg.solve(columns.T @ columns, columns.T @ seen)
        return slopes, (seen - columns @ slopes) * self.observed.mean_grey


def extract_press_parameters(named: dict[str, float]) -> BallPressParameters:
    """Return the press that the mechanical parameters describe."""
    drag_mm = named["drag_x_mm"], named["drag_y_mm"]
    return BallPressParameters(named["depth_mm"], drag_mm, named["thickness_mm"], named["finite_strain"])


@lru_cache(maxsize=64)
def _gel_of_unit_modulus(patch: PeriodicGrid, thickness_mm: float, poisson_ratio: float) -> Skin:
    """Return gel of this thickness with a shear modulus of one."""
    from ninedtact.design import Gel

    gel = replace(Gel(), thickness_mm=thickness_mm, shear_modulus_mpa=1.0, poisson_ratio=poisson_ratio)
    return Skin(patch, lambda wave_number: bonded_layer_compliance(wave_number, gel), np.zeros((), np.float32))
