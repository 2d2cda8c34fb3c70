"""How probable it is that the stated pitch of the board or radius of the ball is wrong, from what sensors of one design share.

A wrong length changes all lengths of a calibration by one factor, and every image still fits. But sensors of one design are
alike: their cameras see about as much skin, pins of one diameter leave imprints of about one size, and light and gel are spread
as in `FITTED_PARAMETERS`. Each of these quantities is a `LengthClue`. A wrong pitch or radius by a factor exp(e) shifts its
logarithm by e times its sensitivity, and all clues are weighed together: Bayes' rule compares "both lengths are right" with "the
pitch is wrong" and "the radius is wrong".

The tolerances are those of the design and of the simulated population. Tails are heavy, because housings of other sizes and gels of
other recipes are built: they are more probable than ten standard deviations.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.board.board_fit import BoardFit
from ninedtact.calibration.sensor_toml_schema import LengthPlausibility
from ninedtact.calibration.twin.ball_press_fit import TwinFit
from ninedtact.design import PUBLISHED_MM_PER_PX, Gel, RectifiedImageSize, SensorDesign
from ninedtact.simulation.gel_brightness import (
    FITTED_PARAMETERS,
    PUBLISHED_DESIGN,
    BrightnessModel,
    transfer_brightness_model,
)
from ninedtact.simulation.twin import lens_for_design

_WRONG_SHARE = 0.05
"""Share of calibrations in which the pitch is stated wrong, and of those in which the radius is, before any image."""
_WRONG_SPREAD = 0.15
"""Standard deviation of the logarithm of a wrong length over the true one."""
_ERRORS: Float[Array, " errors"] = np.linspace(-0.5, 0.5, 201)
"""The wrong lengths that are compared, as logarithms of the stated length over the true one."""
_TAIL_SHARE, _TAIL_WIDTH = 0.1, 3.0
"""Share of sensors that are unlike the others in one clue, and how many times wider those are spread."""
_USUAL_POINT_SPREAD_MM = FITTED_PARAMETERS["point_spread_mm"].median
_IMPRINT_PER_PIN = 1.05
"""Radius of an imprint where it is half as dark as in the middle, over the radius of the pin, at the usual point spread."""
_IMPRINT_PER_POINT_SPREAD = 0.2
"""Relative growth of the imprint per relative growth of the point spread. Both numbers are those of simulated boards, pressed 0.4
to 1.1 mm deep into the sensors of the population, which scatter about them by 4 %."""


@dataclass(frozen=True)
class LengthClue:
    """One quantity of a calibration that sensors of one design have in common."""

    log_ratio: float
    """Logarithm of the quantity over that of the design."""
    spread: float
    """Standard deviation of this logarithm over sensors with right lengths."""
    per_pitch: float
    """Change of the logarithm per logarithm of the stated pitch over the true one."""
    per_radius: float = 0.0
    """The same for the radius of the ball."""
    tail_share: float = _TAIL_SHARE
    tail_width: float = _TAIL_WIDTH

    def log_likelihood(
        self, pitch_error: Float[Array, " errors"], radius_error: Float[Array, " errors"]
    ) -> Float[Array, " errors"]:
        """Return the logarithm of the probability density of this clue where pitch and radius are wrong by these logarithms."""
        deviation = (self.log_ratio - self.per_pitch * pitch_error - self.per_radius * radius_error) / self.spread
        usual = (1 - self.tail_share) * np.exp(-0.5 * deviation**2)
        unlike = self.tail_share / self.tail_width * np.exp(-0.5 * (deviation / self.tail_width) ** 2)
        return np.asarray(np.log((usual + unlike) / self.spread + 1e-300))


def assess_stated_lengths(
    board: BoardFit | None, twin: TwinFit | None, design: SensorDesign
) -> LengthPlausibility | None:
    """Return what the fits of board and ball say of the stated lengths; None where there are none of both."""
    clues = [] if twin is None else ball_clues(twin.light, twin.gel, design)
    if board is not None:
        spread_mm = None if twin is None else twin.light.point_spread_mm
        clues += board_clues(board.mm_per_px, max(board.change.shape), board.imprint_radius_mm, spread_mm, design)
    return probabilities_of_wrong_lengths(clues, design) if clues else None


def board_clues(
    mm_per_px: float, long_side_px: int, imprint_radius_mm: float, point_spread_mm: float | None, design: SensorDesign
) -> list[LengthClue]:
    """Return the clues of the board: the field of view, and the size of the imprints.

    mm_per_px: of the raw image, whose longer side has `long_side_px` pixels. point_spread_mm: as the ball shows it; None where none
    was pressed.
    """
    design_mm = PUBLISHED_MM_PER_PX * RectifiedImageSize().raw_long_side_px
    design_mm *= lens_for_design(design).mm_per_unit / lens_for_design(PUBLISHED_DESIGN).mm_per_unit
    pin_mm, usual_pin_mm = (one.pin_board.pin_diameter_mm / 2 for one in (design, PUBLISHED_DESIGN))
    blurred = (point_spread_mm or _USUAL_POINT_SPREAD_MM) / pin_mm * usual_pin_mm / _USUAL_POINT_SPREAD_MM
    imprint_mm = _IMPRINT_PER_PIN * pin_mm * blurred**_IMPRINT_PER_POINT_SPREAD
    return [
        # Gel and camera are mounted to a few tenths of a millimetre over some ten millimetres of optical path, and lenses differ by
        # a per cent or two. Housings of other sizes are built, too: in the tail.
        LengthClue(float(np.log(mm_per_px * long_side_px / design_mm)), 0.04, 1.0, tail_share=0.15, tail_width=5.0),
        # Printed pins differ by about 0.05 mm, and the imprints of simulated boards by 4 %. The point spread grows with the pitch.
        LengthClue(float(np.log(imprint_radius_mm / imprint_mm)), 0.06, 0.9),
    ]


_SENSITIVITIES = {
    "darkening_per_mm": (-3.7, 2.3),
    "brightening_per_mm": (-2.8, 1.9),
    "point_spread_mm": (0.6, 0.0),
    "relative_thickness": (1.2, 0.0),
}
"""Changes of the logarithms of what is fitted to the ball, per logarithm of pitch and of radius, of sensors that were calibrated
with wrong lengths. The larger the radius, the shallower is the press that a contact circle means, and the more light a mm."""


def relative_radius_std() -> float:
    """Return how well light and gel of other sensors tell the radius of the ball where the pitch is right: the standard deviation
    of its logarithm, without heavy tails. No image tells it better: radius, depths and slopes of the light go together.
    """
    spreads = {name: FITTED_PARAMETERS[name].spread for name in _SENSITIVITIES}
    return float(
        np.sum([(per_radius / spreads[name]) ** 2 for name, (_, per_radius) in _SENSITIVITIES.items()]) ** -0.5
    )


def ball_clues(light: BrightnessModel, gel: Gel, design: SensorDesign) -> list[LengthClue]:
    """Return the clues of light and gel, which are fitted to the ball."""
    published = transfer_brightness_model(light, PUBLISHED_DESIGN, measured_on=design)
    found = {**vars(published), "relative_thickness": gel.thickness_mm / design.gel.thickness_mm}
    return [
        LengthClue(known.deviation(found[name]) * known.spread, known.spread, *_SENSITIVITIES[name])
        for name, known in FITTED_PARAMETERS.items()
        if name in _SENSITIVITIES
    ]


def probabilities_of_wrong_lengths(clues: list[LengthClue], design: SensorDesign) -> LengthPlausibility:
    """Return how probable a wrong pitch and a wrong radius are, and which lengths the clues fit best."""
    none = np.zeros_like(_ERRORS)
    prior = np.exp(-0.5 * (_ERRORS / _WRONG_SPREAD) ** 2)
    prior /= prior.sum()
    right = sum(clue.log_likelihood(none, none)[0] for clue in clues)
    by_pitch = np.exp(sum(clue.log_likelihood(_ERRORS, none) for clue in clues) - right) * prior
    by_radius = np.exp(sum(clue.log_likelihood(none, _ERRORS) for clue in clues) - right) * prior
    pitch_weight, radius_weight = (float(_WRONG_SHARE * one.sum()) for one in (by_pitch, by_radius))
    total = 1 - 2 * _WRONG_SHARE + pitch_weight + radius_weight
    return LengthPlausibility(
        pitch_mm=design.pin_board.pitch_mm,
        pitch_wrong_probability=pitch_weight / total,
        likely_pitch_mm=float(design.pin_board.pitch_mm * np.exp(-_ERRORS[by_pitch.argmax()])),
        ball_radius_mm=design.ball.radius_mm,
        ball_radius_wrong_probability=radius_weight / total,
        likely_ball_radius_mm=float(design.ball.radius_mm * np.exp(-_ERRORS[by_radius.argmax()])),
    )
