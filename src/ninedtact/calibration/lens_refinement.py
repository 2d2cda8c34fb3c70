"""How deep the imprints are, from how near they are seen, and the lens that takes both into account.

A pin presses the skin towards the camera, so that lines of sight that converge show its imprint farther out than the pin is: a
lens fitted to pins alone takes that for magnification. Here the twin that the ball told draws the whole board, and is fitted to the
board's image: its depth and tilt, the nearness of the eye, and the lens with them. What tells nearness from magnification is
the imprint's form: its bottom is displaced more than its rim. Gauss–Newton; the lens by the gradient of what was drawn.

Board and ball explained by one twin: each in turn with what the other told.

The ball's image tells light and gel, through a lens; the board's image, drawn in that light, tells how deep its imprints are
and from how near they are seen, and so the lens; the ball is fitted again through it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.ball.ball_fit import BallFit
from ninedtact.calibration.ball.contact_circle import BallPressUnusable
from ninedtact.calibration.board.board_fit import BoardFit
from ninedtact.calibration.board.lens_fit import fit_lens, lens_parameter_jacobian, refine_lens, with_radial_terms
from ninedtact.calibration.brightness import BgrImage
from ninedtact.calibration.twin.ball_press_fit import ParameterPrior, TwinFit, effective_observation_count
from ninedtact.calibration.twin.ball_press_model import ParameterVector
from ninedtact.calibration.twin.board_press_model import (
    BoardPressModel,
    BoardPressParameters,
    ObservedBoardPress,
    PredictedBoardImage,
)
from ninedtact.quantities import Frame
from ninedtact.shape.lens import LensModel, PointNotSeen, Points
from ninedtact.shape.rectification import Rectification

WORST_REST = 0.06
"""Part of the imprints' contrast that may stay unexplained, as of a ball's darkening (ball/judgement.py): boards whose pins are
unlike the design's, or unlike each other, tell nothing (real boards so far 0.045 and 0.06, drawn ones 0.01 to 0.045)."""
MOST_UNLIKE = 0.2
"""Relative difference of the scattering under pins and under the ball (real boards so far 0.5, drawn ones up to 0.1)."""
LENS_TERMS = 3
"""Radial terms: a whole image affords what 63 pins may not."""
START = BoardPressParameters(0.8, 0.0, 0.0, 0.495, 0.03, 0.5)
LEAST = BoardPressParameters(0.1, -0.1, -0.1, 0.35, 0.0, 0.1)
MOST_THICKNESS = 0.9
"""Of the gel, to which a board can be pressed."""
MOST_TILT, MOST_POISSON, MOST_NEARNESS, MOST_SCATTERING_MM = 0.1, 0.5, 0.1, 1.5
STEPS = {"inverse_distance_per_mm": 0.004, "point_spread_mm": 0.02, "depth_mm": 0.02, "poisson_ratio": -0.003}
"""Of difference quotients, those first for which the skin need not be solved; the tilt's follow from that of the depth."""
LARGEST = np.array([0.2, 0.02, 0.02, 0.01, 0.03, 0.2])
"""Of one round's change."""
SETTLED = np.array([2e-3, 2e-4, 2e-4, 2e-4, 2e-4, 2e-3])
ROUNDS, NEWTON = 12, 2
FEWER = 7
"""Of the observed points, for the lens that moves them as asked."""
GRADIENT_MM = 0.05
UNIT_MM, LIGHT_TERMS = 10.0, 3
"""For the light's slopes over the image."""


@dataclass(frozen=True)
class BoardPressFit:
    """What the board's image told."""

    press: BoardPressParameters
    deviation: BoardPressParameters
    lens: LensModel
    points: float
    """Observations that speak independently."""
    rest_grey: float
    """Root mean square of what is left unexplained."""
    contrast_grey_levels: float
    """Of the imprints."""
    ball_scattering_mm: float
    """As the ball's image had it."""
    settled: bool

    @property
    def accepted(self) -> bool:
        """Whether the board looks as the twin draws it, so that what it says is taken."""
        like_ball = abs(self.press.point_spread_mm / self.ball_scattering_mm - 1) <= MOST_UNLIKE
        return self.settled and like_ball and self.rest_grey <= WORST_REST * self.contrast_grey_levels

    @property
    def beliefs(self) -> tuple[ParameterPrior, ...]:
        """For the fit of the ball."""
        told = ParameterPrior(
            "inverse_distance_per_mm", self.press.inverse_distance_per_mm, self.deviation.inverse_distance_per_mm
        )
        return (told,) if self.accepted else ()


