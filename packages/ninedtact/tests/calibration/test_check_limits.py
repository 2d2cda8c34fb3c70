"""The checks of a certificate: their limits as documented, and what they say."""

import re
from pathlib import Path

import msgspec
import numpy as np
import pytest

from ninedtact.calibration.certificate.checks import (
    BALL_CHECKS,
    BOARD_CHECKS,
    certificate_headline,
    compute_certificate_checks,
    relative_contact_radius,
    unusual_fit_warnings,
)
from ninedtact.calibration.sensor_toml_schema import BallQuality, BoardQuality, Certificate
from ninedtact.design import SensorDesign

BOARD = BoardQuality(63, 63, [], 0.05, 0.15, 0.07, 0.05, 0.0002, 20.0, 1.0, "lens", 0)
BALL = BallQuality("ratio", 60.0, 3.1, 4.0, 1.5, 0.012, 0.014, 1.48, 0.002, 50.0, 0.02, 0.0)


def number_in(cell: str) -> float | None:
    """The limit in a cell of the table, None where it is in words."""
    number = re.search(r"\d+(?:\.\d+)?", cell)
    return None if number is None else float(number[0]) / (100 if "%" in cell else 1)


def test_the_documentation_states_every_check_with_its_limits() -> None:
    page = (Path(__file__).parents[4] / "docs" / "calibrating.md").read_text(encoding="utf-8")
    checks = [(check.fact(BOARD), check.limit) for check in BOARD_CHECKS]
    checks += [(check.fact(BALL), check.limit) for check in BALL_CHECKS]
    for fact, limit in checks:
        name = fact.partition(":")[0]
        row = re.search(rf"^\| {name} \|(.*?)\|(.*?)\|", page, re.MULTILINE)
        assert row is not None, name
        good, usable = map(number_in, row.groups())
        assert good in (None, pytest.approx(limit.good)) and usable in (None, pytest.approx(limit.usable)), name


@pytest.mark.parametrize(
    ("depth_mm", "contact_mm", "relative"),
    [(1.0, 3.0, 3 / np.sqrt(7)), (4.0, 4.4, 1.1), (5.0, 4.0, 1.0), (0.0, 1.0, np.inf)],
)
def test_a_contact_is_compared_with_the_section_of_the_ball(
    depth_mm: float, contact_mm: float, relative: float
) -> None:
    ball = msgspec.structs.replace(BALL, max_indentation_mm=depth_mm, contact_radius_mm=contact_mm)
    assert relative_contact_radius(ball) == pytest.approx(relative)


def test_a_fit_is_unusual_from_three_deviations_on() -> None:
    assert unusual_fit_warnings(3.2, SensorDesign()) == []
    (warning,) = unusual_fit_warnings(3.3, SensorDesign())
    assert "3.3 standard deviations; at most 3.2" in warning and "2.5 mm apart" in warning


def test_a_sensor_without_a_ball_rectifies_images() -> None:
    headline = certificate_headline(Certificate(board=BOARD, warnings=["no ball yet"]))
    assert headline.startswith("This sensor rectifies images in a program (load_sensor(…).rectification). All 5 checks")
    assert compute_certificate_checks(Certificate()) == []


def test_a_correction_and_the_missing_pins_are_named() -> None:
    corrected = msgspec.structs.replace(
        BOARD, uncorrected_rms_mm=0.0814, pins_found=62, missing_pins=["column 3, row 5"]
    )
    for board, named in ((BOARD, False), (corrected, True)):
        pins, lens, *_ = (line.text for line in compute_certificate_checks(Certificate(board=board)))
        assert ("with a smooth correction on top of the lens model, 0.081 mm without" in lens) == named
        assert ("predicted from the others: column 3, row 5" in pins) == ("predicted" in pins) == named
