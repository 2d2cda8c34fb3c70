"""The forward models of the two presses that calibrate a twin: parameters of the press → the predicted image, by contact mechanics,
then light, then lines of sight. `BallPressModel` is linear in level and slopes of the brightness, `BoardPressModel` has a light.

`ninedtact.calibration` fits their parameters to images.
"""

from dataclasses import astuple, dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.design import Gel, PinBoard, SensorDesign
from ninedtact.mechanics.contact_model import ContactModel, SolverSettings
from ninedtact.mechanics.contact_result import Contact, least_gel_mm, require_gel_left
from ninedtact.mechanics.finite_strain import correct_for_finite_strain
from ninedtact.mechanics.height_grid_indenter import HeightGridIndenter, indenter_from_heights
from ninedtact.mechanics.indenter import Ball, Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, Skin, padded_grid
from ninedtact.simulation.gel_brightness import BrightnessModel, darkening_equivalent_height_mm
from ninedtact.simulation.pixel_to_skin_map import (
    REFINEMENT,
    SightlineGrid,
    blur_and_refine_fields,
    grid_indices_at_positions,
    sample_periodic,
)
from ninedtact.simulation.twin import MARGIN_MM, PITCH_MM

BOARD_GRID_PITCH_MM = 0.05
GRID_POINTS_PER_PIN_PITCH = 20
"""Grid points per pitch of the pins; an integer, so that all pins lie alike on the grid."""
PIN_HEIGHT_MM = 1.5
"""Height of the pins over the floor of the published board."""

Field = Float32[Array, "rows cols"]
Points = Float[Array, "n 2"]
ParameterVector = Float[Array, " parameters"]
_DRAG_STEP_SHARE = 0.7
"""Longest step of a drag over that of a press."""
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
    gel_to_base_modulus_ratio: float

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

    def poses(self, step_mm: float) -> list[Pose]:
        """Return the poses of the ball in its own frame: down in steps, then sideways in steps. Presses to different depths share
        their first steps, and presses that are dragged differently all steps down.
        """
        x, y = self.drag_mm
        drag_steps = int(np.ceil(np.hypot(x, y) / (_DRAG_STEP_SHARE * step_mm)))
        depths_mm = [*np.arange(step_mm, self.depth_mm, step_mm).tolist(), self.depth_mm]
        presses = [Pose(depth_mm=depth_mm) for depth_mm in depths_mm]
        drags = [Pose(x * n / drag_steps, y * n / drag_steps, self.depth_mm) for n in range(1, drag_steps + 1)]
        return [*presses, *drags]


COARSE_PITCH_MM = 2 * PITCH_MM
"""Pitch at a quarter of the points, for the search from a distant start."""
STEP_MM = 0.5
COARSE_STEP_MM = 1.2
"""Steps in which a ball goes down, in which friction acts; the coarse ones are for the search from a distant start."""
_FRICTION = 1.0
"""Coefficient of friction of silicone on a clean surface; between 0.5 and 1 the fit hardly changes."""
_BALL_SOLVER_SETTINGS = SolverSettings(tolerance=2e-4, must_converge=False)
_MAX_CACHED_CONTACTS = 64


