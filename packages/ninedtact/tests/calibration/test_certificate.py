"""The page that a person reads: complete, self-contained, harmless, and honest when a figure gets worse."""

import math
from base64 import b64decode
from dataclasses import dataclass
from html.parser import HTMLParser
from typing import get_args

import cv2
import msgspec
import numpy as np
import pytest
from drawn_presses import DrawnPresses
from hypothesis import example, given
from hypothesis import strategies as st

from ninedtact.calibration.board.detection import BoardNotFound
from ninedtact.calibration.certificate.checks import (
    CHECK_LEVELS,
    OVERALL_LEVELS,
    CheckLimit,
    CheckResult,
    certificate_headline,
    compute_certificate_checks,
    overall_check_level,
    press_through_gel_warnings,
)
from ninedtact.calibration.certificate.html_page import DEPTH_METHOD_TEXT, LENS_MODEL_TEXT, render_certificate_html
from ninedtact.calibration.certificate.plot_board import arrow_magnification
from ninedtact.calibration.certificate.plot_style import draw_board_not_found, stretch_contrast
from ninedtact.calibration.procedure import Calibration, CalibrationImages, calibrate
from ninedtact.calibration.sensor_toml_schema import BallQuality, BoardQuality, Certificate
from ninedtact.calibration.settings import CalibrationSettings, LensKind
from ninedtact.design import Gel
from ninedtact.shape.depth import DepthMethod

