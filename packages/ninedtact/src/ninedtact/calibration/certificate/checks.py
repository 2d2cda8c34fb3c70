"""The checks of a calibration certificate: each figure with its level (pass, warn or fail), what was expected, and advice. In: a
`Certificate`. Out: one `CheckResult` per figure, the overall level and a headline.

`BOARD_CHECKS`, `BALL_CHECKS`, `SECOND_BALL_CHECKS`, `FLAT_END_CHECKS` and `LENGTH_CHECKS` are all checks: a new one is one more
entry there. The limits follow from what a user of the sensor needs, not from what sensors usually reach; the comment above each
check states the reason. Every check says what a figure beyond its limit affects: shape, force or the twin.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import inf, sqrt
from typing import Generic, Literal, TypeVar

from ninedtact.calibration.certificate.length_evidence import relative_radius_std
from ninedtact.calibration.sensor_toml_schema import (
    MAX_ASYMMETRY,
    MAX_MISSING_FRACTION,
    BallQuality,
    BoardQuality,
    Certificate,
    LengthPlausibility,
    SecondPressQuality,
)
from ninedtact.design import Gel, SecondKind

Use = Literal["shape", "force", "twin"]
"""What a calibration is used for."""
USES: tuple[Use, ...] = ("shape", "force", "twin")
CheckLevel = Literal["pass", "warn", "fail"]
"""The levels of a check, from best to worst."""
OverallLevel = Literal["pass", "warn", "poor", "fail"]
"""The levels of a certificate, from best to worst."""
WRONG_PITCH, WRONG_RADIUS = "wrong pitch of the board", "wrong radius of the ball"
_LITTLE_GAIN = 0.8
"""Share of the error of the depth that is left, above which a second press adds little."""
_MANY_WARNED_CHECKS = 4
"""Number of checks that warn from which the whole calibration is poor: a single press explains up to three of them."""


@dataclass(frozen=True)
class CheckResult:
    """The result of one check."""

    level: CheckLevel
    text: str
    affects: tuple[Use, ...]
    """What the figure affects where it is beyond its limit."""
    cause: str = "unknown"
    """What usually causes a figure beyond its limit."""
    remedy: str = ""
    """What to do where the check does not pass."""


@dataclass(frozen=True)
class CheckLimit:
    """Limits of a figure: up to `good` it passes, up to `usable` it gives a warning; where `good` is the larger, larger figures are
    better.
    """

    good: float
    usable: float

    def level(self, value: float) -> CheckLevel:
        """Return the level of a value; not-a-number fails."""
        sign = 1 if self.good < self.usable else -1
        if sign * value <= sign * self.good:
            return "pass"
        return "warn" if sign * value <= sign * self.usable else "fail"


Quality = TypeVar("Quality", BoardQuality, BallQuality, SecondPressQuality, LengthPlausibility)


@dataclass(frozen=True)
class CertificateCheck(Generic[Quality]):
    """One check: a figure of the certificate, its limits, and the sentences about it."""

    figure: Callable[[Quality], float]
    limit: CheckLimit
    expected: str
    """The limit in words, with its number in braces; empty where the fact says it."""
    fact: Callable[[Quality], str]
    advice: str
    """What to do where the check does not pass."""
    affects: tuple[Use, ...] = USES
    cause: Callable[[Quality], str] = lambda quality: "unknown"

    def result(self, quality: Quality) -> CheckResult:
        """Return the level with the fact alone where the check passes, and with the advice otherwise."""
        level = self.limit.level(self.figure(quality))
        expected = f" (expected: {self.expected.format(self.limit.good)})" if self.expected else ""
        advice = "" if level == "pass" else f" To do: {self.advice}, and calibrate again."
        text = f"{self.fact(quality)}{expected}.{advice}"
        return CheckResult(level, text, self.affects, self.cause(quality), self.advice)


def relative_contact_radius(ball: BallQuality) -> float:
    """Return the radius of the contact over that of the ball's section at the depth of the press."""
    above_mm = max(ball.ball_radius_mm - ball.max_indentation_mm, 0.0)
    section_mm = sqrt(max(ball.ball_radius_mm**2 - above_mm**2, 0.0))
    return ball.contact_radius_mm / section_mm if section_mm > 0 else inf


def relative_depth_per_radius(ball: BallQuality) -> float:
    """Return the relative decrease of the depth per relative increase of the stated radius: that of the ball's cap over a circle
    of one size, since the image shows the circle.
    """
    above_mm = ball.ball_radius_mm - ball.max_indentation_mm
    return ball.ball_radius_mm / above_mm if above_mm > 0 else inf


