"""The advice of the guided calibration: exposure, stillness, what is missing where, and when an image is kept."""

from collections.abc import Callable

import numpy as np
from drawn_presses import DrawnPresses

from ninedtact.calibration.guidance import (
    BoardPressWatcher,
    CalibrationStepAdvice,
    exposure_advice,
    guided_capture_steps,
    make_still_press_watcher,
    make_untouched_skin_watcher,
    search_board_pins,
)
from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.design import SensorDesign
from ninedtact.quantities import BgrImage

DESIGN, SETTINGS = SensorDesign(), CalibrationSettings(method="ratio")
STEPS = {step.name: step for step in guided_capture_steps(DESIGN, SETTINGS)}
Watch = Callable[[BgrImage], CalibrationStepAdvice]


def grey(level: float, shape: tuple[int, int] = (60, 80)) -> BgrImage:
    return np.full((*shape, 3), level, np.uint8)


def touched(by: int) -> BgrImage:
    """Skin with a wide spot that is brighter."""
    image = grey(120, (100, 120))
    image[20:70, 20:70] += np.uint8(by)
    return image


UNTOUCHED = touched(0)
DRAWN = DrawnPresses().images()
UPPER_LEFT, LOWER_RIGHT = ((1, 1), (2, 1), (1, 2)), ((9, 7), (8, 7), (9, 6))


def hold(watch: Watch, image: BgrImage) -> CalibrationStepAdvice:
    """The advice about the last of eight equal images, none of which is kept before it."""
    *before, last = [watch(image) for _ in range(8)]
    assert all(one.image is None for one in before) and "hold still 7/8" in before[-1].sentence
    return last


def test_the_side_of_a_board_without_a_lens_is_opposite_to_the_pins_that_were_found() -> None:
    left = tuple((column, row) for column in range(5, 10) for row in range(1, 8))
    press = DrawnPresses(missing=left).images().board
    pins = search_board_pins(DRAWN.board_reference, press, DESIGN, SETTINGS)
    assert not pins.has_lens and 0 < pins.found < 63 and "right" in pins.side


def test_advice_about_the_exposure() -> None:
    assert exposure_advice(grey(120)) == "" and "too dark" in exposure_advice(grey(20))
    image = grey(120)
    image[:2] = 255  # a thirtieth of the image
    assert "overexposed" in exposure_advice(image)


def test_untouched_skin_is_still_lit_and_like_before() -> None:
    watch = make_untouched_skin_watcher(UNTOUCHED)
    assert [watch(UNTOUCHED).sentence for _ in range(7)] == [f"hold still {number}/8" for number in range(1, 8)]
    assert "still touches the skin (9 grey levels)" in watch(touched(9)).sentence
    assert "too dark" in watch(grey(20, (100, 120))).sentence
    last = hold(watch, UNTOUCHED)
    assert last.sentence == "reference image taken" and np.array_equal(last.image, UNTOUCHED)


def test_a_press_is_taken_when_it_was_still_for_long_enough() -> None:
    soon, late = (make_still_press_watcher(UNTOUCHED, hold_s) for hold_s in (0.0, 1000.0))
    assert soon(UNTOUCHED).sentence == "nothing touches the skin yet"
    assert [soon(touched(9)).sentence for _ in range(8)] == ["hold still"] * 7 + ["taken"]
    assert soon(touched(30)).image is None  # it moved
    assert late(touched(9)).sentence == "hold still, 1000.0 s more"
    assert all(late(touched(9)).image is None for _ in range(8))


def test_a_board_with_all_pins_is_taken_at_once_and_a_faint_one_is_named() -> None:
    for noise, ending in ((0.5, "grey levels deep"), (1.7, "faint: press harder next time, check the focus")):
        press = DrawnPresses(noise=noise)
        watch = STEPS["board"].watch({"board_reference": press.images().board_reference})
        assert watch(press.images().board_reference).sentence == "nothing touches the skin yet"
        taken = hold(watch, press.images().board)
        assert taken.image is not None and taken.pins is not None and taken.pins.found == 63
        assert taken.sentence.startswith("board taken: 63 of 63 pins") and taken.sentence.endswith(ending)


def test_the_fourth_press_with_a_lens_is_taken_as_it_is() -> None:
    watch = STEPS["board"].watch({"board_reference": DRAWN.board_reference})
    press = DrawnPresses(missing=UPPER_LEFT).images().board
    said = [hold(watch, press) for _ in range(3)]
    assert {one.sentence for one in said} == {"pins 60 of 63: press harder in the upper left part of the image"}
    assert isinstance(watch, BoardPressWatcher)
    watch.pins = search_board_pins(DRAWN.board_reference, DRAWN.board, DESIGN, SETTINGS)  # as the page does meanwhile
    assert watch(press).sentence == "pins 63 of 63; hold still 1/8"
    taken = [watch(press) for _ in range(7)][-1]
    assert [one.image for one in said] == [None] * 3 and taken.image is not None
    assert taken.sentence.startswith("board taken: 60 of 63 pins")


def ball_watcher() -> Watch:
    return STEPS["ball"].watch(dict(vars(DRAWN)))


def test_a_good_ball_is_taken_when_it_is_still() -> None:
    watch = ball_watcher()
    assert hold(watch, DRAWN.ball).sentence.startswith("ball taken: 1.")
    assert watch(DRAWN.ball_reference).image is None
    assert watch(DRAWN.ball).sentence.endswith("hold still 1/8")  # what cannot be measured starts the wait anew


def test_the_steps_come_in_the_order_of_the_images() -> None:
    assert list(STEPS) == ["board_reference", "board", "ball_reference", "ball"]
    assert "(9 x 7 pins)" in STEPS["board"].instruction and "(radius 4 mm)" in STEPS["ball"].instruction
    *first, _, second = guided_capture_steps(DESIGN, SETTINGS, second=("second_ball",))
    assert [step.name for step in first] == list(STEPS) and second.name == "second_ball"
    assert "(radius 2.5 mm)" in second.instruction and "0.6 to 1.4 mm deep" in second.instruction
    watch = STEPS["ball_reference"].watch({"board_reference": UNTOUCHED})
    assert "still touches" in watch(touched(9)).sentence
