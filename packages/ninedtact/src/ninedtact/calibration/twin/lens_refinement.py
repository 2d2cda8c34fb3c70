"""Refinement of the lens with the digital twin: the depth of the board's imprints, the viewing distance and the lens are fitted
together to the image of the pressed board.

A pin presses the skin towards the camera, and lines of sight converge, so that its imprint appears farther out than the pin is. A
lens fitted to pins alone takes that for magnification. Here the twin, fitted to the ball image, predicts the whole board image. The
fit by Gauss–Newton covers the board's depth and tilt, the inverse viewing distance and the lens; the derivative by the lens follows
from the gradient of the predicted image. The shape of an imprint separates viewing distance from magnification, because its bottom
is displaced more than its rim.

`fit_board_press_and_lens` makes the fit. Where it is accepted, `refine_board_lens` gives the board the refined lens, and the
viewing distance is a prior for another fit of the ball.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.linalg import qr

from ninedtact.calibration.board.board_fit import BoardFit
from ninedtact.calibration.board.lens_fit import fit_lens, refine_lens, with_radial_term_count
from ninedtact.calibration.board.pin_imprint_centres import IMPRINT_RADIUS_PITCHES, locate_imprints_mm
from ninedtact.calibration.twin.ball_press_fit import TwinFit
from ninedtact.calibration.twin.fit_parameters import effective_observation_count, parameter_covariance
from ninedtact.calibration.twin.observed_presses import ObservedBoardPress
from ninedtact.calibration.twin.press_search import ParameterPrior
from ninedtact.shape.lens_and_rectification import (
    LensModel,
    PixelNotOnSkin,
    Points,
    determinant_at_each_point,
    solve_at_each_point,
)
from ninedtact.simulation.calibration_press_models import (
    BoardPressModel,
    BoardPressParameters,
    PredictedBrightnessField,
)

MAX_RELATIVE_RESIDUAL = 0.06
"""Largest root mean square residual as a fraction of the imprints' contrast, as for a ball's darkening (ball/contact_circle.py).
Above it, the pins differ from the design or from each other, and the fit is not used (real boards so far 0.045 and 0.06, simulated
ones 0.01 to 0.045).
"""
MAX_POINT_SPREAD_DIFFERENCE = 0.2
"""Largest relative difference of the point spread under the pins and under the ball (real boards so far 0.5, simulated ones up to
0.1).
"""
MAX_COARSE_POINT_SPREAD_DIFFERENCE = 2 * MAX_POINT_SPREAD_DIFFERENCE
"""Difference of the point spread after the fit on the coarse grid, above which a fine grid could not make it acceptable."""
RADIAL_TERM_COUNT = 3
"""Number of radial terms of the lens; a whole image determines more of them than 63 pins do."""

# depth_mm, tilt_x_rad, tilt_y_rad, poisson_ratio, inverse_distance_per_mm, point_spread_mm
INITIAL_PRESS = BoardPressParameters(0.8, 0.0, 0.0, 0.495, 0.03, 0.5)
LOWER_BOUNDS = BoardPressParameters(0.1, -0.1, -0.1, 0.35, 0.0, 0.1)
UPPER_BOUNDS = BoardPressParameters(np.inf, 0.1, 0.1, 0.5, 0.1, 1.5)
MAX_STEP = BoardPressParameters(0.2, 0.02, 0.02, 0.01, 0.03, 0.2)
"""Largest change of each parameter in one iteration."""
STEP_TOLERANCE = BoardPressParameters(2e-3, 2e-4, 2e-4, 2e-4, 2e-4, 2e-3)
"""Change of each parameter in one iteration below which the fit has converged."""
DERIVATIVE_REUSE_STEP = BoardPressParameters(2e-2, 5e-3, 5e-3, 3e-3, np.inf, np.inf)
"""Change of each parameter in one iteration below which the next one reuses the derivatives by depth and Poisson's ratio."""
MAX_DEPTH_PER_THICKNESS = 0.9
"""Largest depth of a board, as a fraction of the gel's thickness."""

VIEW_DIFFERENCE_STEPS = {"inverse_distance_per_mm": 0.004, "point_spread_mm": 0.02}
CONTACT_DIFFERENCE_STEPS = {"depth_mm": 0.02, "poisson_ratio": -0.003}
"""Steps of the difference quotients. The parameters of the view need no new contact solution and come first; the derivatives by the
tilt follow from that by the depth.
"""
GRADIENT_STEP_MM = 0.05
"""Step of the central differences of the image gradient."""

