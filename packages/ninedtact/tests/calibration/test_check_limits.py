"""The limits of the checks of a certificate, from both sides, and what many small faults add up to."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from ninedtact.calibration.certificate import checks
from ninedtact.calibration.certificate.checks import CheckLimit, CheckResult
from ninedtact.calibration.sensor_toml_schema import BallQuality, BoardQuality, Certificate
from ninedtact.design import SensorDesign

LIMITS = {
    "MISSING": (0.0, 0.01, 0.1, 0.11),
    "LEAVE_ONE_OUT_RMS_MM": (0.06, 0.061, 0.1, 0.101),
    "LEAVE_ONE_OUT_MAX_MM": (0.18, 0.181, 0.3, 0.301),
    "SCALE_ERROR": (0.005, 0.0051, 0.01, 0.0101),
    "OVEREXPOSED": (0.01, 0.011, 0.05, 0.051),
    "UNEVEN_BULGE": (0.08, 0.081, 9.0, np.nan),
    "CONTACT_RADIUS": (1.2, 1.21, 1.35, 1.36),
    "CROSS_VALIDATION_MAE_MM": (0.03, 0.031, 0.15, 0.151),
    "NOISE_MM": (0.01, 0.0101, 0.03, 0.031),
    "CONTRAST_TO_NOISE": (14.0, 13.9, 0.0, -0.1),
    "RANGE_MM": (1.0, 0.99, 0.5, 0.49),
}


WRITTEN_LIMITS = {
    "LEAVE_ONE_OUT_RMS_MM": "| Lens | ≤ {} mm | ≤ {} mm |",
    "LEAVE_ONE_OUT_MAX_MM": "| Worst pin | ≤ {} mm | ≤ {} mm |",
    "CONTRAST_TO_NOISE": "| Imprints | ≥ {} × noise | below |",
    "CONTACT_RADIUS": "| Contact | ≤ {} × | ≤ {} × |",
    "RANGE_MM": "| Range | ≥ {} mm | ≥ {} mm |",
    "CROSS_VALIDATION_MAE_MM": "| Depth | ≤ {} mm | ≤ {} mm |",
    "NOISE_MM": "| Noise | ≤ {} mm | ≤ {} mm |",
}
"""Limits in the units in which the documentation states them."""


@pytest.mark.parametrize("name", WRITTEN_LIMITS)
def test_the_documentation_states_the_limits(name: str) -> None:
    page = (Path(__file__).parents[4] / "docs" / "calibrating.md").read_text(encoding="utf-8")
    assert WRITTEN_LIMITS[name].format(*(f"{LIMITS[name][end]:g}" for end in (0, 2))) in page


def bare(kind: type[Any], **values: object) -> Any:
    """One of this kind of which nothing else is asked."""
    return kind(**dict.fromkeys(kind.__struct_fields__) | values)


@pytest.mark.parametrize("name", LIMITS)
def test_a_figure_passes_up_to_its_limit_and_fails_beyond_the_second(name: str) -> None:
    limit: CheckLimit = getattr(checks, name)
    assert [limit.level(value) for value in LIMITS[name]] == ["pass", "warn", "warn", "fail"]
    assert limit.level(np.nan) == "fail"


def test_the_shares_of_the_board_are_checked() -> None:
    good = BoardQuality(63, 63, [], 0.05, 0.15, 0.07, 0.05, 0.0002, 20.0, 1.0, "lens", 0)

    def levels(**changed: object) -> list[str]:
        return [result.level for result in checks._check_board(msgspec.structs.replace(good, **changed))]

    assert set(levels()) == {"pass"}
    for changed, level in (({"pins_found": 60}, "warn"), ({"pins_found": 50}, "fail")):
        assert levels(**changed)[0] == level and set(levels(**changed)[1:]) == {"pass"}
    for scale, level in ((0.0003, "warn"), (0.0006, "fail")):
        assert sorted(set(levels(mm_per_px_std=scale))) == sorted({"pass", level})
    assert "warn" in levels(noise_grey_levels=1.5) and "fail" not in levels(noise_grey_levels=1.5)


@pytest.mark.parametrize(
    ("levels", "warnings", "overall"),
    [
        ("pass " * 5, (), "pass"),
        ("pass " * 5, ("read this",), "warn"),
        ("pass warn warn warn", (), "warn"),
        ("pass warn warn warn warn", (), "poor"),
        ("pass warn warn warn warn fail", (), "fail"),
    ],
)
def test_the_whole_is_as_good_as_its_worst_check_and_poor_from_four_warnings_on(
    levels: str, warnings: tuple[str, ...], overall: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = [CheckResult(level, "") for level in levels.split()]  # type: ignore[arg-type]
    monkeypatch.setattr(checks, "compute_certificate_checks", lambda _: results)
    certificate = bare(Certificate, warnings=warnings, ball=bare(BallQuality))
    assert checks.overall_check_level(certificate) == overall
    words = {
        "pass": ("ready to measure", "All 5 checks passed"),
        "warn": ("with care", "read the warnings" if warnings else "3 of 4 checks warned"),
        "poor": ("Calibrate again", "4 of 5 checks warned"),
        "fail": ("Do not measure", "1 of 6 checks failed"),
    }
    assert all(part in checks.certificate_headline(certificate) for part in words[overall])


@pytest.mark.parametrize(
    ("depth_mm", "contact_mm", "relative"),
    [
        (1.0, 3.0, 3 / np.sqrt(7)),
        (4.0, 4.4, 1.1),
        (5.0, 4.0, 1.0),
        (3.5, 3.0, 3 / np.sqrt(15.75)),
        (0.05, 0.5, 0.5 / np.sqrt(0.3975)),
        (0.0, 1.0, np.inf),
    ],
)
def test_a_contact_is_compared_with_the_section_of_the_ball(
    depth_mm: float, contact_mm: float, relative: float
) -> None:
    ball = bare(BallQuality, ball_radius_mm=4.0, max_indentation_mm=depth_mm, contact_radius_mm=contact_mm)
    assert checks._relative_contact_radius(ball) == pytest.approx(relative)


def test_a_fit_is_unusual_from_three_deviations_on() -> None:
    assert checks.unusual_fit_warnings(3.2, SensorDesign()) == []
    (warning,) = checks.unusual_fit_warnings(3.3, SensorDesign())
    assert "3.3 standard deviations; at most 3.2" in warning and "2.5 mm apart" in warning


def test_a_sensor_without_a_ball_rectifies_images() -> None:
    board = BoardQuality(63, 63, [], 0.05, 0.15, 0.07, 0.05, 0.0002, 20.0, 1.0, "lens", 0)
    headline = checks.certificate_headline(Certificate(board=board, warnings=["no ball yet"]))
    assert headline.startswith(
        "This sensor rectifies images in a program (load_sensor(…).rectification). All 5 checks passed;"
    )
    assert (
        checks.overall_check_level(Certificate(board=board)) == "pass"
        and checks.compute_certificate_checks(Certificate()) == []
    )


def test_a_correction_and_the_missing_pins_are_named() -> None:
    plain = BoardQuality(63, 63, [], 0.05, 0.15, 0.07, 0.05, 0.0002, 20.0, 1.0, "lens", 0)
    corrected = msgspec.structs.replace(
        plain, uncorrected_rms_mm=0.0814, pins_found=62, missing_pins=["column 3, row 5"]
    )
    for board, named in ((plain, False), (corrected, True)):
        pins, lens, *_ = (line.text for line in checks._check_board(board))
        assert ("with a smooth correction on top of the lens model, 0.081 mm without" in lens) == named
        assert ("predicted from the others: column 3, row 5" in pins) == ("predicted" in pins) == named