_OF_LENS: tuple[Use, ...] = ("shape", "twin")
_OF_READINGS: tuple[Use, ...] = ("shape", "force")
LEAVE_ONE_OUT_RMS_MM = CheckLimit(0.06, 0.1)
CONTRAST_TO_NOISE = CheckLimit(14.0, 0.0)

BOARD_CHECKS: tuple[CertificateCheck[BoardQuality], ...] = (
    # A complete board leaves no corner of the view to extrapolation; the upper limit is that of the board fit.
    CertificateCheck(
        lambda board: 1 - board.pins_found / board.pins_expected,
        CheckLimit(0.0, MAX_MISSING_FRACTION),
        "",
        lambda board: (
            f"Pins: found {board.pins_found} of {board.pins_expected}"
            + (f"; predicted from the others: {'; '.join(board.missing_pins)}" if board.missing_pins else "")
        ),
        "press harder there, or hold the board flatter",
        _OF_LENS,
        lambda board: "board pressed unevenly",
    ),
    # The lower limit is about one rectified pixel; beyond two, the map is visibly worse than the resolution of its image.
    CertificateCheck(
        lambda board: board.leave_one_out_rms_mm,
        LEAVE_ONE_OUT_RMS_MM,
        "at most {:g} mm",
        lambda board: (
            f"Lens: a pin left out of the fit is predicted to {board.leave_one_out_rms_mm:.3f} mm RMS"
            f"{_correction_in_words(board)}"
        ),
        "focus the camera on the skin, and press the board evenly",
        _OF_LENS,
    ),
    # Three times the limits of the RMS. The largest of some sixty random errors is about twice their RMS, so a larger one is a
    # single wrong pin.
    CertificateCheck(
        lambda board: board.leave_one_out_max_mm,
        CheckLimit(0.18, 0.3),
        "at most {:g} mm",
        lambda board: f"Worst pin: predicted to {board.leave_one_out_max_mm:.3f} mm",
        "find it in the certificate's error map; look there for dirt on the skin, a reflection, or a bent pin of the board",
        _OF_LENS,
    ),
    # Relative error of the scale: 0.05 mm, then 0.1 mm on an object of 10 mm, the size of a typical object at a fingertip.
    CertificateCheck(
        lambda board: board.mm_per_px_std / board.mm_per_px,
        CheckLimit(0.005, 0.01),
        "at most ± {:.1%}",
        lambda board: f"Scale: one pixel is {board.mm_per_px:.5f} mm ± {board.mm_per_px_std / board.mm_per_px:.2%}",
        "focus the camera on the skin, and press the board evenly",
    ),
    # Ten times the noise of the difference of two images. Below the limit, noise moves the centre of a pin by more than a tenth of
    # its width. That raises the leave-one-out error, which fails; this check names the cause.
    CertificateCheck(
        lambda board: board.contrast_grey_levels / board.noise_grey_levels,
        CONTRAST_TO_NOISE,
        "at least {:g} times",
        lambda board: (
            f"Imprints: {board.contrast_grey_levels:.1f} grey levels deep, "
            f"{board.contrast_grey_levels / board.noise_grey_levels:.0f} times the camera's noise"
        ),
        "press harder, give more light and less gain, or average several images",
        _OF_LENS,
        lambda board: "board pressed lightly",
    ),
)
BALL_CHECKS: tuple[CertificateCheck[BallQuality], ...] = (
    # Overexposed skin cannot brighten and darkens late, so heights there are wrong without any sign of it.
    CertificateCheck(
        lambda ball: ball.overexposed_fraction,
        CheckLimit(0.01, 0.05),
        "at most {:.0%}",
        lambda ball: f"Light: {ball.overexposed_fraction:.1%} of the reference image is overexposed",
        "lower the exposure, the gain or the light",
        cause=lambda ball: "overexposed",
    ),
    # The effect of a sheared press on depth is measured by the halves of the disc, whose check fails.
    CertificateCheck(
        lambda ball: ball.asymmetry,
        CheckLimit(MAX_ASYMMETRY, inf),
        "at most {:.0%}",
        lambda ball: f"Press: the bulge around the ball is uneven by {ball.asymmetry:.1%} of the ball's darkening",
        "the ball was sheared, so that depths may be off by a tenth of a millimetre: press it straight down",
        cause=lambda ball: "ball pressed askew",
    ),
    # The gel rises around the ball by up to a tenth of the section's radius; a larger contact belongs to another ball.
    CertificateCheck(
        relative_contact_radius,
        CheckLimit(1.2, 1.35),
        "at most {:g} times",
        lambda ball: (
            f"Contact: {ball.contact_radius_mm:.2f} mm in radius at {ball.max_indentation_mm:.2f} mm depth, "
            f"{relative_contact_radius(ball):.2f} times the section of the ball there; were the ball 1 % larger than stated, this "
            f"depth would be {relative_depth_per_radius(ball):.1f} % too large"
        ),
        "check that the ball's radius is the stated one, and that nothing presses beside it",
        cause=lambda ball: WRONG_RADIUS,
    ),
    # A firm grasp presses soft gel by about a millimetre; beyond the range, depth is not calibrated.
    CertificateCheck(
        lambda ball: ball.range_mm,
        CheckLimit(1.0, 0.5),
        "at least {:g} mm",
        lambda ball: f"Range: depth is calibrated down to {ball.range_mm:.2f} mm",
        "press the ball deeper, 1 to 2 mm",
        _OF_READINGS,
        lambda ball: "ball pressed lightly",
    ),
    # The published sensor measures balls outside its calibration to 0.046 mm (docs/references.md), and the calibration must leave a
    # margin for all other errors. An error above a seventh of a millimetre, more than a sheared press causes, is unusable.
    CertificateCheck(
        lambda ball: ball.cross_validation_mae_mm,
        CheckLimit(0.03, 0.15),
        "at most {:g} mm",
        lambda ball: (
            "Depth: half of the ball, read with the curve of the other half, is "
            f"{ball.cross_validation_mae_mm:.3f} mm off on average"
        ),
        "press a clean ball straight down, and check that its radius is the stated one",
        _OF_READINGS,
    ),
    # The smallest detectable contact is five times the noise. Noise up to 0.01 mm leaves it at 0.05 mm
    # (`shape.surface.ContactRule`); at 0.03 mm light touches of 0.15 mm are not detected.
    CertificateCheck(
        lambda ball: ball.noise_mm,
        CheckLimit(0.01, 0.03),
        "at most {:g} mm",
        lambda ball: f"Noise: the depth of one pixel scatters by {ball.noise_mm:.4f} mm from image to image",
        "give more light and less gain",
        _OF_READINGS,
        lambda ball: "noisy camera",
    ),
)
SECOND_BALL_CHECKS: tuple[CertificateCheck[SecondPressQuality], ...] = (
    # In standard deviations: beyond two, one of twenty right radii is suspected. An unknown base hides a part of a wrong radius.
    CertificateCheck(
        lambda second: second.stated_deviation,
        CheckLimit(2.0, inf),
        "within {:g} standard deviations",
        lambda second: (
            f"Second ball: beside the first one, its images are those of a radius of {second.likely_mm:.2f} ± "
            f"{second.likely_std_mm:.2f} mm, stated are {second.stated_mm:g} mm"
        ),
        "measure both balls with a calliper",
        cause=lambda second: WRONG_RADIUS,
    ),
)
FLAT_END_CHECKS: tuple[CertificateCheck[SecondPressQuality], ...] = (
    CertificateCheck(
        lambda second: second.stated_deviation,
        CheckLimit(2.0, inf),
        "within {:g} standard deviations",
        lambda second: (
            f"Flat end: beside the ball, its image is that of a depth of {second.likely_mm:.2f} ± {second.likely_std_mm:.2f} mm, "
            f"the stop says {second.stated_mm:.2f} ± {second.stated_std_mm:.2f} mm"
        ),
        "measure the stop, the rod and the ball with a calliper, and let the rod just touch where the stop is set",
    ),
)
LENGTH_CHECKS: tuple[CertificateCheck[LengthPlausibility], ...] = (
    # Of the population with right lengths, 6 % is beyond (`certificate.length_evidence`). A wrong length that is
    # noticed late costs more than a measurement with a calliper.
    CertificateCheck(
        lambda lengths: lengths.wrong_probability,
        CheckLimit(0.12, inf),
        "at most {:.0%}",
        lambda lengths: (
            f"Lengths: compared with sensors of this design, {lengths.pitch_mm:g} mm between the pins of the board is wrong with a "
            f"probability of {lengths.pitch_wrong_probability:.0%} and the ball's radius of {lengths.ball_radius_mm:g} mm with "
            f"{lengths.ball_radius_wrong_probability:.0%}, though they tell a radius to ± {relative_radius_std():.0%} only"
            f"{_likely_lengths_in_words(lengths)}"
        ),
        "measure pins and ball with a calliper (a wrong length makes all depths and forces wrong), give the right lengths",
        cause=lambda lengths: (
            WRONG_PITCH if lengths.pitch_wrong_probability >= lengths.ball_radius_wrong_probability else WRONG_RADIUS
        ),
    ),
)


