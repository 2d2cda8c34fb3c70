"""Resistor → current → brightness."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ninedtact.design import DesignImpossible
from ninedtact_hardware.design import read_hardware_design
from ninedtact_hardware.led_board.board_outline_and_holes import LedBoardImpossible
from ninedtact_hardware.led_board.board_parameters import compute_operating_point, led_board_for_design
from ninedtact_hardware.led_board.complete_layout import lay_out_board
from ninedtact_hardware.led_board.fabrication_files import format_fabrication_notes


@pytest.mark.parametrize(("ohm", "total_ma", "led_ma", "watt"), [(20_000, 90, 11.25, 0.18), (3_750, 480, 60, 0.96)])
def test_the_two_resistors_of_the_published_board(ohm: float, total_ma: float, led_ma: float, watt: float) -> None:
    light = compute_operating_point(ohm)
    assert (light.total_ma, light.led_ma, light.driver_w) == pytest.approx((total_ma, led_ma, watt))


def test_the_usual_resistor_is_brightness_one() -> None:
    assert compute_operating_point(20_000).relative_brightness == 1
    assert compute_operating_point(10_000).relative_brightness == 2


@given(ohm=st.floats(3_750, 30_000))
def test_brightness_and_resistor_are_inverse(ohm: float) -> None:
    light = compute_operating_point(ohm)
    assert light.relative_brightness * ohm == pytest.approx(20_000)
    assert light.needs_asking == (light.total_ma > 100)


def test_a_design_file_sets_the_resistor(tmp_path: Path) -> None:
    path = tmp_path / "bright.toml"
    path.write_text("[hardware.board]\nresistor_ohm = 10000\n")
    for variant in ("default", "original"):
        board = led_board_for_design(read_hardware_design(path, variant))
        assert board.resistor_ohm == 10_000
        assert "180 mA in total" in format_fabrication_notes(lay_out_board(board))
    path.write_text("[hardware.board]\nresistor_ohm = 100\n")
    with pytest.raises(DesignImpossible, match=r"board.resistor_ohm from 1200 to 30000, got 100"):
        read_hardware_design(path, "default")


@pytest.mark.parametrize(
    ("ohm", "leds", "word"),
    [
        (1_000, 8, "1200 to 30000"),
        (40_000, 8, "1200 to 30000"),
        (float("nan"), 8, "1200 to 30000"),
        (3_000, 16, "USB"),
        (3_700, 8, "each LED"),
        (10_000, 2, "each LED"),
    ],
)
def test_limits_are_named(ohm: float, leds: int, word: str) -> None:
    with pytest.raises(LedBoardImpossible, match=rf"expected .*{word}.*, got .*; "):
        compute_operating_point(ohm, leds)
