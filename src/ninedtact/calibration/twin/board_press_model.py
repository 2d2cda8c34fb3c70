"""The board's image as numbers to fit: brightness relative to untouched skin at points among the pins.

How deep the board is pressed, and how it is seen → the image that a twin predicts, on the skin's untouched plane.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.board.board_fit import BoardFit
from ninedtact.calibration.board.pin_imprints import IMPRINT_RADIUS, locate_imprints_mm
from ninedtact.calibration.brightness import smooth_gaussian
from ninedtact.calibration.twin.ball_press_fit import TwinFit
from ninedtact.calibration.twin.ball_press_model import DIMMEST, FRICTION, SMOOTHING_PX
from ninedtact.design import PinBoard
from ninedtact.mechanics.alternating_solver import SolverSettings
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.height_grid_indenter import HeightGridIndenter
from ninedtact.mechanics.layer_compliance import bonded_layer_compliance
from ninedtact.mechanics.periodic_grid import PeriodicGrid, padded_grid
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import Skin
from ninedtact.quantities import Rectified
from ninedtact.shape.lens import Points
from ninedtact.shape.rectification import skin_grid_mm
from ninedtact.simulation.calibration_images import GRID_POINTS_PER_PIN_PITCH, pin_board_indenter
from ninedtact.simulation.pixel_map import (
    REFINEMENT,
    SightlineGrid,
    blur_and_refine_fields,
    grid_coordinates,
    sample_periodic,
)

AROUND = 0.6
"""How far around a pin the image is fitted, in pitches: up to half-way to the next one, and a little over."""
EVERY_PX = 3
"""Of rows and columns."""
LEAST_SPREAD = 0.1
"""Of the middle's pixels per square millimetre: a lens fitted to pins may fold the image over beyond the outermost."""


@dataclass(frozen=True)
class ObservedBoardPress:
    """Two rectified images, before and under the board."""

    before: Rectified
    after: Rectified
    board: BoardFit

    @cached_property
    def chosen(self) -> Bool[Array, "rows cols"]:
        """The pixels that are fitted: among the pins, and away from those that were not seen."""
        x, y = skin_grid_mm(self.before.grey.shape, self.before.mm_per_px)
        design, away = self.board.board, AROUND * self.board.board.pitch_mm
        half_x, half_y = ((count - 1) / 2 * design.pitch_mm + away for count in (design.cols, design.rows))
        among = (np.abs(x) < half_x) & (np.abs(y) < half_y)
        for pin_x, pin_y in self.board.points_mm[~self.board.found].tolist():
            among &= np.hypot(x - pin_x, y - pin_y) > away
        every = np.zeros_like(among)
        every[::EVERY_PX, ::EVERY_PX] = True
        among &= every
        among[among] = self.pixel_density(np.column_stack([x[among], y[among]])) > LEAST_SPREAD
        return np.asarray(among)

    def pixel_density(self, points_mm: Points) -> Float[Array, " n"]:
        """Pixels of the raw image per square millimetre there, over that in the middle; below zero where it is folded over."""
        lens = self.board.lens
        here, middle = (np.linalg.det(lens.px_per_mm(points)) for points in (points_mm, np.zeros((1, 2))))
        return np.asarray(here / middle)

    @cached_property
    def points_mm(self) -> Points:
        """Of the chosen pixels, as the lens has them that the images were rectified with."""
        axes = skin_grid_mm(self.before.grey.shape, self.before.mm_per_px)
        return np.column_stack([axis[self.chosen] for axis in axes]).astype(float)

    @cached_property
    def relative_brightness(self) -> Float[Array, " n"]:
        """Relative brightness of the chosen pixels."""
        ratio: Float32[Array, "rows cols"] = smooth_gaussian(
            self.after.grey / np.maximum(self.before.grey, DIMMEST), SMOOTHING_PX
        )
        return ratio[self.chosen].astype(float)

    @property
    def mean_grey(self) -> float:
        """Of the untouched image: what turns relative brightness into grey levels."""
        return float(self.before.grey.mean())

    def image(self, values: Float[Array, " n"]) -> Float[Array, "few_rows few_cols"]:
        """Values of the chosen pixels as a coarse image, not-a-number elsewhere."""
        whole = np.full(self.chosen.shape, np.nan)
        whole[self.chosen] = values
        return whole[::EVERY_PX, ::EVERY_PX]


