"""Refinement of the lens with the digital twin: the depth of the board's imprints, the viewing distance and the lens are fitted
together to the image of the pressed board.

A pin presses the skin towards the camera, and lines of sight converge, so that its imprint appears farther out than the pin is. A
lens fitted to pins alone takes that for magnification. Here the twin, fitted to the ball image, predicts the whole board image. The
fit by Gauss–Newton covers the board's depth and tilt, the inverse viewing distance and the lens; the derivative by the lens follows
from the gradient of the predicted image. The shape of an imprint separates viewing distance from magnification, because its bottom
is displaced more than its rim.

`refine_board_and_ball` alternates the two fits. The ball image gives light and gel for the board's prediction; the board image
gives the depth of its imprints, the viewing distance and so the lens; the ball is then fitted again through that lens.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.ball.ball_fit import BallFit
from ninedtact.calibration.ball.contact_circle import BallPressUnusable
from ninedtact.calibration.board.board_fit import BoardFit
from ninedtact.calibration.board.lens_fit import fit_lens, refine_lens, with_radial_term_count
from ninedtact.calibration.press_brightness import BgrImage
from ninedtact.calibration.twin.ball_press_fit import ParameterPrior, TwinFit, effective_observation_count
from ninedtact.calibration.twin.ball_press_model import ParameterVector
from ninedtact.calibration.twin.board_press_model import (
    BoardPressModel,
    BoardPressParameters,
    ObservedBoardPress,
    PredictedBrightnessField,
)
from ninedtact.quantities import Frame
from ninedtact.shape.lens import LensModel, PixelNotOnSkin, Points
from ninedtact.shape.rectification import Rectification

WORST_REST = 0.06
"""Fraction of the imprints' contrast that may stay unexplained, as for a ball's darkening (ball/contact_circle.py). Above it, the
pins differ from the design or from each other, and the fit is not used (real boards so far 0.045 and 0.06, simulated ones 0.01 to
0.045).
"""
MOST_UNLIKE = 0.2
"""Largest relative difference of the scattering under pins and under the ball (real boards so far 0.5, simulated ones
up to 0.1).
"""
HOPELESSLY_UNLIKE = 2 * MOST_UNLIKE
"""Difference of the scattering after the first fit, on a coarse grid, above which a fine grid could not make it acceptable."""
LENS_TERMS = 3
"""Number of radial terms; a whole image determines more of them than 63 pins do."""
START = BoardPressParameters(0.8, 0.0, 0.0, 0.495, 0.03, 0.5)
LEAST = BoardPressParameters(0.1, -0.1, -0.1, 0.35, 0.0, 0.1)
MOST_THICKNESS = 0.9
"""Largest depth of a board, as a fraction of the gel's thickness."""
MOST_TILT, MOST_POISSON, MOST_NEARNESS, MOST_SCATTERING_MM = 0.1, 0.5, 0.1, 1.5
VIEW_STEPS = {"inverse_distance_per_mm": 0.004, "point_spread_mm": 0.02}
CONTACT_STEPS = {"depth_mm": 0.02, "poisson_ratio": -0.003}
"""Steps of the difference quotients. The parameters of the view need no new contact solution and come first; the steps of the tilt
follow from that of the depth.
"""
LARGEST = np.array([0.2, 0.02, 0.02, 0.01, 0.03, 0.2])
"""Largest change of each parameter in one iteration."""
SETTLED = np.array([2e-3, 2e-4, 2e-4, 2e-4, 2e-4, 2e-3])
NEAR = np.array([2e-2, 5e-3, 5e-3, 3e-3, np.inf, np.inf])
"""Changes below which the derivatives by depth and Poisson's ratio are kept for the next iteration."""
ROUGH_POINTS_PER_PITCH = 10
"""Points per pitch of the pins of the contact grid on which the first fit is made, at a quarter of the cost."""
ROUGH_ROUNDS, FINE_ROUNDS, NEWTON = 12, 5, 2
FEWER = 14
"""Every how many observed points one is used to fit the lens to the displaced points."""
GRADIENT_MM = 0.05
UNIT_MM, LIGHT_TERMS = 10.0, 3
"""Unit of length and number of terms of the light's level and slopes over the image."""