PRESS_COLUMN_COUNT = INITIAL_PRESS.vector.size
LIGHT_COLUMN_COUNT = 3
"""Number of terms of the illumination: its level and its slopes along x and y."""
PRESS_COLUMNS = slice(0, PRESS_COLUMN_COUNT)
LENS_COLUMNS = slice(PRESS_COLUMN_COUNT, -LIGHT_COLUMN_COUNT)
"""Columns of the Jacobian: the press in the order of its fields, the lens by displacement modes, then the illumination."""
LIGHT_LENGTH_SCALE_MM = 10.0
"""Unit of length of the illumination's slopes."""

COARSE_POINTS_PER_PITCH = 10
"""Points per pitch of the pins of the contact grid on which the first fit is made, at a quarter of the cost."""
MAX_COARSE_ITERATIONS = 12
MAX_FINE_ITERATIONS = 5
LENS_FIT_STRIDE = 14
"""Every how many observed points one is used to fit the lens to the displaced points."""
INVERSION_ITERATIONS = 2
"""Number of Newton iterations that invert the lens projection. Each Gauss–Newton iteration starts the inversion from its own
linear prediction, and the start gets closer as the fit converges: after a first step that moves the image by 21 px the error of the
inversion was at most 0.3 px, in the last iteration of every fit at most 1e-9 px (two real sensors and a simulated one).
"""


@dataclass(frozen=True)
class BoardPressFit:
    """The result of the fit to the board image."""

    press: BoardPressParameters
    standard_deviations: BoardPressParameters
    """Standard deviation of each parameter of the press."""
    lens: LensModel
    residual_rms_grey_levels: float
    contrast_grey_levels: float
    """Contrast of the imprints."""
    ball_point_spread_mm: float
    """Point spread as fitted to the ball image."""
    converged: bool
    contact_derivatives: Float[Array, "2 n"]
    """Derivative of the predicted brightness by depth and by Poisson's ratio in the last iteration."""

    @property
    def point_spread_difference(self) -> float:
        """Relative difference of the point spread under the pins and under the ball."""
        return abs(self.press.point_spread_mm / self.ball_point_spread_mm - 1)

    @property
    def accepted(self) -> bool:
        """Whether the board image agrees with the twin's prediction, so that the fit is used."""
        return (
            self.converged
            and self.point_spread_difference <= MAX_POINT_SPREAD_DIFFERENCE
            and self.residual_rms_grey_levels <= MAX_RELATIVE_RESIDUAL * self.contrast_grey_levels
        )

    @property
    def priors(self) -> tuple[ParameterPrior, ...]:
        """The prior terms for the fit of the ball: the viewing distance, where the fit is accepted."""
        if not self.accepted:
            return ()
        name = "inverse_distance_per_mm"
        return (ParameterPrior(name, getattr(self.press, name), getattr(self.standard_deviations, name)),)


@dataclass(frozen=True)
class _LinearisedProblem:
    """The residual and Jacobian of one iteration."""

    residual: Float[Array, " n"]
    """Observed minus predicted brightness, in grey levels."""
    jacobian: Float[Array, "n parameters"]
    """Derivative of the predicted brightness, in grey levels; its columns are PRESS_COLUMNS, LENS_COLUMNS and the illumination."""
    contact_derivatives: Float[Array, "2 n"]
    """Derivative of the predicted brightness by depth and by Poisson's ratio, each of which needs a contact solution."""


