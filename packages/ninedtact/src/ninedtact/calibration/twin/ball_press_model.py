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

from ninedtact.calibration.press_brightness import relative_brightness, smooth_gaussian
from ninedtact.design import SensorDesign
from ninedtact.mechanics.alternating_solver import SolverSettings
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import correct_for_finite_strain
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
    lower_bound: float
    upper_bound: float
    difference_step: float
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
"""How `BallPressParameters` are searched. Given them, three more are a linear problem: the level 1 + c, and (1 + c) times the
slopes of darkening and brightening.
"""
PARAMETER_NAMES = tuple(parameter.name for parameter in FIT_PARAMETERS)

ParameterVector = Float[Array, " parameters"]
"""The parameters in the order of `FIT_PARAMETERS`."""

_PRESS_STEP_MM = 0.5
_DRAG_STEP_MM = 0.35


@dataclass(frozen=True)
class BallPressParameters:
    """A ball pressed into gel and dragged, and how it is seen: the parameters on which the image depends nonlinearly."""

    x_mm: float
    y_mm: float
    depth_mm: float
    drag_x_mm: float
    drag_y_mm: float
    thickness_mm: float
    point_spread_mm: float
    saturation: float
    inverse_distance_per_mm: float
    finite_strain: float
    """Share of the difference between gel at finite strain and the linear layer."""

    @classmethod
    def from_vector(cls, vector: ParameterVector) -> "BallPressParameters":
        """Return the parameters from a vector."""
        return cls(**dict(zip(PARAMETER_NAMES, vector.tolist(), strict=True)))

    @property
    def vector(self) -> ParameterVector:
        """The parameters as a vector."""
        return np.array([getattr(self, name) for name in PARAMETER_NAMES])

    @property
    def centre_mm(self) -> tuple[float, float]:
        """x and y of the centre of the contact on the skin."""
        return self.x_mm, self.y_mm

    @property
    def drag_mm(self) -> tuple[float, float]:
        """Displacement of the ball along the skin after the press."""
        return self.drag_x_mm, self.drag_y_mm

    def poses(self) -> list[Pose]:
        """Return the poses of the ball in its own frame: down in steps, then sideways in steps. Presses to different depths share
        their first steps, and presses that are dragged differently all steps down.
        """
        x, y = self.drag_mm
        drag_steps = int(np.ceil(np.hypot(x, y) / _DRAG_STEP_MM))
        depths_mm = [*np.arange(_PRESS_STEP_MM, self.depth_mm, _PRESS_STEP_MM).tolist(), self.depth_mm]
        presses = [Pose(depth_mm=depth_mm) for depth_mm in depths_mm]
        drags = [Pose(x * n / drag_steps, y * n / drag_steps, self.depth_mm) for n in range(1, drag_steps + 1)]
        return [*presses, *drags]


def parameter_bounds() -> tuple[ParameterVector, ParameterVector]:
    """Return the lower and upper bounds of the searched parameters."""
    lower = np.array([parameter.lower_bound for parameter in FIT_PARAMETERS], float)
    upper = np.array([parameter.upper_bound for parameter in FIT_PARAMETERS], float)
    return lower, upper


def parameter_scales() -> ParameterVector:
    """Return the relevant scale of each parameter."""
    return np.array([p.scale for p in FIT_PARAMETERS])


def perturb_parameter(vector: ParameterVector, index: int) -> tuple[ParameterVector, float]:
    """Return the vector with one parameter moved inside its bounds, and the step."""
    parameter = FIT_PARAMETERS[index]
    step = parameter.difference_step
    if vector[index] + step >= parameter.upper_bound:
        step = -step
    perturbed = vector.copy()
    perturbed[index] += step
    return perturbed, step


_SMOOTHING_PX = 1.5