@dataclass(frozen=True)
class BoardPressFit:
    """The result of the fit to the board image."""

    press: BoardPressParameters
    deviation: BoardPressParameters
    lens: LensModel
    points: float
    """Effective number of independent observations."""
    rest_grey: float
    """Root mean square residual."""
    contrast_grey_levels: float
    """Contrast of the imprints."""
    ball_scattering_mm: float
    """Scattering as fitted to the ball image."""
    settled: bool
    by_contact: Float[Array, "2 n"]
    """Derivative of the predicted brightness by depth and by Poisson's ratio in the last iteration."""

    @property
    def scattering_difference(self) -> float:
        """Relative difference of the scattering under pins and under the ball."""
        return abs(self.press.point_spread_mm / self.ball_scattering_mm - 1)

    @property
    def accepted(self) -> bool:
        """Whether the board image agrees with the twin's prediction, so that the fit is used."""
        return (
            self.settled
            and self.scattering_difference <= MOST_UNLIKE
            and self.rest_grey <= WORST_REST * self.contrast_grey_levels
        )

    @property
    def beliefs(self) -> tuple[ParameterPrior, ...]:
        """Return the prior terms for the fit of the ball."""
        told = ParameterPrior(
            "inverse_distance_per_mm", self.press.inverse_distance_per_mm, self.deviation.inverse_distance_per_mm
        )
        return (told,) if self.accepted else ()


@dataclass(frozen=True)
class _LinearisedProblem:
    """The residual and Jacobian of one iteration."""

    rest: Float[Array, " n"]
    """Residual in grey levels."""
    slopes: Float[Array, "n parameters"]
    """Derivative by the press (in the order of its fields), by the lens, and by level and slopes of the light."""
    by_contact: Float[Array, "2 n"]
    """Derivative of the predicted brightness by depth and by Poisson's ratio, each of which costs a contact."""


