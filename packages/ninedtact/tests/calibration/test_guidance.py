"""The advice of the guided calibration: exposure, stillness, what is missing where, and when an image is kept."""

from collections.abc import Callable, Iterable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ninedtact.calibration import guidance
from ninedtact.calibration.ball.contact_circle import BallPressUnusable
from ninedtact.calibration.board.detection import BoardNotFound
from ninedtact.calibration.guidance import (
    CalibrationStepAdvice,
    PinSearchResult,
    _BallPressWatcher,
    _BoardPressWatcher,
    exposure_advice,
    guided_capture_steps,
    make_still_press_watcher,
    make_untouched_skin_watcher,
    peak_local_brightness_change,
    search_board_pins,
)
from ninedtact.calibration.press_brightness import BgrImage
from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.design import RectifiedImageSize, SensorDesign
from ninedtact.shape.lens import LensModel
from ninedtact.shape.rectification import rectification_of_projection

DESIGN, SETTINGS = SensorDesign(), CalibrationSettings()
Watch = Callable[[BgrImage], CalibrationStepAdvice]


def grey(level: float, shape: tuple[int, int] = (60, 80)) -> BgrImage:
    return np.full((*shape, 3), level, np.uint8)


def touched(by: int, level: int = 120) -> BgrImage:
    """Skin with a wide spot that is brighter."""
    image = grey(level, (100, 120))
    image[20:70, 20:70] += np.uint8(by)
    return image


UNTOUCHED = grey(120, (100, 120))


def sentences(watch: Watch, images: Iterable[BgrImage]) -> list[str]:
    return [watch(image).sentence for image in images]


