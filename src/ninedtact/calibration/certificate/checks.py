"""The figures of a certificate → lines in words: what was measured, what is expected, and what to do about it.

The limits say what a user of the sensor needs, not what sensors usually reach; each stands here with its reason.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from ninedtact.calibration.ball.contact_circle import MAX_ASYMMETRY
from ninedtact.calibration.board.board_fit import MAX_MISSING_FRACTION
from ninedtact.calibration.sensor_record import BallQuality, BoardQuality, Certificate

CheckLevel = Literal["pass", "warn", "fail"]
CHECK_LEVELS: tuple[CheckLevel, ...] = ("pass", "warn", "fail")
"""From best to worst."""


@dataclass(frozen=True)
class CheckResult:
    """One line of the verdict."""

    level: CheckLevel
    text: str


@dataclass(frozen=True)
class CheckLimit:
    """Up to `good` a figure passes, up to `usable` it is warned of; where `good` is the larger, more is better."""

    good: float
    usable: float

    def level(self, value: float) -> CheckLevel:
        """Where a value stands; one that is not a number fails."""
        sign = 1 if self.good < self.usable else -1
        if sign * value <= sign * self.good:
            return "pass"
        return "warn" if sign * value <= sign * self.usable else "fail"


MISSING = CheckLimit(0.0, MAX_MISSING_FRACTION)
"""Part of the pins. A complete board leaves no corner of the view to extrapolation; the board's own limit ends it."""
LEAVE_ONE_OUT_RMS_MM = CheckLimit(0.06, 0.1)
"""About one rectified pixel; beyond two, the map is visibly worse than the image that it makes."""
LEAVE_ONE_OUT_MAX_MM = CheckLimit(0.18, 0.3)
"""Three times the limits of the RMS: the largest of some sixty random errors is about twice their RMS, so more than
that is one pin gone wrong."""
SCALE_ERROR = CheckLimit(0.005, 0.01)
"""Part of the scale: 0.05 mm, then 0.1 mm on an object of 10 mm, the size that a fingertip holds."""
CONTRAST_TO_NOISE = CheckLimit(10.0, 0.0)
"""Below, noise moves the centre of a pin by more than a tenth of its width. It shows in the left-out error, which does
the failing; this line names the cause."""
OVEREXPOSED = CheckLimit(0.01, 0.05)
"""Part of the image. Overexposed skin cannot brighten and darkens late: there, heights are wrong in silence."""
UNEVEN_BULGE = CheckLimit(MAX_ASYMMETRY, float("inf"))
"""Part of the drop. What a sheared press does to depth, the halves of the disc measure, and they do the failing."""
RANGE_MM = CheckLimit(1.0, 0.5)
"""A firm grasp presses soft gel by about a millimetre; beyond the range, depth is not known."""
CROSS_VALIDATION_MAE_MM = CheckLimit(0.03, 0.15)
"""The published sensor measures balls that it has not seen to 0.046 mm (docs/references.md): the calibration must leave
room for everything else. Beyond a seventh of a millimetre, more than a sheared press costs, it is no measurement."""
NOISE_MM = CheckLimit(0.01, 0.03)
"""Five times the noise is the smallest contact that is noticed: up to 0.01 mm noise does not move that from 0.05 mm
(`shape.measures.ContactRule`); at 0.03 mm light touches of 0.15 mm go unseen."""


def check_certificate(certificate: Certificate) -> list[CheckResult]:
    """Every check, the board's first."""
    return [*_check_board(certificate.board), *_check_ball(certificate.ball)]


def overall_check_level(certificate: Certificate) -> CheckLevel:
    """The level of the whole: that of its worst line, and never a pass where there are warnings."""
    levels = [line.level for line in check_certificate(certificate)] + ["warn" for _ in certificate.warnings]
    return max(levels, key=CHECK_LEVELS.index)


def certificate_headline(certificate: Certificate) -> str:
    """The whole verdict in a sentence or two."""
    lines, level = check_certificate(certificate), overall_check_level(certificate)
    if level == "pass":
        return f"This sensor is ready to measure. All {len(lines)} checks passed."
    if level == "fail":
        return (
            f"Do not measure with this calibration. {_count_in_words(lines, 'fail')}; the lines below say what to do."
        )
    if all(line.level == "pass" for line in lines):
        return f"This sensor can be used with care. All {len(lines)} checks passed, but read the warnings below."
    return f"This sensor can be used with care. {_count_in_words(lines, 'warn')}; the lines below say what to do."