@dataclass(frozen=True)
class _BoardPressSolver:
    """The Gauss–Newton solver for a board image, with the twin that predicts it."""

    observed: ObservedBoardPress
    model: BoardPressModel
    rectification_lens: LensModel
    """The lens through which the observed images were rectified."""

    def solve(
        self,
        press: BoardPressParameters,
        lens: LensModel,
        max_iterations: int,
        contact_derivatives: Float[Array, "2 n"] | None = None,
    ) -> BoardPressFit:
        """Solve from a start by Gauss–Newton in at most this many iterations; the result states whether it converged.

        contact_derivatives: those at a press close to the start, where they are known.
        """
        pixels = self.rectification_lens.to_px(self.observed.points_mm)
        points_mm = _invert_lens_projection(lens, pixels, self.observed.points_mm)
        for _ in range(max_iterations):
            modes = _lens_displacement_modes(lens, points_mm)
            problem = self.linearise(press, points_mm, modes, contact_derivatives)
            step = np.linalg.lstsq(problem.jacobian, problem.residual, rcond=1e-10)[0]
            next_press = self.bounded_step(press, step[PRESS_COLUMNS])
            # The lens parameters are too strongly correlated for steps in them, so the lens is fitted to displaced points.
            displaced_mm = points_mm + modes @ step[LENS_COLUMNS]
            next_lens = refine_lens(displaced_mm[::LENS_FIT_STRIDE], pixels[::LENS_FIT_STRIDE], lens).lens
            try:
                points_mm = _invert_lens_projection(next_lens, pixels, displaced_mm)
            except PixelNotOnSkin:
                return self.summarise(press, lens, problem, converged=False)
            change = np.abs(next_press.vector - press.vector)
            converged = bool((change < STEP_TOLERANCE.vector).all())
            is_reusable = (change < DERIVATIVE_REUSE_STEP.vector).all()
            contact_derivatives = problem.contact_derivatives if is_reusable else None
            press = next_press
            lens = next_lens
            if converged:
                break
        return self.summarise(press, lens, problem, converged)

    def linearise(
        self,
        press: BoardPressParameters,
        points_mm: Points,
        modes: Float[Array, "n 2 k"],
        contact_derivatives: Float[Array, "2 n"] | None,
    ) -> _LinearisedProblem:
        """Return residual and Jacobian for one press.

        points_mm: the points of the undeformed plane that the pixels see. modes: the displacement modes of these points by the
        lens. contact_derivatives: those at a press close to this one, where they are reused.
        """
        image = self.model.predict_image(press)
        change = image.at(points_mm)
        view_derivatives = self.differentiate(press, points_mm, change, VIEW_DIFFERENCE_STEPS)
        if contact_derivatives is None:
            contact_derivatives = self.differentiate(press, points_mm, change, CONTACT_DIFFERENCE_STEPS)
        by_depth, by_poisson_ratio = contact_derivatives
        x, y = points_mm.T
        by_press = np.column_stack([by_depth, -y * by_depth, x * by_depth, by_poisson_ratio, *view_derivatives])
        by_lens = np.einsum("ni,nik->nk", _image_gradient(image, points_mm), modes)
        plane = np.column_stack([np.ones(len(x)), x / LIGHT_LENGTH_SCALE_MM, y / LIGHT_LENGTH_SCALE_MM])
        by_light = plane * (1 + change)[:, None]
        light_coefficients = np.linalg.lstsq(by_light, self.observed.relative_brightness, rcond=None)[0]
        predicted = by_light @ light_coefficients
        illumination = predicted / (1 + change)
        jacobian = np.column_stack([np.column_stack([by_press, by_lens]) * illumination[:, None], by_light])
        residual = self.observed.relative_brightness - predicted
        grey = self.observed.mean_grey
        return _LinearisedProblem(residual * grey, jacobian * grey, contact_derivatives)

    def differentiate(
        self, press: BoardPressParameters, points_mm: Points, change: Float[Array, " n"], steps: dict[str, float]
    ) -> Float[Array, "k n"]:
        """Return the difference quotients of the predicted brightness, `change` at this press, by some of its parameters."""
        perturbed = [replace(press, **{name: getattr(press, name) + step}) for name, step in steps.items()]
        images = [self.model.predict_image(one).at(points_mm) for one in perturbed]
        return np.array([(image - change) / step for image, step in zip(images, steps.values(), strict=True)])

    def bounded_step(self, press: BoardPressParameters, step: Float[Array, "6"]) -> BoardPressParameters:
        """Return the press after a step of limited length, within its bounds."""
        max_depth_mm = MAX_DEPTH_PER_THICKNESS * self.model.gel.thickness_mm
        upper_bounds = replace(UPPER_BOUNDS, depth_mm=max_depth_mm)
        limited = np.clip(step, -MAX_STEP.vector, MAX_STEP.vector)
        return BoardPressParameters.from_vector(
            np.clip(press.vector + limited, LOWER_BOUNDS.vector, upper_bounds.vector)
        )

    def summarise(
        self, press: BoardPressParameters, lens: LensModel, problem: _LinearisedProblem, converged: bool
    ) -> BoardPressFit:
        """Return the result, with the standard deviations from the last iteration's residual and Jacobian."""
        observations = effective_observation_count(self.observed.image(problem.residual))
        covariance = parameter_covariance(problem.jacobian, problem.residual, observations)
        standard_deviations = np.sqrt(np.maximum(np.diag(covariance), 0))
        return BoardPressFit(
            press=press,
            standard_deviations=BoardPressParameters.from_vector(standard_deviations[PRESS_COLUMNS]),
            lens=lens,
            residual_rms_grey_levels=float(np.sqrt(np.mean(problem.residual**2))),
            contrast_grey_levels=float(np.median(self.observed.board.contrast)),
            ball_point_spread_mm=self.model.light.point_spread_mm,
            converged=converged,
            contact_derivatives=problem.contact_derivatives,
        )


