"""The forward models of the two presses that calibrate a twin: parameters of the press → the predicted image, by contact mechanics,
then light, then lines of sight. `BallPressModel` is linear in level and slopes of the brightness, `BoardPressModel` has a light.

`ninedtact.calibration` fits their parameters to images.
"""

from dataclasses import astuple, dataclass, replace
from functools import cached_property, lru_cache, partial

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.design import Gel, PinBoard, SensorDesign
from ninedtact.mechanics.contact_model import ContactModel, SolverSettings
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import correct_for_finite_strain
from ninedtact.mechanics.height_grid_indenter import HeightGridIndenter
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.layer_compliance import bonded_layer_compliance
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, Skin, padded_grid
from ninedtact.simulation.calibration_images import GRID_POINTS_PER_PIN_PITCH, pin_board_indenter
from ninedtact.simulation.gel_brightness import BrightnessModel, darkening_equivalent_height_mm
from ninedtact.simulation.pixel_to_skin_map import (
    REFINEMENT,
    SightlineGrid,
    blur_and_refine_fields,
    grid_indices_at_positions,
    sample_periodic,
)

Field = Float32[Array, "rows cols"]
Points = Float[Array, "n 2"]
ParameterVector = Float[Array, " parameters"]
_PRESS_STEP_MM = 0.5
_DRAG_STEP_MM = 0.35
_BOARD_MARGIN_MM = 5.0
"""Width of the skin beyond the outermost pins."""
_BOARD_SOLVER_SETTINGS = SolverSettings(tolerance=1e-3, must_converge=False)


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
        return cls(*vector.tolist())

    @property
    def vector(self) -> ParameterVector:
        """The parameters as a vector, in the order of the fields."""
        return np.array(astuple(self))

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


PATCH = PeriodicGrid(128, 128, 0.2)
"""Square of 25.6 mm around the contact; the deformation beyond is negligible."""
COARSE_PATCH = PeriodicGrid(64, 64, 0.4)
"""The same square at a quarter of the points, for the search from a distant start."""
_FRICTION = 1.0
"""Coefficient of friction of silicone on a clean surface; between 0.5 and 1 the fit hardly changes."""
_BALL_SOLVER_SETTINGS = SolverSettings(tolerance=5e-4, must_converge=False)
_MAX_CACHED_CONTACTS = 64


@dataclass(frozen=True)
class BallPressModel:
    """The predicted image of a press of a design's ball."""

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
            model = ContactModel(gel, _FRICTION, _BALL_SOLVER_SETTINGS)
            is_first = len(trajectory) == 1
            previous = model.initial_contact() if is_first else self._contact_after(thickness_mm, trajectory[:-1])
            if len(self.cached_contacts) >= _MAX_CACHED_CONTACTS:
                self.cached_contacts.pop(next(iter(self.cached_contacts)))
            guesses = self.initial_contacts[len(trajectory) - 1 :]
            guess = guesses[0] if guesses else None
            self.cached_contacts[key] = model.step(previous, Ball(self.design.ball.radius_mm), trajectory[-1], guess)
        return self.cached_contacts[key]

    def linear_basis(
        self, press: BallPressParameters, about_mm: tuple[float, float], points_mm: tuple[Field, Field]
    ) -> Float[Array, "n 3"]:
        """Return the coefficients of level, darkening slope and brightening slope in the brightness at points (x, y) of the plane.

        about_mm: the middle of the grid on which the image is predicted, near the contact.
        """
        height_mm = np.asarray(self.contact(press).height_mm, np.float32)
        x, y = (
            np.ascontiguousarray(axis + centre, np.float32)
            for axis, centre in zip(self.patch.positions_mm, about_mm, strict=True)
        )
        sightlines = SightlineGrid(x, y, press.inverse_distance_per_mm)
        terms = self.brightness_terms(sightlines.height_mm(self.patch, press.centre_mm, height_mm), press.saturation)
        blurred = blur_and_refine_fields(self.patch, press.point_spread_mm, *terms)
        indices = grid_indices_at_positions(self.patch, about_mm, *points_mm, REFINEMENT)
        darkening, brightening = (sample_periodic(field, *indices).ravel() for field in blurred)
        return np.column_stack([np.ones(darkening.size), darkening, brightening])

    def brightness_terms(
        self, height_mm: Float32[Array, "rows cols"], saturation: float
    ) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """Return the darkening by indentation and the brightening by bulges, for slopes of one."""
        thickness_mm = self.design.gel.thickness_mm
        indentation_mm = np.clip(height_mm, -thickness_mm, 0)
        darkening = darkening_equivalent_height_mm(indentation_mm, saturation, thickness_mm)
        return darkening.astype(np.float32), np.maximum(height_mm, 0)