MARGIN_MM = 5.0
"""Skin beyond the outermost pins."""
EFFORT = SolverSettings(tolerance=5e-3, must_converge=False)

Field = Float32[Array, "rows cols"]


@dataclass(frozen=True)
class BoardPressParameters:
    """One press of the board, and from how near it is seen."""

    depth_mm: float
    tilt_x_rad: float
    tilt_y_rad: float
    poisson_ratio: float
    """A board loads all the gel at once, so the little by which it yields in volume shows, as it does not under a ball."""
    inverse_distance_per_mm: float
    point_spread_mm: float
    """Standard deviation of the point-spread. The ball's image has told it: another one says that the board is not as drawn."""


@dataclass(frozen=True)
class PredictedBoardImage:
    """Relative change of brightness on the untouched plane, finely sampled."""

    patch: PeriodicGrid
    field: Float32[Array, "fine_rows fine_cols"]

    def at(self, points_mm: Points) -> Float[Array, " n"]:
        """At places of the plane, linearly."""
        x, y = (np.ascontiguousarray(axis[None], np.float32) for axis in points_mm.T)
        return sample_periodic(self.field, *grid_coordinates(self.patch, (0.0, 0.0), x, y, REFINEMENT))[0].astype(float)

    def to_px(self, points_mm: Points) -> Points:
        """Column and row of the field: a projection without a lens."""
        x, y = points_mm.T
        return np.column_stack(grid_coordinates(self.patch, (0.0, 0.0), x, y, REFINEMENT))


@dataclass(frozen=True)
class BoardPressModel:
    """The prediction for one board under a twin."""

    fit: TwinFit
    board: PinBoard

    @cached_property
    def relief(self) -> HeightGridIndenter:
        """Return the height of the board's underside on a grid."""
        return pin_board_indenter(self.board)

    @cached_property
    def patch(self) -> PeriodicGrid:
        """Pins, the floor around them, and skin beyond."""
        pitch_mm = self.board.pitch_mm
        width_mm, height_mm = (count * pitch_mm for count in (self.board.cols, self.board.rows))
        return padded_grid(width_mm, height_mm, pitch_mm / GRID_POINTS_PER_PIN_PITCH, MARGIN_MM)

    @cached_property
    def heights(self) -> dict[BoardPressParameters, Field]:
        """The one solved last: how it is seen changes more often than how it is pressed."""
        return {}

    def height_mm(self, press: BoardPressParameters) -> Field:
        """Of the skin under the board."""
        unseen = replace(press, inverse_distance_per_mm=0.0, point_spread_mm=0.0)
        if unseen not in self.heights:
            self.heights.clear()
            self.heights[unseen] = self.solved_mm(unseen)
        return self.heights[unseen]

    def solved_mm(self, press: BoardPressParameters) -> Field:
        """The same, not yet solved."""
        gel = replace(
            self.fit.forward.design.gel,
            thickness_mm=self.fit.parameters["thickness_mm"],
            shear_modulus_mpa=1.0,
            poisson_ratio=press.poisson_ratio,
        )
        skin = Skin(self.patch, lambda wave_number: bonded_layer_compliance(wave_number, gel), np.zeros((), np.float32))
        model = ContactModel(skin, FRICTION, EFFORT)
        pose = Pose(0.0, 0.0, press.depth_mm, 0.0, press.tilt_x_rad, press.tilt_y_rad)
        return np.asarray(model.step(model.initial_contact(), self.relief, pose).height_mm, np.float32)

    def predict_image(self, press: BoardPressParameters) -> PredictedBoardImage:
        """The skin as the plane shows it, in the twin's light."""
        x, y = (np.ascontiguousarray(axis, np.float32) for axis in self.patch.positions_mm)
        seen = SightlineGrid(x, y, press.inverse_distance_per_mm).height_mm(
            self.patch, (0.0, 0.0), self.height_mm(press)
        )
        (field,) = blur_and_refine_fields(
            self.patch, press.point_spread_mm, self.fit.light.brightness_change(seen).astype(np.float32)
        )
        return PredictedBoardImage(self.patch, field)

    def imprints_mm(self, drawn: PredictedBoardImage, pins_mm: Points) -> Points:
        """Where on the plane the imprints of these pins are seen, found as in an image."""
        return locate_imprints_mm(drawn.field, drawn, pins_mm, IMPRINT_RADIUS * self.board.pitch_mm)