HOSTILE = "<script>alert('id')<b> & \"co\""
GOOD = Certificate(
    BoardQuality(63, 63, [], 0.03, 0.07, 0.06, 0.052, 0.0001, 20.0, 0.6, "model", 0),
    BallQuality("ratio", 60.0, 3.1, 4.0, 1.5, 0.012, 0.014, 1.48, 0.002, 50.0, 0.02, 0.0),
    [],
)
WORSE_WHEN_LARGER = {
    "board": ("leave_one_out_rms_mm", "leave_one_out_max_mm", "mm_per_px_std", "noise_grey_levels"),
    "ball": ("cross_validation_mae_mm", "noise_mm", "asymmetry", "overexposed_fraction", "contact_radius_mm"),
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
def drawn() -> Read:
    """Drawn images with two pins missing, under a hostile name."""
    return read(calibrate(DrawnPresses(missing=((9, 2), (3, 5))).images(), sensor_id=HOSTILE))


def words_of(page: Page) -> str:
    return " ".join(page.words.split())


def test_page_needs_nothing_from_outside(drawn: Read) -> None:
    loads = [
        value
        for _, attributes in drawn.page.elements
        for name, value in attributes.items()
        if name in {"src", "href", "srcset", "data", "poster", "action", "background", "xlink:href"}
    ]
    assert len(loads) == 8
    assert all(value is not None and value.startswith("data:image/png;base64,") for value in loads)
    assert "url(" not in drawn.page.styles and "@import" not in drawn.page.styles
    assert not {"script", "link", "iframe", "object", "embed", "form"} & {tag for tag, _ in drawn.page.elements}
    assert "://" not in drawn.html


def test_images_on_the_page_are_images_of_reasonable_size(drawn: Read) -> None:
    for tag, attributes in drawn.page.elements:
        if tag == "img":
            content = b64decode((attributes["src"] or "").split(",")[1])
            image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
            assert image is not None and min(image.shape[:2]) > 500
            assert image.std() > 5
            assert attributes["alt"]
    assert len(drawn.html) < 2e6


def test_hostile_sensor_id_is_words_and_nothing_else(drawn: Read) -> None:
    assert HOSTILE in drawn.page.words
    assert "<script" not in drawn.html


def test_page_says_what_the_record_holds(drawn: Read) -> None:
    record, words = drawn.calibration.record, words_of(drawn.page)
    assert record.certificate is not None
    board, ball = record.certificate.board, record.certificate.ball
    for figure in (
        record.created.strftime("%Y-%m-%d"),
        record.software,
        "61 of 63",
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


def test_missing_pins_are_named_on_the_page(drawn: Read) -> None:
    assert sorted(drawn.calibration.board.missing_pins) == ["column 3, row 5", "column 9, row 2"]
    words = words_of(drawn.page)
    assert "column 9, row 2" in words and "column 3, row 5" in words


def test_original_way_has_its_page_too() -> None:
    settings = CalibrationSettings(lens="paper", method="table", camera_rotation_deg=180)
    page = read(calibrate(DrawnPresses().images(), settings=settings)).page
    assert LENS_MODEL_TEXT["paper"] in words_of(page) and DEPTH_METHOD_TEXT["table"] in words_of(page)


def test_every_lens_and_method_has_words() -> None:
    assert set(LENS_MODEL_TEXT) == set(get_args(LensKind)) and set(DEPTH_METHOD_TEXT) == set(get_args(DepthMethod))


@pytest.mark.parametrize(("sensor", "level"), [("sensor_a", "pass"), ("sensor_i", "warn")])
def test_real_sensors(sensor: str, level: str, request: pytest.FixtureRequest) -> None:
    folder = request.getfixturevalue("real_data") / sensor
    names = ("board_reference", "board", "ball_reference", "ball")
    images = CalibrationImages(*(cv2.imread(str(folder / f"{name}.png")) for name in names))
    made = read(calibrate(images, sensor_id=sensor))
    certificate = made.calibration.record.certificate
    assert certificate is not None and overall_check_level(certificate) == level
    assert certificate_headline(certificate) in words_of(made.page) and len(made.html) < 2e6


def test_good_figures_pass_and_say_no_more_than_the_fact() -> None:
    assert {line.level for line in compute_certificate_checks(GOOD)} == {"pass"} == {overall_check_level(GOOD)}
    assert not any("To do" in line.text for line in compute_certificate_checks(GOOD))
    assert "ready" in certificate_headline(GOOD)


def test_lines_that_do_not_pass_say_what_to_do() -> None:
    for part, name, worse in FIGURES:
        lines = compute_certificate_checks(with_figure(GOOD, part, name, 1e9 if worse > 0 else 0))
        bad = [line for line in lines if line.level != "pass"]
        assert len(bad) == 1, name
        assert "To do: " in bad[0].text


def test_warning_alone_keeps_the_whole_from_passing() -> None:
    warned = msgspec.structs.replace(GOOD, warnings=["the light drifted"])
    assert overall_check_level(warned) == "warn" and "read the warnings" in certificate_headline(warned)


def test_many_warned_checks_are_worse_than_one() -> None:
    warned, expected = GOOD, ["pass", "warn", "warn", "warn", "poor"]
    for name, level in zip(
        ("asymmetry", "noise_mm", "overexposed_fraction", "cross_validation_mae_mm"), expected[1:], strict=True
    ):
        warned = with_figure(warned, "ball", name, {"asymmetry": 0.2, "noise_mm": 0.02}.get(name, 0.04))
        assert overall_check_level(warned) == level
    assert "4 of 11 checks warned" in certificate_headline(warned) and "Calibrate again" in certificate_headline(warned)


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
    assert OVERALL_LEVELS.index(overall_check_level(first)) <= OVERALL_LEVELS.index(overall_check_level(second))


@given(st.floats(0, 10), st.floats(0, 10), st.floats(-10, 10, allow_nan=False))
@example(0.06, 0.1, 0.06)
def test_limits_hold_on_both_sides(one: float, two: float, value: float) -> None:
    small, large = sorted((one, two))
    if small == large:
        return
    assert CheckLimit(small, large).level(value) == CheckLimit(-small, -large).level(-value)
    assert CheckLimit(small, large).level(small) == "pass" and CheckLimit(small, large).level(large) == "warn"
    assert CheckLimit(small, large).level(math.nextafter(large, math.inf)) == "fail"


def test_figure_that_is_not_a_number_fails() -> None:
    assert CheckLimit(0.1, 0.2).level(math.nan) == CheckLimit(2.0, 1.0).level(math.nan) == "fail"


def test_refused_board_is_drawn_with_the_spots_that_were_seen() -> None:
    change = -20 * np.random.default_rng(0).random((240, 320)).astype(np.float32)
    seen_px = np.array([[50.0, 60.0], [200.5, 100.25]])
    overlay = draw_board_not_found(BoardNotFound("no board", 2, 63, seen_px, change))
    assert overlay.shape == (240, 320, 3) and overlay.dtype == np.uint8
    rows, cols = np.nonzero(np.ptp(overlay.astype(int), axis=2) > 60)
    distance = np.hypot(cols[:, None] - seen_px[:, 0], rows[:, None] - seen_px[:, 1])
    assert (distance.min(axis=0) < 8).all() and (distance.min(axis=1) < 10).all()


@pytest.mark.parametrize("seen", [np.empty((0, 2)), np.array([[1e12, 3.0], [np.nan, 2.0], [5.0, 5.0]])])
def test_overlay_bears_no_spots_and_impossible_ones(seen: np.ndarray) -> None:
    overlay = draw_board_not_found(BoardNotFound("no board", 0, 63, seen, np.zeros((120, 160), np.float32)))
    assert overlay.shape == (120, 160, 3)


def test_noise_alone_is_not_stretched_to_black_and_white() -> None:
    noise = np.random.default_rng(0).normal(0, 0.7, (100, 100)).astype(np.float32)
    assert stretch_contrast(noise).std() < 20


@given(st.floats(1e-6, 2.0))
def test_arrows_are_magnified_by_a_round_factor_and_stay_near_their_pin(longest_mm: float) -> None:
    factor = arrow_magnification(np.array([[0.0, longest_mm], [0.0, 0.0]]), 2.5)
    assert factor == 1 or factor * longest_mm <= 1.5 * 2.5
    assert str(factor).rstrip("0") in {"1", "2", "5"}


def with_figure(certificate: Certificate, part: str, name: str, value: float) -> Certificate:
    figures = msgspec.structs.replace(getattr(certificate, part), **{name: value})
    return msgspec.structs.replace(certificate, **{part: figures})


def rank(line: CheckResult) -> int:
    return CHECK_LEVELS.index(line.level)


@pytest.mark.parametrize(("depth_mm", "is_warned"), [(1.99, False), (2.0, True)])
def test_a_press_through_the_gel_is_warned_of(depth_mm: float, is_warned: bool) -> None:
    assert bool(press_through_gel_warnings(depth_mm, Gel(2.0, 0.1))) == is_warned