@dataclass(frozen=True)
class _BoardPressSolver:
    """The solver for a board image, with the twin that predicts it."""

    observed: ObservedBoardPress
    forward: BoardPressModel
    rectified_through: LensModel

    def solve(
        self, press: BoardPressParameters, lens: LensModel, rounds: int, kept: Float[Array, "2 n"] | None = None
    ) -> BoardPressFit:
        """Solve from a start by Gauss–Newton in at most this many rounds; the result states whether it converged.

        kept: the derivatives of the contact by depth and Poisson's ratio at a press near the start, where they are known.
        """
        settled, pixels = False, self.rectified_through.to_px(self.observed.points_mm)
        at_mm = _invert_lens_projection(lens, pixels, self.observed.points_mm)
        for _ in range(rounds):
            moves = _lens_displacement_modes(lens, at_mm)
            step = self.step(press, at_mm, moves, kept)
            change = np.linalg.lstsq(step.slopes, step.rest, rcond=1e-10)[0]
            moved = self.clip_to_bounds(press, np.clip(change[: len(LARGEST)], -LARGEST, LARGEST))
            # The lens parameters are too strongly correlated for steps in them, so the lens is fitted to displaced points.
            asked_mm = at_mm + moves @ change[len(LARGEST) : -LIGHT_TERMS]
            refined = refine_lens(asked_mm[::FEWER], pixels[::FEWER], lens).lens
            try:
                at_mm = _invert_lens_projection(refined, pixels, asked_mm)
            except PixelNotOnSkin:
                return self.summarise(press, lens, step, settled=False)
            by = np.abs(_to_vector(moved) - _to_vector(press))
            settled, kept = bool((by < SETTLED).all()), step.by_contact if (by < NEAR).all() else None
            press, lens = moved, refined
            if settled:
                break
        return self.summarise(press, lens, step, settled)

    def summarise(
        self, press: BoardPressParameters, lens: LensModel, step: "_LinearisedProblem", settled: bool
    ) -> BoardPressFit:
        """Return the result of the last iteration."""
        points = effective_observation_count(self.observed.image(step.rest))
        variance = np.sum(step.rest**2) / max(points - step.slopes.shape[1], 1.0)
        covariance = np.linalg.pinv(step.slopes.T @ step.slopes, hermitian=True) * variance
        told = BoardPressParameters(*np.sqrt(np.maximum(np.diag(covariance), 0))[: len(LARGEST)].tolist())
        rest, contrast = float(np.sqrt(np.mean(step.rest**2))), float(np.median(self.observed.board.contrast))
        like_mm = self.forward.fit.light.point_spread_mm
        return BoardPressFit(press, told, lens, points, rest, contrast, like_mm, settled, step.by_contact)

    def step(
        self,
        press: BoardPressParameters,
        at_mm: Points,
        moves: Float[Array, "n 2 k"],
        kept: Float[Array, "2 n"] | None,
    ) -> _LinearisedProblem:
        """Return residual and Jacobian for one press; at_mm: places that the pixels see, moves: their derivative by the lens.

        kept: the derivatives of the contact by depth and Poisson's ratio of a press near by, if they are to be taken over.
        """
        drawn = self.forward.predict_image(press)
        here = drawn.at(at_mm)

        def derivative(name: str, step: float) -> Float[Array, " n"]:
            moved = replace(press, **{name: getattr(press, name) + step})
            return (self.forward.predict_image(moved).at(at_mm) - here) / step

        by_nearness, by_scattering = (derivative(*step) for step in VIEW_STEPS.items())
        by_contact = np.array([derivative(*step) for step in CONTACT_STEPS.items()]) if kept is None else kept
        by_depth, by_poisson = by_contact
        x, y = at_mm.T
        by_press = np.column_stack([by_depth, -y * by_depth, x * by_depth, by_poisson, by_nearness, by_scattering])
        by_lens = np.einsum("ni,nik->nk", _brightness_gradient(drawn, at_mm), moves)
        light = np.column_stack([np.ones(len(x)), x / UNIT_MM, y / UNIT_MM]) * (1 + here)[:, None]
        levels = np.linalg.lstsq(light, self.observed.relative_brightness, rcond=None)[0]
        level = (light @ levels) / (1 + here)
        slopes = np.column_stack([np.column_stack([by_press, by_lens]) * level[:, None], light])
        rest = self.observed.relative_brightness - light @ levels
        return _LinearisedProblem(rest * self.observed.mean_grey, slopes * self.observed.mean_grey, by_contact)

    def clip_to_bounds(self, press: BoardPressParameters, by: Float[Array, "6"]) -> BoardPressParameters:
        """Return the press moved by a step, within its bounds."""
        deepest = MOST_THICKNESS * self.forward.fit.parameters["thickness_mm"]
        most = [deepest, MOST_TILT, MOST_TILT, MOST_POISSON, MOST_NEARNESS, MOST_SCATTERING_MM]
        return BoardPressParameters(*np.clip(_to_vector(press) + by, _to_vector(LEAST), most).tolist())


def _lens_displacement_modes(lens: LensModel, at_mm: Points) -> Float[Array, "n 2 k"]:
    """Return how the places that pixels see move with a lens, in mm: independent modes, each scaled to a millimetre (RMS)."""
    moves = np.linalg.solve(lens.px_per_mm(at_mm), lens.px_per_parameter(at_mm))
    ways, _ = np.linalg.qr(moves.reshape(2 * len(at_mm), -1))
    return ways.reshape(moves.shape) * np.sqrt(len(at_mm))


def _invert_lens_projection(lens: LensModel, pixels: Points, near_mm: Points) -> Points:
    """Return the places that pixels see, from places near them (Newton); raises `PixelNotOnSkin` where the lens folds the
    image over.
    """
    for _ in range(NEWTON):
        slope = lens.px_per_mm(near_mm)
        if not (np.linalg.det(slope) > 0).all():
            raise PixelNotOnSkin(
                "expected a lens that shows every place once, got one that folds; the fit has lost its way"
            )
        near_mm = near_mm + np.linalg.solve(slope, (pixels - lens.to_px(near_mm))[..., None])[..., 0]
    return near_mm


