"""The page that a person reads: complete, self-contained, harmless, and honest when a figure gets worse."""

import re
from base64 import b64decode
from dataclasses import dataclass, replace
from html.parser import HTMLParser
from pathlib import Path
from typing import get_args

import cv2
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ninedtact.calibration.board.detection import BoardNotFound
from ninedtact.calibration.certificate.checks import (
    BALL_CHECKS,
    BOARD_CHECKS,
    FLAT_END_CHECKS,
    LENGTH_CHECKS,
    SECOND_BALL_CHECKS,
    USES,
    CheckLevel,
    CheckResult,
    OverallLevel,
    certificate_headline,
    compute_certificate_checks,
    overall_check_level,
)
from ninedtact.calibration.certificate.html_page import render_certificate_html
from ninedtact.calibration.certificate.plot_board import draw_board_not_found
from ninedtact.calibration.procedure import Calibration
from ninedtact.calibration.sensor_toml_schema import (
    BallQuality,
    BoardQuality,
    Certificate,
    LengthPlausibility,
    SecondPressQuality,
)

HOSTILE = "<script>alert('id')<b> & \"co\""
GOOD = Certificate(
    BoardQuality(63, 63, [], 0.03, 0.07, 0.06, 0.052, 0.0001, 20.0, 0.6, "model", 0),
    BallQuality("ratio", 60.0, 3.1, 4.0, 1.5, 0.012, 0.014, 1.48, 0.002, 50.0, 0.02, 0.0),
    SecondPressQuality(2.5, 0.8, 0.03, 0.5, 1.75, 0.04, 1.78, 0.09, 2.5, 0.0, 2.52, 0.06),
    SecondPressQuality(3.0, 0.61, 0.02, 0.3, 1.74, 0.05, 1.78, 0.09, 0.6, 0.03, 0.63, 0.03),
    LengthPlausibility(2.5, 0.02, 2.4, 4.0, 0.03, 4.1),
)
WORSE_WHEN_LARGER = {
    "board": ("leave_one_out_rms_mm", "leave_one_out_max_mm", "mm_per_px_std", "noise_grey_levels"),
    "ball": ("cross_validation_mae_mm", "noise_mm", "asymmetry", "overexposed_fraction", "contact_radius_mm"),
    "lengths": ("pitch_wrong_probability", "ball_radius_wrong_probability"),
}
WORSE_WHEN_SMALLER = {"board": ("pins_found", "contrast_grey_levels"), "ball": ("range_mm",)}
FIGURES = [
    (part, name, worse)
    for worse, table in ((1, WORSE_WHEN_LARGER), (-1, WORSE_WHEN_SMALLER))
    for part, names in table.items()
    for name in names
]


