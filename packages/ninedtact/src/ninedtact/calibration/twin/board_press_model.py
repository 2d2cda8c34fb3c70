"""The forward model of a board press: the depth of the board and how it is seen → the image that a twin predicts, on the skin's
undeformed plane.

`ObservedBoardPress` holds the observation, brightness relative to the reference image at points among the pins. `BoardPressModel`
predicts it; `calibration.twin.lens_refinement` fits the prediction to the observation.
"""

from dataclasses import astuple, dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.board.board_fit import BoardFit
from ninedtact.calibration.board.pin_imprint_centres import IMPRINT_RADIUS_PITCHES, locate_imprints_mm
from ninedtact.calibration.twin.ball_press_fit import TwinFit
from ninedtact.calibration.twin.ball_press_model import FRICTION, ObservedPress
from ninedtact.design import PinBoard
from ninedtact.mechanics.alternating_solver import SolverSettings
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.height_grid_indenter import HeightGridIndenter
from ninedtact.mechanics.layer_compliance import bonded_layer_compliance
from ninedtact.mechanics.periodic_grid import PeriodicGrid, padded_grid
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.surface_displacement import Skin
from ninedtact.shape.lens import Points, determinant_at_each_point
from ninedtact.simulation.calibration_images import GRID_POINTS_PER_PIN_PITCH, pin_board_indenter
from ninedtact.simulation.pixel_to_skin_map import (
    REFINEMENT,
    SightlineGrid,
    blur_and_refine_fields,
    grid_indices_at_positions,
    sample_periodic,
)

FIT_RADIUS_PITCHES = 0.6
"""Radius around a pin within which the image is fitted, in pitches: a little more than half-way to the next pin."""
MIN_PIXEL_DENSITY = 0.1
"""Smallest density of pixels per square millimetre, relative to the centre: a lens fitted to pins may fold the image over beyond
the outermost ones.
"""


@dataclass(frozen=True)
class ObservedBoardPress(ObservedPress):
    """A press of the board, fitted among the pins."""

    board: BoardFit
    stride_px: ClassVar[int] = 3

    @cached_property
    def fitted_pixels(self) -> Bool[Array, "rows cols"]:
        """The pixels that are fitted: among the pins, and away from undetected pins."""
        x, y = self.positions_mm
        design = self.board.board
        radius_mm = FIT_RADIUS_PITCHES * design.pitch_mm
        half_width_mm = (design.cols - 1) / 2 * design.pitch_mm + radius_mm
        half_height_mm = (design.rows - 1) / 2 * design.pitch_mm + radius_mm
        among_pins = (np.abs(x) < half_width_mm) & (np.abs(y) < half_height_mm)
        for pin_x, pin_y in self.board.points_mm[~self.board.found].tolist():
            among_pins &= np.hypot(x - pin_x, y - pin_y) > radius_mm
        fitted = self.thin_out(among_pins)
        fitted[fitted] = self.pixel_density(np.column_stack([x[fitted], y[fitted]])) > MIN_PIXEL_DENSITY
        return np.asarray(fitted)

    def pixel_density(self, points_mm: Points) -> Float[Array, " n"]:
        """Return the pixels of the raw image per square millimetre at these points, relative to the centre; negative where the
        image is folded over.
        """
        lens = self.board.lens
        density = determinant_at_each_point(lens.px_per_mm(points_mm))
        central_density = determinant_at_each_point(lens.px_per_mm(np.zeros((1, 2))))
        return np.asarray(density / central_density)

    @cached_property
    def points_mm(self) -> Points:
        """Positions of the fitted pixels."""
        return np.column_stack([axis[self.fitted_pixels] for axis in self.positions_mm]).astype(float)


MARGIN_MM = 5.0
"""Width of the skin beyond the outermost pins."""
SOLVER_SETTINGS = SolverSettings(tolerance=1e-3, must_converge=False)

Field = Float32[Array, "rows cols"]


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
    """The predicted image of one board under a twin."""

    twin_fit: TwinFit
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
        return padded_grid(width_mm, height_mm, pitch_mm / self.points_per_pitch, MARGIN_MM)

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
        gel = replace(
            self.twin_fit.forward.design.gel,
            thickness_mm=self.twin_fit.press.thickness_mm,
            shear_modulus_mpa=1.0,
            poisson_ratio=press.poisson_ratio,
        )
        skin = Skin(self.patch, lambda wave_number: bonded_layer_compliance(wave_number, gel), np.zeros((), np.float32))
        model = ContactModel(skin, FRICTION, SOLVER_SETTINGS)
        pose = Pose(0.0, 0.0, press.depth_mm, 0.0, press.tilt_x_rad, press.tilt_y_rad)
        return np.asarray(model.step(model.initial_contact(), self.indenter, pose).height_mm, np.float32)

    def predict_image(self, press: BoardPressParameters) -> PredictedBrightnessField:
        """Return the brightness of the skin on the undeformed plane, in the twin's light."""
        x, y = (np.ascontiguousarray(axis, np.float32) for axis in self.patch.positions_mm)
        sightlines = SightlineGrid(x, y, press.inverse_distance_per_mm)
        seen_mm = sightlines.height_mm(self.patch, (0.0, 0.0), self.height_mm(press))
        change = self.twin_fit.light.brightness_change(seen_mm).astype(np.float32)
        (field,) = blur_and_refine_fields(self.patch, press.point_spread_mm, change)
        return PredictedBrightnessField(self.patch, field)

    def imprints_mm(self, image: PredictedBrightnessField, pins_mm: Points) -> Points:
        """Return the positions on the plane at which the imprints of these pins appear, located as in a real image."""
        return locate_imprints_mm(image.field, image, pins_mm, IMPRINT_RADIUS_PITCHES * self.board.pitch_mm)