@pytest.mark.parametrize(
    ("found_px", "missing_px", "side"),
    [
        ([(20, 30)], [(70, 5), (74, 15)], "upper right"),
        ([(70, 55), (74, 59)], [], "upper left"),
        ([(1, 31), (3, 29)], [], "right"),
        ([], [(40, 50)], "lower"),
        ([], [], ""),
    ],
)
def test_the_side_of_a_refused_board_is_that_of_missing_pins_or_opposite_to_those_found(
    found_px: list[Any], missing_px: list[Any], side: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    found, missing = (np.array(px, float).reshape(-1, 2) for px in (found_px, missing_px))

    def refuse(*given: object) -> None:
        assert given[2:] == (DESIGN.pin_board, "auto")
        raise BoardNotFound("", len(found), 63, found, np.zeros((60, 80), np.float32), missing)

    monkeypatch.setattr(guidance, "fit_board", refuse)
    pins = search_board_pins(grey(120), grey(120), DESIGN, SETTINGS)
    assert (pins.expected, pins.found, pins.has_lens, pins.side) == (63, len(found), False, side)
    assert (pins.contrast_grey_levels, pins.noise_grey_levels) == (0.0, 0.0)
    np.testing.assert_array_equal(pins.missing_px, missing)


@pytest.mark.parametrize(("missing", "side"), [((), ""), ((0, 1), "upper left"), ((2,), "lower right")])
def test_pins_that_a_lens_predicts_are_missing_on_their_side(
    missing: tuple[int, ...], side: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    points_px = np.array([(5.0, 5.0), (15, 10), (70, 50), (40, 30)])
    found = ~np.isin(np.arange(4), missing)
    fit = SimpleNamespace(points_px=points_px, found=found, contrast=np.arange(4) + 8.0, camera_noise_grey_levels=0.7)
    monkeypatch.setattr(guidance, "fit_board", lambda *_: fit)
    pins = search_board_pins(grey(120), grey(120), DESIGN, SETTINGS)
    assert (pins.found, pins.has_lens, pins.side) == (4 - len(missing), True, side)
    np.testing.assert_array_equal(pins.missing_px, points_px[~found])
    assert (pins.contrast_grey_levels, pins.noise_grey_levels) == (9.5, 0.7)


@pytest.mark.parametrize(
    ("dark", "bright", "words"),
    [(60, 60, ""), (59, 59, "too dark"), (120, 250, "overexposed"), (120, 249, ""), (250, 250, "overexposed")],
)
def test_advice_about_the_exposure(dark: int, bright: int, words: str) -> None:
    image = grey(dark)
    image[:2] = bright  # a thirtieth of the image
    assert words in exposure_advice(image) and bool(words) == bool(exposure_advice(image))
    image[1:] = dark
    assert ("overexposed" in exposure_advice(image)) == (dark == 250)


def test_the_change_is_the_largest_one_beside_that_of_the_whole_image() -> None:
    assert peak_local_brightness_change(UNTOUCHED, grey(140, (100, 120))) == pytest.approx(0, abs=1e-4)
    image = grey(110, (100, 120))
    image[50:60, 50:60] = 90
    assert peak_local_brightness_change(UNTOUCHED, image) == pytest.approx(12.367, rel=1e-3)
    assert peak_local_brightness_change(UNTOUCHED, touched(6)) == pytest.approx(6, rel=1e-3)


def test_untouched_skin_is_still_lit_and_like_before() -> None:
    watch = make_untouched_skin_watcher(UNTOUCHED)
    assert sentences(watch, [UNTOUCHED] * 7) == [f"hold still {number}/8" for number in range(1, 8)]
    assert "still touches the skin (6 grey levels)" in watch(touched(6)).sentence
    assert sentences(watch, [touched(4)] * 7)[0] == "hold still 1/8"
    assert "too dark" in watch(grey(20, (100, 120))).sentence
    last = watch(touched(4))
    assert last.sentence == "reference image taken" and np.array_equal(last.image, touched(4))
    first = make_untouched_skin_watcher(None)
    said = [first(touched(30)) for _ in range(8)]
    assert said[0].image is None and said[7].image is not None


def test_a_press_is_taken_when_it_was_still_for_long_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 50.0
    monkeypatch.setattr(guidance, "monotonic", lambda: now_s)
    watch = make_still_press_watcher(UNTOUCHED, hold_s=2.0)
    assert sentences(watch, [UNTOUCHED, touched(2)]) == ["nothing touches the skin yet"] * 2
    now_s = 60.0
    assert watch(touched(3)).sentence == "hold still, 2.0 s more"
    now_s = 60.5
    assert sentences(watch, [touched(3)] * 8) == ["hold still, 1.5 s more"] * 8
    now_s = 61.5
    assert watch(touched(3)).sentence == "hold still, 0.5 s more"
    now_s = 62.0
    assert watch(touched(3)).sentence == "taken"
    assert watch(touched(9)).sentence == "hold still, 2.0 s more"  # it moved
    now_s = 66.0
    assert sentences(watch, [touched(9)] * 7) == ["hold still"] * 6 + ["taken"]
    assert watch(UNTOUCHED).image is None and watch(touched(9)).sentence == "hold still, 2.0 s more"


def pins(found: int, has_lens: bool, side: str = "left", contrast: float = 20.0) -> PinSearchResult:
    return PinSearchResult(63, np.zeros((found, 2)), np.zeros((63 - found, 2)), has_lens, side, contrast, 1.0)


def board_watcher(monkeypatch: pytest.MonkeyPatch, *seen: PinSearchResult) -> Watch:
    """A watcher to which the still presses show these pins, one after another."""
    results = iter(seen)
    monkeypatch.setattr(guidance, "search_board_pins", lambda *_: next(results))
    return _BoardPressWatcher(UNTOUCHED, DESIGN, SETTINGS)


def press_until_still(watch: Watch) -> CalibrationStepAdvice:
    """The advice about the last of eight still images."""
    *before, last = [watch(touched(9)) for _ in range(8)]
    assert all(one.image is None and one.pins is None for one in before)
    assert [one.sentence[-3:] for one in before] == [f"{number}/8" for number in range(1, 8)]
    return last


def test_a_board_with_all_pins_is_taken_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    for contrast, faint in ((14.1, False), (14.0, True)):
        watch = board_watcher(monkeypatch, pins(63, True, "", contrast))
        assert sentences(watch, [UNTOUCHED, touched(2)]) == ["nothing touches the skin yet"] * 2
        assert watch(touched(3)).sentence == "hold still 1/8" and watch(UNTOUCHED).image is None
        taken = press_until_still(watch)
        assert taken.image is not None and taken.pins is not None
        assert taken.sentence.startswith("board taken: 63 of 63 pins, 14 grey levels deep")
        assert taken.sentence.endswith("deep") != faint == ("faint" in taken.sentence)


def test_the_fourth_press_with_a_lens_is_taken_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = board_watcher(monkeypatch, *[pins(60, True)] * 2, pins(20, False), *[pins(62, True, "")] * 2)
    said = [press_until_still(watch) for _ in range(5)]
    assert [one.image is not None for one in said] == [False] * 4 + [True]
    assert [one.sentence for one in said] == [
        *["pins 60 of 63: press harder in the left part of the image; "] * 2,
        "pins 20 of 63: press harder in the left part of the image and hold the board flat; ",
        "pins 62 of 63: press harder; ",
        "board taken: 62 of 63 pins, 20 grey levels deep",
    ]


FEW = RectifiedImageSize(30, 40)
LENS = LensModel((0.0625, 0.0, 0.0, 0.0, 0.0625, 0.0, 0.0, 0.0), (0.0, 0.0), (0.0,), (0.0, 0.0), (100, 120))


def ball_watcher(monkeypatch: pytest.MonkeyPatch, radius_px: float, asymmetry: float = 0.0) -> _BallPressWatcher:
    """A watcher to which every image shows this contact, at 0.1 mm per pixel."""
    rectify = rectification_of_projection(LENS, FEW, 0.1, (100, 120), (-1, 1, -1, 1))
    circle = SimpleNamespace(radius_px=radius_px, asymmetry=asymmetry)
    monkeypatch.setattr(guidance, "find_usable_contact_circle", lambda *_: circle)
    return _BallPressWatcher(UNTOUCHED, rectify, DESIGN, SETTINGS)


@pytest.mark.parametrize(("radius_mm", "depth"), [(3.2, "1.60"), (3.3, "1.74")])
def test_a_good_ball_is_taken_when_it_is_still(radius_mm: float, depth: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The ball has a radius of 4 mm."""
    watch = ball_watcher(monkeypatch, radius_mm / 0.1, 0.05)
    *before, last = [watch(touched(9)) for _ in range(8)]
    assert [one.sentence for one in before] == [f"{depth} mm deep, hold still {number}/8" for number in range(1, 8)]
    assert last.sentence == f"ball taken: {depth} mm deep, uneven by 5%" and last.image is not None
    assert all(one.image is None for one in before)


def test_the_fourth_still_ball_is_taken_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = ball_watcher(monkeypatch, 45)  # as large as no section of the ball
    said = [watch(touched(9)) for _ in range(32)]
    assert [number for number, one in enumerate(said, start=1) if one.image is not None] == [32]
    assert {one.sentence for one in said[:31]} == {"4.00 mm deep, press less deep"}
    assert said[31].sentence == "ball taken: 4.00 mm deep, uneven by 0%"


def test_a_ball_that_cannot_be_measured_starts_the_wait_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = ball_watcher(monkeypatch, 32)
    assert sentences(watch, [touched(9)] * 7)[-1].endswith("7/8")
    kept = guidance.find_usable_contact_circle

    def refuse(*_: object) -> None:
        raise BallPressUnusable("expected a disc, got two; press once, got it")

    monkeypatch.setattr(guidance, "find_usable_contact_circle", refuse)
    assert watch(touched(9)).sentence == "two; press once, got it"
    monkeypatch.setattr(guidance, "find_usable_contact_circle", kept)
    assert watch(touched(9)).sentence.endswith("1/8")


def test_the_steps_come_in_the_order_of_the_images() -> None:
    steps = list(guided_capture_steps(DESIGN, SETTINGS))
    assert [step.name for step in steps] == ["board_reference", "board", "ball_reference", "ball"]
    assert "(9 x 7 pins)" in steps[1].instruction and "(radius 4 mm)" in steps[3].instruction
    assert "still touches" in steps[2].watch({"board_reference": UNTOUCHED})(touched(9)).sentence
    assert steps[0].watch({})(touched(9)).sentence == "hold still 1/8"
    assert isinstance(steps[1].watch({"board_reference": UNTOUCHED}), _BoardPressWatcher)