@dataclass(frozen=True)
class _LinearisedProblem:
    """One round: where it stands, and what moves it."""

    rest: Float[Array, " n"]
    """Grey levels."""
    slopes: Float[Array, "n parameters"]
    """By the press (as its fields), by the lens, by level and slopes of the light."""


@dataclass(frozen=True)
class _BoardPressSolver:
    """A board's image and the twin that draws it."""

    observed: ObservedBoardPress
    forward: BoardPressModel
    lens: LensModel
    """Through which the image was rectified."""

    def solve(self, press: BoardPressParameters) -> BoardPressFit:
        """Solve from a start by Gauss–Newton; the result says whether it settled."""
        lens, at_mm, settled = self.lens, self.observed.points_mm, False
        pixels = lens.to_px(at_mm)
        for _ in range(ROUNDS):
            moves = _lens_displacement_modes(lens, at_mm)
            step = self.step(press, at_mm, moves)
            change = np.linalg.lstsq(step.slopes, step.rest, rcond=1e-10)[0]
            moved = self.clip_to_bounds(press, np.clip(change[: len(LARGEST)], -LARGEST, LARGEST))
            # Parameters of a lens stand in for each other far too much to be stepped themselves.
            asked_mm = at_mm + moves @ change[len(LARGEST) : -LIGHT_TERMS]
            lens = refine_lens(asked_mm[::FEWER], pixels[::FEWER], lens).lens
            try:
                at_mm = _invert_lens_projection(lens, pixels, asked_mm)
            except PointNotSeen:
                return self.summarise(press, lens, step, settled=False)
            settled = bool((np.abs(_to_vector(moved) - _to_vector(press)) < SETTLED).all())
            press = moved
            if settled:
                break
        return self.summarise(press, lens, step, settled)

    def summarise(
        self, press: BoardPressParameters, lens: LensModel, step: "_LinearisedProblem", settled: bool
    ) -> BoardPressFit:
        """What the last round says of itself."""
        points = effective_observation_count(self.observed.image(step.rest))
        variance = np.sum(step.rest**2) / max(points - step.slopes.shape[1], 1.0)
        covariance = np.linalg.pinv(step.slopes.T @ step.slopes, hermitian=True) * variance
        told = BoardPressParameters(*np.sqrt(np.maximum(np.diag(covariance), 0))[: len(LARGEST)].tolist())
        rest, contrast = float(np.sqrt(np.mean(step.rest**2))), float(np.median(self.observed.board.contrast))
        like_mm = self.forward.fit.light.point_spread_mm
        return BoardPressFit(press, told, lens, points, rest, contrast, like_mm, settled)

    def step(self, press: BoardPressParameters, at_mm: Points, moves: Float[Array, "n 2 k"]) -> _LinearisedProblem:
        """Rest and slopes for one press, pixels seeing these places, which the lens moves like this."""
        drawn = self.forward.predict_image(press)
        here = drawn.at(at_mm)
        by_nearness, by_scattering, by_depth, by_poisson = (
            (self.forward.predict_image(replace(press, **{name: getattr(press, name) + step})).at(at_mm) - here) / step
            for name, step in STEPS.items()
        )
        x, y = at_mm.T
        by_press = np.column_stack([by_depth, -y * by_depth, x * by_depth, by_poisson, by_nearness, by_scattering])
        by_lens = np.einsum("ni,nik->nk", _brightness_gradient(drawn, at_mm), moves)
        light = np.column_stack([np.ones(len(x)), x / UNIT_MM, y / UNIT_MM]) * (1 + here)[:, None]
        levels = np.linalg.lstsq(light, self.observed.relative_brightness, rcond=None)[0]
        level = (light @ levels) / (1 + here)
        slopes = np.column_stack([np.column_stack([by_press, by_lens]) * level[:, None], light])
        rest = self.observed.relative_brightness - light @ levels
        return _LinearisedProblem(rest * self.observed.mean_grey, slopes * self.observed.mean_grey)

    def clip_to_bounds(self, press: BoardPressParameters, by: Float[Array, "6"]) -> BoardPressParameters:
        """The press moved, within what can be."""
        deepest = MOST_THICKNESS * self.forward.fit.parameters["thickness_mm"]
        most = [deepest, MOST_TILT, MOST_TILT, MOST_POISSON, MOST_NEARNESS, MOST_SCATTERING_MM]
        return BoardPressParameters(*np.clip(_to_vector(press) + by, _to_vector(LEAST), most).tolist())