@dataclass(frozen=True)
class ObservedPress(ABC):
    """Two rectified images, before and after a press, of which pixels around the contact are fitted."""

    before: Rectified
    after: Rectified

    stride_px: ClassVar[int]
    """Distance of the fitted pixels in rows and columns; smoothing has correlated neighbouring pixels."""

    @property
    @abstractmethod
    def fitted_pixels(self) -> Bool[Array, "rows cols"]:
        """The pixels that are fitted."""

    @cached_property
    def ratio(self) -> Float32[Array, "rows cols"]:
        """Smoothed brightness relative to the reference image."""
        return smooth_gaussian(relative_brightness(self.after, self.before), _SMOOTHING_PX)

    @cached_property
    def positions_mm(self) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """x and y of every pixel, by the lens with which the images were rectified."""
        return skin_grid_mm(self.before.grey.shape, self.before.mm_per_px)

    def thin_out(self, pixels: Bool[Array, "rows cols"]) -> Bool[Array, "rows cols"]:
        """Return those of the pixels that lie in every `stride_px`-th row and column."""
        lattice = np.zeros_like(pixels)
        lattice[:: self.stride_px, :: self.stride_px] = True
        return np.asarray(pixels & lattice)

    @cached_property
    def relative_brightness(self) -> Float[Array, " n"]:
        """Relative brightness of the fitted pixels."""
        return self.ratio[self.fitted_pixels].astype(float)

    @property
    def mean_grey(self) -> float:
        """Mean brightness of the reference image, which converts relative brightness to grey levels."""
        return float(self.before.grey.mean())

    def image(self, values: Float[Array, " n"]) -> Float[Array, "few_rows few_cols"]:
        """Return values of the fitted pixels as a coarse image, not-a-number elsewhere."""
        image = np.full(self.fitted_pixels.shape, np.nan)
        image[self.fitted_pixels] = values
        return image[:: self.stride_px, :: self.stride_px]


REACH_MM = 8.0
"""Radius around the contact within which the image is fitted."""


@dataclass(frozen=True)
class ObservedBallPress(ObservedPress):
    """A press of the ball, fitted around the contact."""

    centre_mm: tuple[float, float]
    """Approximate centre of the contact."""
    stride_px: ClassVar[int] = 2

    @cached_property
    def fitted_pixels(self) -> Bool[Array, "rows cols"]:
        """The pixels that are fitted."""
        x, y = self.positions_mm
        return self.thin_out(np.hypot(x - self.centre_mm[0], y - self.centre_mm[1]) < REACH_MM)

    @cached_property
    def points_mm(self) -> tuple[Float32[Array, "1 n"], Float32[Array, "1 n"]]:
        """x and y of the fitted pixels."""
        x, y = (axis[self.fitted_pixels][None] for axis in self.positions_mm)
        return x, y

    @property
    def count(self) -> int:
        """Number of the fitted pixels."""
        return self.relative_brightness.size

    @property
    def blur_mm(self) -> float:
        """Standard deviation of the smoothing, which is part of the fitted point spread."""
        return _SMOOTHING_PX * self.before.mm_per_px


PATCH = PeriodicGrid(128, 128, 0.2)
"""Square of 25.6 mm around the contact; the deformation beyond is negligible."""
COARSE_PATCH = PeriodicGrid(64, 64, 0.4)
"""The same square at a quarter of the points, for the search from a distant start."""
FRICTION = 1.0
"""Coefficient of friction of silicone on a clean surface; between 0.5 and 1 the fit hardly changes."""
SOLVER_SETTINGS = SolverSettings(tolerance=5e-4, must_converge=False)
MAX_CACHED_CONTACTS = 64