def _lens_displacement_modes(lens: LensModel, points_mm: Points) -> Float[Array, "n 2 k"]:
    """Return an orthogonal basis of the displacements, by changes of the lens, of the points that the pixels see, in mm; each mode
    has a root mean square displacement of 1 mm.
    """
    displacements = solve_at_each_point(lens.px_per_mm(points_mm), lens.px_per_parameter(points_mm))
    orthonormal, _ = qr(displacements.reshape(2 * len(points_mm), -1), mode="economic", check_finite=False)
    return orthonormal.reshape(displacements.shape) * np.sqrt(len(points_mm))


def _invert_lens_projection(lens: LensModel, pixels: Points, start_mm: Points) -> Points:
    """Return the points of the plane that the pixels see, by `INVERSION_ITERATIONS` Newton iterations from a start close to them.

    Raises `PixelNotOnSkin` where the projection at a start of an iteration is singular, or folds the image over.
    """
    points_mm = start_mm
    for _ in range(INVERSION_ITERATIONS):
        jacobian = lens.px_per_mm(points_mm)
        orientation = determinant_at_each_point(jacobian)  # negative throughout where the camera mirrors its images
        if not ((orientation > 0).all() or (orientation < 0).all()):
            raise PixelNotOnSkin(
                expected="a lens that maps the skin to the image one to one",
                got="one that folds the image over",
                remedy="press the board evenly, and calibrate again",
            )
        residual_px = pixels - lens.to_px(points_mm)
        points_mm = points_mm + solve_at_each_point(jacobian, residual_px)
    return points_mm


def _image_gradient(image: PredictedBrightnessField, points_mm: Points) -> Float[Array, "n 2"]:
    """Return the gradient of the predicted image, per mm along x and y, by central differences."""
    steps = np.eye(2) * GRADIENT_STEP_MM
    differences = [image.at(points_mm + step) - image.at(points_mm - step) for step in steps]
    return np.column_stack([difference / (2 * GRADIENT_STEP_MM) for difference in differences])


def fit_board_press_and_lens(
    observed: ObservedBoardPress, twin_fit: TwinFit, previous: BoardPressFit | None = None
) -> BoardPressFit:
    """Fit press and lens to the board image with the twin from the ball press.

    observed: the image, rectified through the current lens. previous: an earlier fit to start from. Without one, a fit with a
    coarse contact grid is the start, and the result where it disagrees with the twin by far.
    """
    board = observed.board
    lens = with_radial_term_count(board.lens, max(RADIAL_TERM_COUNT, len(board.lens.radial)))
    model = BoardPressModel(twin_fit.gel, twin_fit.light, board.board)
    solver = _BoardPressSolver(observed, model, lens)
    if previous is not None:
        # The images were rectified through `lens` this time, and not through `previous.lens`.
        return solver.solve(previous.press, lens, MAX_FINE_ITERATIONS)
    coarse_solver = replace(solver, model=replace(model, points_per_pitch=COARSE_POINTS_PER_PITCH))
    coarse = coarse_solver.solve(INITIAL_PRESS, lens, MAX_COARSE_ITERATIONS)
    if coarse.point_spread_difference > MAX_COARSE_POINT_SPREAD_DIFFERENCE:
        return coarse
    return solver.solve(coarse.press, coarse.lens, MAX_FINE_ITERATIONS, coarse.contact_derivatives)


def refine_board_lens(board: BoardFit, twin_fit: TwinFit, board_press_fit: BoardPressFit) -> BoardFit:
    """Return the board with the refined lens. Its pins are fitted again, at the points of the undeformed plane where their imprints
    appear, which gives the leave-one-out errors.
    """
    model = BoardPressModel(twin_fit.gel, twin_fit.light, board.board)
    image = model.predict_image(board_press_fit.press)
    imprints_mm = appearing_imprints_mm(image, board.points_mm[board.found], board.board.pitch_mm)
    lens = board_press_fit.lens
    return replace(board, lens_fit=fit_lens(imprints_mm, board.points_px[board.found], lens), refined=lens)


def appearing_imprints_mm(image: PredictedBrightnessField, pins_mm: Points, pitch_mm: float) -> Points:
    """Return the positions on the plane at which the imprints of these pins appear, located as in a real image."""
    return locate_imprints_mm(image.field, image, pins_mm, IMPRINT_RADIUS_PITCHES * pitch_mm)