class Page(HTMLParser):
    """Elements, their attributes, and the words between them."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.styles, self.words, self._inside = "", "", ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._inside = tag

    def handle_data(self, data: str) -> None:
        if self._inside == "style":
            self.styles += data
        else:
            self.words += data

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""


@dataclass(frozen=True)
class Read:
    calibration: Calibration
    html: str
    page: Page


def read(calibration: Calibration) -> Read:
    html = render_certificate_html(calibration)
    return Read(calibration, html, Page(html))


@pytest.fixture(scope="module")
def hostile(calibrated_twin: Calibration) -> Read:
    """A twin as if two pins had left no imprint, under a hostile name."""
    certificate = calibrated_twin.record.certificate
    assert certificate is not None
    for name, value in (("pins_found", 61), ("missing_pins", ["column 3, row 5", "column 9, row 2"])):
        certificate = with_figure(certificate, "board", name, value)
    record = msgspec.structs.replace(calibrated_twin.record, id=HOSTILE, certificate=certificate)
    return read(replace(calibrated_twin, record=record))


def words_of(page: Page) -> str:
    return " ".join(page.words.split())


@pytest.mark.parametrize(("sensor", "images"), [("calibrated_twin", 6), ("calibrated_a", 8)])
def test_page_needs_nothing_from_outside(sensor: str, images: int, request: pytest.FixtureRequest) -> None:
    made = read(request.getfixturevalue(sensor))
    loads = [
        value
        for _, attributes in made.page.elements
        for name, value in attributes.items()
        if name in {"src", "href", "srcset", "data", "poster", "action", "background", "xlink:href"}
    ]
    assert len(loads) == images
    assert all(value is not None and value.startswith("data:image/png;base64,") for value in loads)
    assert "url(" not in made.page.styles and "@import" not in made.page.styles
    assert not {"script", "link", "iframe", "object", "embed", "form"} & {tag for tag, _ in made.page.elements}
    assert "://" not in made.html and len(made.html) < 2e6
    for value in loads:
        image = cv2.imdecode(np.frombuffer(b64decode(str(value).split(",")[1]), np.uint8), cv2.IMREAD_COLOR)
        assert min(image.shape[:2]) > 500 and image.std() > 5


def test_hostile_sensor_id_is_words_and_nothing_else(hostile: Read) -> None:
    assert HOSTILE in hostile.page.words
    assert "<script" not in hostile.html


def test_page_says_what_the_record_holds(hostile: Read) -> None:
    record, words = hostile.calibration.record, words_of(hostile.page)
    assert record.certificate is not None
    board, ball = record.certificate.board, record.certificate.ball
    for figure in (
        record.created.strftime("%Y-%m-%d"),
        record.software,
        "61 of 63",
        "column 9, row 2",
        "column 3, row 5",
        f"{board.leave_one_out_rms_mm:.3f} mm",
        f"{board.leave_one_out_max_mm:.3f} mm",
        f"{board.published_method_rms_mm:.3f} mm",
        f"{board.mm_per_px:.5f} ± {board.mm_per_px_std:.5f} mm",
        f"{460 * board.mm_per_px:.2f} × {345 * board.mm_per_px:.2f} mm",
        f"{ball.contact_radius_px:.1f} pixels",
        f"{ball.reconstruction_mae_mm:.3f} mm",
        f"{ball.cross_validation_mae_mm:.3f} mm",
        f"{ball.noise_mm:.4f} mm",
        f"{ball.range_mm:.2f} mm",
        f"{ball.asymmetry:.1%}",
        "pitch 2.5 mm",
        "sensor.toml",
        certificate_headline(record.certificate),
        *(line.text for line in compute_certificate_checks(record.certificate)),
    ):
        assert figure in words, figure
    for warning in record.certificate.warnings:
        assert warning[1:] in words


def test_real_sensor_passes(calibrated_a: Calibration) -> None:
    certificate = calibrated_a.record.certificate
    assert certificate is not None and overall_check_level(certificate) == "pass" and not certificate.warnings
    assert certificate.ball.method == "physics" and certificate.ball.reconstruction_mae_mm <= 0.027
    assert "ready" in certificate_headline(certificate)


def test_every_check_fails_by_its_own_figure_alone_and_says_what_to_do() -> None:
    assert {line.level for line in compute_certificate_checks(GOOD)} == {"pass"} == {overall_check_level(GOOD)}
    assert not any("To do" in line.text for line in compute_certificate_checks(GOOD))
    for part, name, worse in FIGURES:
        lines = compute_certificate_checks(with_figure(GOOD, part, name, 1e9 if worse > 0 else 0))
        bad = [line for line in lines if line.level != "pass"]
        assert len(bad) == 1, name
        assert "To do: " in bad[0].text
        lines = compute_certificate_checks(with_figure(GOOD, part, name, np.nan))
        assert [line.level for line in lines].count("fail") == 1, name


@given(st.sampled_from(FIGURES), st.data())
def test_worse_figure_never_improves_a_line(figure: tuple[str, str, int], data: st.DataObject) -> None:
    part, name, worse = figure
    values = st.integers(0, 63) if name == "pins_found" else st.floats(0, 100)
    better, poorer = sorted([data.draw(values), data.draw(values)], reverse=worse < 0)
    if name == "noise_grey_levels":
        better, poorer = better + 0.1, poorer + 0.1
    first, second = (with_figure(GOOD, part, name, value) for value in (better, poorer))
    assert all(
        rank(one) <= rank(two)
        for one, two in zip(compute_certificate_checks(first), compute_certificate_checks(second), strict=True)
    )
    levels = get_args(OverallLevel)
    assert levels.index(overall_check_level(first)) <= levels.index(overall_check_level(second))


def test_refused_board_is_drawn_with_the_spots_that_were_seen() -> None:
    change = -20 * np.random.default_rng(0).random((240, 320)).astype(np.float32)
    seen_px = np.array([[50.0, 60.0], [200.5, 100.25]])
    overlay = draw_board_not_found(BoardNotFound("no board", 2, 63, seen_px, change))
    assert overlay.shape == (240, 320, 3) and overlay.dtype == np.uint8
    rows, cols = np.nonzero(np.ptp(overlay.astype(int), axis=2) > 60)
    distance = np.hypot(cols[:, None] - seen_px[:, 0], rows[:, None] - seen_px[:, 1])
    assert (distance.min(axis=0) < 8).all() and (distance.min(axis=1) < 10).all()
    nowhere = np.array([[1e12, 3.0], [np.nan, 2.0]])
    assert draw_board_not_found(BoardNotFound("no board", 0, 63, nowhere, change)).shape == (240, 320, 3)


def with_figure(certificate: Certificate, part: str, name: str, value: float | list[str]) -> Certificate:
    figures = msgspec.structs.replace(getattr(certificate, part), **{name: value})
    return msgspec.structs.replace(certificate, **{part: figures})


def rank(line: CheckResult) -> int:
    return get_args(CheckLevel).index(line.level)


def number_in(cell: str) -> float | None:
    """The limit in a cell of the table, None where it is in words."""
    number = re.search(r"\d+(?:\.\d+)?", cell)
    return None if number is None else float(number[0]) / (100 if "%" in cell else 1)


def test_the_documentation_states_every_check_with_its_limits() -> None:
    page = (Path(__file__).parents[4] / "docs" / "calibrating.md").read_text(encoding="utf-8")
    checks = [(check.fact(GOOD.board), check.limit) for check in BOARD_CHECKS]
    checks += [(check.fact(GOOD.ball), check.limit) for check in BALL_CHECKS]
    checks += [(check.fact(GOOD.second_ball), check.limit) for check in SECOND_BALL_CHECKS]
    checks += [(check.fact(GOOD.flat_end), check.limit) for check in FLAT_END_CHECKS]
    checks += [(check.fact(GOOD.lengths), check.limit) for check in LENGTH_CHECKS]
    for fact, limit in checks:
        name = fact.partition(":")[0]
        row = re.search(rf"^\| {name} \|(.*?)\|(.*?)\|", page, re.MULTILINE)
        assert row is not None, name
        good, usable = map(number_in, row.groups())
        assert good in (None, pytest.approx(limit.good)) and usable in (None, pytest.approx(limit.usable)), name


def test_a_check_that_is_not_passed_names_what_it_affects_and_so_does_the_headline() -> None:
    assert {use for line in compute_certificate_checks(GOOD) for use in line.affects} == set(USES)
    noisy = with_figure(GOOD, "ball", "noise_mm", 0.02)
    (line,) = [line for line in compute_certificate_checks(noisy) if line.level != "pass"]
    assert line.affects == ("shape", "force")
    assert "1 of 14 checks warned (affects shape and force)" in certificate_headline(noisy)


def test_a_sensor_without_a_ball_rectifies_images() -> None:
    headline = certificate_headline(Certificate(board=GOOD.board, warnings=["no ball yet"]))
    assert headline.startswith("This sensor rectifies images in a program (load_sensor(…).rectification). All 5 checks")
    assert compute_certificate_checks(Certificate()) == []