def _lens_displacement_modes(lens: LensModel, at_mm: Points) -> Float[Array, "n 2 k"]:
    """How the places that pixels see move with a lens, mm; ways that are independent, each by a millimetre (RMS)."""
    in_image = lens_parameter_jacobian(lens, at_mm).reshape(len(at_mm), 2, -1)
    moves = np.linalg.solve(lens.px_per_mm(at_mm), in_image)
    ways, _, _ = np.linalg.svd(moves.reshape(2 * len(at_mm), -1), full_matrices=False)
    return ways.reshape(moves.shape) * np.sqrt(len(at_mm))


def _invert_lens_projection(lens: LensModel, pixels: Points, near_mm: Points) -> Points:
    """Places that pixels see, from places near them (Newton); raises `PointNotSeen` where the lens folds the image over."""
    for _ in range(NEWTON):
        slope = lens.px_per_mm(near_mm)
        if not (np.linalg.det(slope) > 0).all():
            raise PointNotSeen(
                "expected a lens that shows every place once, got one that folds; the fit has lost its way"
            )
        near_mm = near_mm + np.linalg.solve(slope, (pixels - lens.to_px(near_mm))[..., None])[..., 0]
    return near_mm


def fit_board_press(observed: ObservedBoardPress, fit: TwinFit, start: BoardPressParameters = START) -> BoardPressFit:
    """Fit the board's image, rectified through its lens, with the twin that the ball told."""
    board = observed.board
    lens = with_radial_terms(board.lens, max(LENS_TERMS, len(board.lens.radial)))
    return _BoardPressSolver(observed, BoardPressModel(fit, board.board), lens).solve(start)


def _brightness_gradient(drawn: PredictedBoardImage, at_mm: Points) -> Float[Array, "n 2"]:
    """Of what was drawn, per mm along x and y."""
    steps = np.eye(2) * GRADIENT_MM
    return np.column_stack([(drawn.at(at_mm + by) - drawn.at(at_mm - by)) / (2 * GRADIENT_MM) for by in steps])


def _replace_lens(observed: ObservedBoardPress, fit: TwinFit, told: BoardPressFit) -> BoardFit:
    """The board with the lens that was found. Its pins are fitted again, at the places of the untouched plane where their
    imprints are seen: they tell how well a pin is predicted that was left out."""
    board, forward = observed.board, BoardPressModel(fit, observed.board.board)
    drawn = forward.predict_image(told.press)
    seen_mm = forward.imprints_mm(drawn, board.points_mm[board.found])
    return replace(board, lens_fit=fit_lens(seen_mm, board.points_px[board.found], told.lens), refined=told.lens)


def _to_vector(press: BoardPressParameters) -> Float[Array, "6"]:
    """Its numbers."""
    return np.array(list(vars(press).values()))


TURNS = 2
"""The first begins with a light that a wrong lens and nearness told; the second mends what followed from that."""

RectificationBuilder = Callable[[BoardFit], Rectification]
BallFitter = Callable[[Rectification, tuple[ParameterPrior, ...], ParameterVector | None], BallFit]


@dataclass(frozen=True)
class JointCalibration:
    """Board, lens and ball as they explain each other."""

    board: BoardFit
    rectify: Rectification
    ball: BallFit
    told: BoardPressFit | None = None
    """By the board's image; None where no physics was fitted to the ball's."""

    def next(
        self, images: tuple[BgrImage, BgrImage], lens_on_grid: RectificationBuilder, fit_of_ball: BallFitter
    ) -> "JointCalibration":
        """After one more turn; where the board is not as the twin draws it, the same, and what it told beside it."""
        if self.ball.physical is None:
            return self
        fit, before, after = self.ball.physical.fit, *(self.rectify(Frame(image)) for image in images)
        observed = ObservedBoardPress(before, after, self.board)
        told = fit_board_press(observed, fit, START if self.told is None else self.told.press)
        if not told.accepted:
            return replace(self, told=self.told or told)
        board = _replace_lens(observed, fit, told)
        rectify = lens_on_grid(board)
        return JointCalibration(board, rectify, fit_of_ball(rectify, told.beliefs, fit.vector), told)


def refine_board_and_ball(
    first: JointCalibration,
    images: tuple[BgrImage, BgrImage],
    lens_on_grid: RectificationBuilder,
    fit_of_ball: BallFitter,
) -> JointCalibration:
    """From board and ball each for itself. images: raw, before and under the board."""
    found = first
    for _ in range(TURNS):
        try:
            found = found.next(images, lens_on_grid, fit_of_ball)
        except BallPressUnusable:
            return found
        if found.told is None or not found.told.accepted:
            return found
    return found