def fit_board_press_and_lens(
    observed: ObservedBoardPress, fit: TwinFit, last: BoardPressFit | None = None
) -> BoardPressFit:
    """Fit press and lens to the board image with the twin from the ball press.

    observed: the image, rectified through the lens so far. last: an earlier fit to start from. Without one, a fit with a coarse
    contact grid is the start, and the result where it disagrees with the twin by far.
    """
    board = observed.board
    lens = with_radial_term_count(board.lens, max(LENS_TERMS, len(board.lens.radial)))
    fine = BoardPressModel(fit, board.board)
    solver = _BoardPressSolver(observed, fine, lens)
    if last is not None:  # `lens` is the one through which the images were rectified this time
        return solver.solve(last.press, lens, FINE_ROUNDS)
    rough = replace(solver, forward=replace(fine, points_per_pitch=ROUGH_POINTS_PER_PITCH))
    start = rough.solve(START, lens, ROUGH_ROUNDS)
    if start.scattering_difference > HOPELESSLY_UNLIKE:
        return start
    return solver.solve(start.press, start.lens, FINE_ROUNDS, start.by_contact)


def _brightness_gradient(drawn: PredictedBrightnessField, at_mm: Points) -> Float[Array, "n 2"]:
    """Return the gradient of the predicted image, per mm along x and y."""
    steps = np.eye(2) * GRADIENT_MM
    return np.column_stack([(drawn.at(at_mm + by) - drawn.at(at_mm - by)) / (2 * GRADIENT_MM) for by in steps])


def _replace_lens(observed: ObservedBoardPress, fit: TwinFit, told: BoardPressFit) -> BoardFit:
    """Return the board with the refined lens. Its pins are fitted again, at the places of the undeformed plane where their imprints
    are seen, which gives the leave-one-out errors.
    """
    board, forward = observed.board, BoardPressModel(fit, observed.board.board)
    drawn = forward.predict_image(told.press)
    seen_mm = forward.imprints_mm(drawn, board.points_mm[board.found])
    return replace(board, lens_fit=fit_lens(seen_mm, board.points_px[board.found], told.lens), refined=told.lens)


def _to_vector(press: BoardPressParameters) -> Float[Array, "6"]:
    """Return the parameters of the press as a vector."""
    return np.array(list(vars(press).values()))


TURNS = 2
"""Number of alternations. The first starts from the light of a preliminary lens and viewing distance; the second corrects the
effect of that.
"""

RectificationBuilder = Callable[[BoardFit], Rectification]
BallFitter = Callable[[Rectification, tuple[ParameterPrior, ...], ParameterVector | None], BallFit]


@dataclass(frozen=True)
class JointCalibration:
    """Board, lens and ball, fitted jointly."""

    board: BoardFit
    rectify: Rectification
    ball: BallFit
    told: BoardPressFit | None = None
    """The fit to the board image; None where no physics was fitted to the ball image."""

    def next(
        self, images: tuple[BgrImage, BgrImage], lens_on_grid: RectificationBuilder, fit_of_ball: BallFitter
    ) -> "JointCalibration":
        """Return the result of one more alternation. Where the board disagrees with the twin's prediction, only the board's fit is
        added.
        """
        if self.ball.physical is None:
            return self
        fit, before, after = self.ball.physical.fit, *(self.rectify(Frame(image)) for image in images)
        observed = ObservedBoardPress(before, after, self.board)
        told = fit_board_press_and_lens(observed, fit, self.told)
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
    """Return the joint calibration, starting from separate fits of board and ball. images: raw, before and under the board."""
    found = first
    for _ in range(TURNS):
        try:
            found = found.next(images, lens_on_grid, fit_of_ball)
        except BallPressUnusable:
            return found
        if found.told is None or not found.told.accepted:
            return found
    return found