@dataclass(frozen=True)
class BallPressModel:
    """The predicted image of one observed press under a design."""

    observed: ObservedBallPress
    design: SensorDesign
    patch: PeriodicGrid = PATCH
    initial_contacts: tuple[Contact, ...] = ()
    """The contacts of a similar press after each of its poses, whose tractions are first guesses. Without them the search for a
    contact starts from the contact before it."""

    @cached_property
    def cached_contacts(self) -> dict[tuple[float, tuple[Pose, ...]], Contact]:
        """The contacts that were solved last, by the thickness of the gel and the trajectory of the ball."""
        return {}

    def starting_from(self, press: BallPressParameters) -> "BallPressModel":
        """Return the same model with the contacts of this press as first guesses, which save iterations for similar presses."""
        poses = press.poses()
        trajectories = [tuple(poses[: count + 1]) for count in range(len(poses))]
        contacts = tuple(self._contact_after(press.thickness_mm, trajectory) for trajectory in trajectories)
        model = replace(self, initial_contacts=contacts)
        model.cached_contacts.update(((press.thickness_mm, t), c) for t, c in zip(trajectories, contacts, strict=True))
        return model

    def contact(self, press: BallPressParameters) -> Contact:
        """Return the solved contact of the skin under this press, with the heights at finite strain, and pressures in units of the
        gel's shear modulus.
        """
        linear = self._contact_after(press.thickness_mm, tuple(press.poses()))
        ball = Ball(self.design.ball.radius_mm)
        return correct_for_finite_strain(linear, press.thickness_mm, ball, press.finite_strain)

    def _contact_after(self, thickness_mm: float, trajectory: tuple[Pose, ...]) -> Contact:
        """Return the contact after this trajectory of the ball from the undeformed skin on."""
        key = thickness_mm, trajectory
        if key not in self.cached_contacts:
            gel = _gel_of_unit_modulus(self.patch, thickness_mm, self.design.gel.poisson_ratio)
            model = ContactModel(gel, FRICTION, SOLVER_SETTINGS)
            is_first = len(trajectory) == 1
            previous = model.initial_contact() if is_first else self._contact_after(thickness_mm, trajectory[:-1])
            if len(self.cached_contacts) >= MAX_CACHED_CONTACTS:
                self.cached_contacts.pop(next(iter(self.cached_contacts)))
            guesses = self.initial_contacts[len(trajectory) - 1 :]
            guess = guesses[0] if guesses else None
            self.cached_contacts[key] = model.step(previous, Ball(self.design.ball.radius_mm), trajectory[-1], guess)
        return self.cached_contacts[key]

    def linear_basis(self, press: BallPressParameters) -> Float[Array, "n 3"]:
        """Return the coefficients of level, darkening slope and brightening slope in the brightness at each observed point."""
        terms = self.brightness_terms(self.sightline_height_mm(press), press.saturation)
        blurred = blur_and_refine_fields(self.patch, press.point_spread_mm, *terms)
        indices = grid_indices_at_positions(self.patch, self.observed.centre_mm, *self.observed.points_mm, REFINEMENT)
        darkening, brightening = (sample_periodic(field, *indices).ravel() for field in blurred)
        return np.column_stack([np.ones(darkening.size), darkening, brightening])

    def sightline_height_mm(self, press: BallPressParameters) -> Float32[Array, "rows cols"]:
        """Return the height of the skin on every line of sight, on a grid around the centre of the observed press."""
        height_mm = np.asarray(self.contact(press).height_mm, np.float32)
        x, y = (
            np.ascontiguousarray(axis + centre, np.float32)
            for axis, centre in zip(self.patch.positions_mm, self.observed.centre_mm, strict=True)
        )
        return SightlineGrid(x, y, press.inverse_distance_per_mm).height_mm(self.patch, press.centre_mm, height_mm)

    def brightness_terms(
        self, height_mm: Float32[Array, "rows cols"], saturation: float
    ) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """Return the darkening by indentation and the brightening by bulges, for slopes of one."""
        thickness_mm = self.design.gel.thickness_mm
        indentation_mm = np.clip(height_mm, -thickness_mm, 0)
        darkening = darkening_equivalent_height_mm(indentation_mm, saturation, thickness_mm)
        return darkening.astype(np.float32), np.maximum(height_mm, 0)

    def fit_linear_terms(self, vector: ParameterVector) -> tuple[Float[Array, "3"], Float[Array, " n"]]:
        """Return the best level and slopes for these parameters, and their residual in grey levels, observed minus predicted."""
        basis = self.linear_basis(BallPressParameters.from_vector(vector))
        observed = self.observed.relative_brightness
        coefficients = np.linalg.solve(basis.T @ basis, basis.T @ observed)
        return coefficients, (observed - basis @ coefficients) * self.observed.mean_grey


@lru_cache(maxsize=64)
def _gel_of_unit_modulus(patch: PeriodicGrid, thickness_mm: float, poisson_ratio: float) -> Skin:
    """Return gel of this thickness with a shear modulus of one."""
    from ninedtact.design import Gel

    gel = replace(Gel(), thickness_mm=thickness_mm, shear_modulus_mpa=1.0, poisson_ratio=poisson_ratio)
    return Skin(patch, lambda wave_number: bonded_layer_compliance(wave_number, gel), np.zeros((), np.float32))