def _count_in_words(lines: Sequence[CheckResult], level: CheckLevel) -> str:
    """How many lines have a level."""
    number = sum(line.level == level for line in lines)
    outcome = "failed" if level == "fail" else "warned"
    return f"{number} of {len(lines)} checks {outcome}"


def _check_board(board: BoardQuality) -> list[CheckResult]:
    """How good the camera calibration is."""
    scale_error, contrast = (
        board.mm_per_px_std / board.mm_per_px,
        board.contrast_grey_levels / board.noise_grey_levels,
    )
    return [
        _make_check_result(
            MISSING.level(1 - board.pins_found / board.pins_expected),
            f"Pins: found {board.pins_found} of {board.pins_expected}{_missing_pins_in_words(board)}",
            "press harder there, or hold the board flatter",
        ),
        _make_check_result(
            LEAVE_ONE_OUT_RMS_MM.level(board.leave_one_out_rms_mm),
            f"Lens: a pin left out of the fit is predicted to {board.leave_one_out_rms_mm:.3f} mm RMS "
            f"(expected: at most {LEAVE_ONE_OUT_RMS_MM.good:g} mm)",
            "focus the camera on the skin, and press the board evenly",
        ),
        _make_check_result(
            LEAVE_ONE_OUT_MAX_MM.level(board.leave_one_out_max_mm),
            f"Worst pin: predicted to {board.leave_one_out_max_mm:.3f} mm (expected: at most {LEAVE_ONE_OUT_MAX_MM.good:g} mm)",
            "find it in the error map below; look there for dirt on the skin, a reflection, or a bent pin of the board",
        ),
        _make_check_result(
            SCALE_ERROR.level(scale_error),
            f"Scale: one pixel is {board.mm_per_px:.5f} mm ± {scale_error:.2%} "
            f"(expected: at most ± {SCALE_ERROR.good:.1%})",
            "focus the camera on the skin, and press the board evenly",
        ),
        _make_check_result(
            CONTRAST_TO_NOISE.level(contrast),
            f"Imprints: {board.contrast_grey_levels:.1f} grey levels deep, {contrast:.0f} times the camera's noise "
            f"(expected: at least {CONTRAST_TO_NOISE.good:g} times)",
            "press harder, give more light and less gain, or average several images",
        ),
    ]


def _check_ball(ball: BallQuality) -> list[CheckResult]:
    """How good the depth calibration is."""
    return [
        _make_check_result(
            OVEREXPOSED.level(ball.overexposed_fraction),
            f"Light: {ball.overexposed_fraction:.1%} of the untouched image is overexposed "
            f"(expected: at most {OVEREXPOSED.good:.0%})",
            "lower the exposure, the gain or the light",
        ),
        _make_check_result(
            UNEVEN_BULGE.level(ball.asymmetry),
            f"Press: the bulge around the ball is uneven by {ball.asymmetry:.1%} of the ball's darkening "
            f"(expected: at most {UNEVEN_BULGE.good:.0%})",
            "the ball was sheared: press it straight down",
        ),
        _make_check_result(
            RANGE_MM.level(ball.range_mm),
            f"Range: depth is calibrated down to {ball.range_mm:.2f} mm (expected: at least {RANGE_MM.good:g} mm)",
            "press the ball deeper, 1 to 2 mm",
        ),
        _make_check_result(
            CROSS_VALIDATION_MAE_MM.level(ball.cross_validation_mae_mm),
            f"Depth: half of the ball, read with the curve of the other half, is {ball.cross_validation_mae_mm:.3f} mm off "
            f"on average (expected: at most {CROSS_VALIDATION_MAE_MM.good:g} mm)",
            "press a clean ball straight down, and check that its radius is the stated one",
        ),
        _make_check_result(
            NOISE_MM.level(ball.noise_mm),
            f"Noise: the depth of one pixel scatters by {ball.noise_mm:.4f} mm from image to image "
            f"(expected: at most {NOISE_MM.good:g} mm)",
            "give more light and less gain",
        ),
    ]


def _make_check_result(level: CheckLevel, fact: str, advice: str) -> CheckResult:
    """The fact alone where it passes, with the advice where not."""
    return CheckResult(level, f"{fact}." if level == "pass" else f"{fact}. To do: {advice}, and calibrate again.")


def _missing_pins_in_words(board: BoardQuality) -> str:
    """The names of the missing pins, where there are any."""
    return f"; predicted from the others: {'; '.join(board.missing_pins)}" if board.missing_pins else ""