@lru_cache(maxsize=64)
def _gel_of_unit_modulus(patch: PeriodicGrid, thickness_mm: float, poisson_ratio: float) -> Skin:
    """Return gel of this thickness with a shear modulus of one."""
    gel = replace(Gel(), thickness_mm=thickness_mm, shear_modulus_mpa=1.0, poisson_ratio=poisson_ratio)
    return Skin(patch, partial(bonded_layer_compliance, gel=gel), np.zeros((), np.float32))


@dataclass(frozen=True)
class BoardPressParameters:
    """One press of the board, and the distance from which it is seen."""

    depth_mm: float
    tilt_x_rad: float
    tilt_y_rad: float
    poisson_ratio: float
    """Poisson's ratio of the gel. A board loads all the gel at once, so that its small compressibility matters, unlike
    under a ball.
    """
    inverse_distance_per_mm: float
    point_spread_mm: float
    """Standard deviation of the point spread. The ball image determines it already; a different value means that the board differs
    from the model.
    """

    @classmethod
    def from_vector(cls, vector: Float[Array, "6"]) -> "BoardPressParameters":
        """Return the parameters from a vector in the order of the fields."""
        return cls(*vector.tolist())

    @property
    def vector(self) -> Float[Array, "6"]:
        """The parameters as a vector in the order of the fields, which is that of the columns of a Jacobian."""
        return np.array(astuple(self))


@dataclass(frozen=True)
class PredictedBrightnessField:
    """Relative change of brightness on the undeformed plane, finely sampled."""

    patch: PeriodicGrid
    field: Float32[Array, "fine_rows fine_cols"]

    def at(self, points_mm: Points) -> Float[Array, " n"]:
        """Return the field at points of the plane, by linear interpolation."""
        x, y = (np.ascontiguousarray(axis[None], np.float32) for axis in points_mm.T)
        indices = grid_indices_at_positions(self.patch, (0.0, 0.0), x, y, REFINEMENT)
        return sample_periodic(self.field, *indices)[0].astype(float)

    def to_px(self, points_mm: Points) -> Points:
        """Return column and row of the field, a projection without a lens."""
        x, y = points_mm.T
        return np.column_stack(grid_indices_at_positions(self.patch, (0.0, 0.0), x, y, REFINEMENT))


@dataclass(frozen=True)
class BoardPressModel:
    """The predicted image of a press of the pin board on gel in a light."""

    gel: Gel
    """The gel, but for its modulus, on which heights do not depend, and Poisson's ratio, which is one of the parameters."""
    light: BrightnessModel
    board: PinBoard
    points_per_pitch: int = GRID_POINTS_PER_PIN_PITCH

    @cached_property
    def indenter(self) -> HeightGridIndenter:
        """The height of the board's underside on a grid."""
        return pin_board_indenter(self.board)

    @cached_property
    def patch(self) -> PeriodicGrid:
        """The modelled area: the pins, the floor around them, and skin beyond."""
        pitch_mm = self.board.pitch_mm
        width_mm = self.board.cols * pitch_mm
        height_mm = self.board.rows * pitch_mm
        return padded_grid(width_mm, height_mm, pitch_mm / self.points_per_pitch, _BOARD_MARGIN_MM)

    @cached_property
    def cached_height_mm(self) -> dict[tuple[float, ...], Field]:
        """The height that was solved last, by the parameters of the contact; those of the view change more often."""
        return {}

    def height_mm(self, press: BoardPressParameters) -> Field:
        """Return the height of the skin under the board, from the cache where possible."""
        key = press.depth_mm, press.tilt_x_rad, press.tilt_y_rad, press.poisson_ratio
        if key not in self.cached_height_mm:
            self.cached_height_mm.clear()
            self.cached_height_mm[key] = self.solve_height_mm(press)
        return self.cached_height_mm[key]

    def solve_height_mm(self, press: BoardPressParameters) -> Field:
        """Solve the contact and return the height of the skin under the board."""
        skin = _gel_of_unit_modulus(self.patch, self.gel.thickness_mm, press.poisson_ratio)
        model = ContactModel(skin, _FRICTION, _BOARD_SOLVER_SETTINGS)
        pose = Pose(0.0, 0.0, press.depth_mm, 0.0, press.tilt_x_rad, press.tilt_y_rad)
        return np.asarray(model.step(model.initial_contact(), self.indenter, pose).height_mm, np.float32)

    def predict_image(self, press: BoardPressParameters) -> PredictedBrightnessField:
        """Return the brightness of the skin on the undeformed plane, in the twin's light."""
        x, y = (np.ascontiguousarray(axis, np.float32) for axis in self.patch.positions_mm)
        sightlines = SightlineGrid(x, y, press.inverse_distance_per_mm)
        seen_mm = sightlines.height_mm(self.patch, (0.0, 0.0), self.height_mm(press))
        change = self.light.brightness_change(seen_mm).astype(np.float32)
        (field,) = blur_and_refine_fields(self.patch, press.point_spread_mm, change)
        return PredictedBrightnessField(self.patch, field)