@dataclass(frozen=True)
class BallPressModel:
    """The predicted image of a press of a design's ball."""

    design: SensorDesign
    pitch_mm: float = PITCH_MM
    step_mm: float = STEP_MM
    indenter: Indenter | None = None
    """What is pressed; None for the design's ball."""
    initial_contacts: tuple[Contact, ...] = ()
    """The contacts of a similar press after each of its poses, whose tractions are first guesses. Without them the search for a
    contact starts from the contact before it."""

    @cached_property
    def patch(self) -> PeriodicGrid:
        """The skin about the contact, as large as that of a twin: on a base that yields, its size matters."""
        return padded_grid(*self.design.sensing_area.size_mm, self.pitch_mm, MARGIN_MM)

    @cached_property
    def cached_contacts(self) -> dict[tuple[Skin, tuple[Pose, ...]], Contact]:
        """The contacts that were solved last, by the skin and the trajectory of the ball."""
        return {}

    def starting_from(self, press: BallPressParameters) -> "BallPressModel":
        """Return the same model with the contacts of this press as first guesses, which save iterations for similar presses."""
        poses = press.poses(self.step_mm)
        trajectories = [tuple(poses[: count + 1]) for count in range(len(poses))]
        skin = self.skin(press)
        contacts = tuple(self._contact_after(skin, trajectory) for trajectory in trajectories)
        model = replace(self, initial_contacts=contacts)
        model.cached_contacts.update(((skin, t), c) for t, c in zip(trajectories, contacts, strict=True))
        return model

    def skin(self, press: BallPressParameters) -> Skin:
        """Return the skin of the design's gel with the thickness and the base of this press, and a shear modulus of one."""
        fitted = replace(
            self.design.gel,
            thickness_mm=press.thickness_mm,
            gel_to_base_modulus_ratio=press.gel_to_base_modulus_ratio,
            shear_modulus_mpa=1.0,
        )
        return _skin_of(self.patch, fitted)

    def contact(self, press: BallPressParameters) -> Contact:
        """Return the solved contact of the skin under this press at finite strain, with pressures in units of the gel's shear
        modulus; raises `InvalidPose` where nothing would be left of the gel.
        """
        contact = correct_for_finite_strain(self._contact_after(self.skin(press), tuple(press.poses(self.step_mm))))
        require_gel_left(contact.skin.gel, least_gel_mm(contact))
        return contact

    def _contact_after(self, skin: Skin, trajectory: tuple[Pose, ...]) -> Contact:
        """Return the contact after this trajectory of the ball from the undeformed skin on."""
        key = skin, trajectory
        if key not in self.cached_contacts:
            model = ContactModel(skin, _FRICTION, _BALL_SOLVER_SETTINGS)
            is_first = len(trajectory) == 1
            previous = model.initial_contact() if is_first else self._contact_after(skin, trajectory[:-1])
            if len(self.cached_contacts) >= _MAX_CACHED_CONTACTS:
                self.cached_contacts.pop(next(iter(self.cached_contacts)))
            guesses = self.initial_contacts[len(trajectory) - 1 :]
            guess = guesses[0] if guesses else None
            indenter = self.indenter or Ball(self.design.ball.radius_mm)
            self.cached_contacts[key] = model.step(previous, indenter, trajectory[-1], guess)
        return self.cached_contacts[key]

    def linear_basis(
        self, press: BallPressParameters, about_mm: tuple[float, float], points_mm: tuple[Field, Field]
    ) -> Float[Array, "n 3"]:
        """Return the coefficients of level, darkening slope and brightening slope in the brightness at points (x, y) of the plane.

        about_mm: the middle of the grid on which the image is predicted, near the contact.
        """
        contact = self.contact(press)
        height_mm, thicker_mm = (np.asarray(mm, np.float32) for mm in (contact.height_mm, contact.thickness_change_mm))
        x, y = (
            np.ascontiguousarray(axis + centre, np.float32)
            for axis, centre in zip(self.patch.positions_mm, about_mm, strict=True)
        )
        sightlines = SightlineGrid(x, y, press.inverse_distance_per_mm)
        seen_mm = sightlines.sample(self.patch, press.centre_mm, height_mm, thicker_mm)
        terms = self.brightness_terms(seen_mm, press.saturation)
        blurred = blur_and_refine_fields(self.patch, press.point_spread_mm, *terms)
        indices = grid_indices_at_positions(self.patch, about_mm, *points_mm, REFINEMENT)
        darkening, brightening = (sample_periodic(field, *indices).ravel() for field in blurred)
        return np.column_stack([np.ones(darkening.size), darkening, brightening])

    def brightness_terms(
        self, thickness_change_mm: Float32[Array, "rows cols"], saturation: float
    ) -> tuple[Float32[Array, "rows cols"], Float32[Array, "rows cols"]]:
        """Return the darkening of thinner and the brightening of thicker gel, for slopes of one."""
        thickness_mm = self.design.gel.thickness_mm
        thinner_mm = np.clip(thickness_change_mm, -thickness_mm, 0)
        darkening = darkening_equivalent_height_mm(thinner_mm, saturation, thickness_mm)
        return darkening.astype(np.float32), np.maximum(thickness_change_mm, 0)