def compute_certificate_checks(certificate: Certificate) -> list[CheckResult]:
    """Return every check, beginning with the board's; those of a press that was not made are left out."""
    return [
        *_check_results(BOARD_CHECKS, certificate.board),
        *_check_results(BALL_CHECKS, certificate.ball),
        *_check_results(SECOND_BALL_CHECKS, certificate.second_ball),
        *_check_results(FLAT_END_CHECKS, certificate.flat_end),
        *_check_results(LENGTH_CHECKS, certificate.lengths),
    ]


def _check_results(checks: tuple[CertificateCheck[Quality], ...], quality: Quality | None) -> list[CheckResult]:
    """Return the results of the checks of one part; none where it was not pressed."""
    return [] if quality is None else [check.result(quality) for check in checks]


def press_through_gel_warnings(depth_mm: float, gel: Gel) -> list[str]:
    """Return a warning where the ball would have been pressed through the gel of the design."""
    if depth_mm < gel.thickness_mm:
        return []
    return [
        f"the ball was pressed {depth_mm:.2f} mm deep into a gel of {gel.thickness_mm:.2f} mm, which is impossible: check the "
        "gel's thickness in the design and the radius of the ball"
    ]


def little_gain_warnings(second: Mapping[SecondKind, SecondPressQuality]) -> list[str]:
    """Return a warning for each second press that tells hardly more than the first."""
    return [
        f"the {kind.replace('_', ' ')} (radius {one.radius_mm:g} mm, pressed {one.max_indentation_mm:.2f} mm deep) adds little: "
        f"the depth of the first is known to {one.first_std_mm:.2g} mm with it and to {one.first_std_alone_mm:.2g} mm "
        "without; ninedtact calibrate --plan says which press adds most"
        for kind, one in second.items()
        if one.first_std_mm > _LITTLE_GAIN * one.first_std_alone_mm
    ]