@lru_cache(maxsize=64)
def _skin_of(patch: PeriodicGrid, gel: Gel) -> Skin:
    """Return the skin of a gel, whose operators are kept for the next call."""
    return Skin(patch, gel)


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
    def cached_contact(self) -> dict[tuple[float, ...], Contact]:
        """The contact that was solved last, by its parameters; those of the view change more often."""
        return {}

    def contact(self, press: BoardPressParameters) -> Contact:
        """Return the contact of the skin under the board, from the cache where possible."""
        key = press.depth_mm, press.tilt_x_rad, press.tilt_y_rad, press.poisson_ratio
        if key not in self.cached_contact:
            self.cached_contact.clear()
            self.cached_contact[key] = self.solve(press)
        return self.cached_contact[key]

    def solve(self, press: BoardPressParameters) -> Contact:
        """Return the contact of the skin under the board, solved anew."""
        gel = replace(self.gel, shear_modulus_mpa=1.0, poisson_ratio=press.poisson_ratio)
        model = ContactModel(_skin_of(self.patch, gel), _FRICTION, _BOARD_SOLVER_SETTINGS)
        pose = Pose(0.0, 0.0, press.depth_mm, 0.0, press.tilt_x_rad, press.tilt_y_rad)
        return correct_for_finite_strain(model.step(model.initial_contact(), self.indenter, pose))

    def predict_image(self, press: BoardPressParameters) -> PredictedBrightnessField:
        """Return the brightness of the skin on the undeformed plane, in the twin's light."""
        x, y = (np.ascontiguousarray(axis, np.float32) for axis in self.patch.positions_mm)
        sightlines = SightlineGrid(x, y, press.inverse_distance_per_mm)
        contact = self.contact(press)
        height_mm, thicker_mm = (np.asarray(mm, np.float32) for mm in (contact.height_mm, contact.thickness_change_mm))
        seen_mm = sightlines.sample(self.patch, (0.0, 0.0), height_mm, thicker_mm)
        change = self.light.brightness_change(seen_mm).astype(np.float32)
        (field,) = blur_and_refine_fields(self.patch, press.point_spread_mm, change)
        return PredictedBrightnessField(self.patch, field)


def pin_board_indenter(board: PinBoard) -> HeightGridIndenter:
    """Return the underside of a pin board: hemispheres on cylinders on a floor."""
    half = [(count - 1) / 2 * board.pitch_mm + board.pitch_mm / 2 for count in (board.cols, board.rows)]
    x, y = np.meshgrid(*(np.linspace(-reach, reach, round(2 * reach / BOARD_GRID_PITCH_MM) + 1) for reach in half))
    from_pin_x = _distance_to_nearest_pin_mm(x, board.cols, board.pitch_mm)
    from_pin = np.hypot(from_pin_x, _distance_to_nearest_pin_mm(y, board.rows, board.pitch_mm))
    radius = board.pin_diameter_mm / 2
    tip = radius - np.sqrt(np.maximum(radius**2 - from_pin**2, 0))
    return indenter_from_heights("pin_board", np.where(from_pin < radius, tip, PIN_HEIGHT_MM), BOARD_GRID_PITCH_MM)


def _distance_to_nearest_pin_mm(
    position_mm: Float[Array, "rows cols"], pins: int, pitch_mm: float
) -> Float[Array, "rows cols"]:
    index = np.clip(np.rint(position_mm / pitch_mm + (pins - 1) / 2), 0, pins - 1)
    return np.abs(position_mm - (index - (pins - 1) / 2) * pitch_mm)