def overall_check_level(certificate: Certificate) -> OverallLevel:
    """Return the overall level: that of the worst check, poor where many checks warn, and never a pass where there are warnings."""
    levels = [line.level for line in compute_certificate_checks(certificate)]
    if "fail" in levels:
        return "fail"
    if levels.count("warn") >= _MANY_WARNED_CHECKS:
        return "poor"
    return "warn" if "warn" in levels or certificate.warnings or certificate.cause else "pass"


def has_failed_checks(certificate: Certificate | None) -> bool:
    """Return whether a check failed; a sensor without a certificate, such as an imported one, has no checks that could fail."""
    return certificate is not None and overall_check_level(certificate) == "fail"


def certificate_headline(certificate: Certificate) -> str:
    """Return the overall result in a sentence or two."""
    lines, level = compute_certificate_checks(certificate), overall_check_level(certificate)
    checks = _outcome_in_words(lines)
    if level == "pass":
        return f"This sensor is ready to measure. {checks}."
    if level == "fail":
        return f"Do not measure with this calibration. {checks}; the lines below say what to do."
    if level == "poor":
        return f"Calibrate again before you rely on this sensor. {checks}; the lines below say what to do."
    if certificate.ball is None:
        return (
            f"This sensor rectifies images in a program (load_sensor(…).rectification). {checks}; heights and force need a press "
            "of the ball, see the warnings."
        )
    if all(line.level == "pass" for line in lines):
        return f"This sensor can be used with care. {checks}, but read the warnings."
    return f"This sensor can be used with care. {checks}; the lines below say what to do."


def uses_in_words(uses: tuple[Use, ...]) -> str:
    """Return what is affected, in words."""
    return f"affects {', '.join(uses[:-1])} and {uses[-1]}" if len(uses) > 1 else f"affects {uses[0]}"


def _outcome_in_words(lines: Sequence[CheckResult]) -> str:
    """Return how many checks failed or, where none did, how many warned, and what they affect, in words."""
    for level, outcome in (("fail", "failed"), ("warn", "warned")):
        found = [line for line in lines if line.level == level]
        if found:
            affected = uses_in_words(tuple(use for use in USES if any(use in line.affects for line in found)))
            return f"{len(found)} of {len(lines)} checks {outcome} ({affected})"
    return f"All {len(lines)} checks passed"


def _correction_in_words(board: BoardQuality) -> str:
    """Return that a smooth correction on top of the lens model is used, and the error without it, or an empty text."""
    before_mm = board.uncorrected_rms_mm
    return (
        "" if before_mm is None else f" with a smooth correction on top of the lens model, {before_mm:.3f} mm without"
    )


def _likely_lengths_in_words(lengths: LengthPlausibility) -> str:
    """Return the length that fits better where one may be wrong, or an empty text."""
    if lengths.wrong_probability <= LENGTH_CHECKS[0].limit.good:
        return ""
    if lengths.pitch_wrong_probability >= lengths.ball_radius_wrong_probability:
        return f"; a pitch of {lengths.likely_pitch_mm:.1f} mm fits better"
    return f"; a radius of {lengths.likely_ball_radius_mm:.1f} mm fits better"
