import pytest

from ninedtact.hardware.assembly.pairs import met
from ninedtact.hardware.clearances import clearances
from ninedtact.hardware.figures import PAPER
from ninedtact.hardware.report import BuiltSensor

TIGHT_IN_THE_ORIGINAL = {
    "lens head, hole of the LED board",
    "camera body, pocket of the base",
    "camera stiffener, shoulder of the pocket",
    "screw shank, hole of the base",
    "bolt of the robot, hole of the base",
    "plug's overmould, mouth of the receptacle",
}
LEVELS = {
    "plate_top": 3.0,
    "usb_bottom": 4.85,
    "boss_top": 6.5,
    "board_bottom": 7.5,
    "board_top": 8.3,
    "ring_bottom": 8.5,
    "led_top": 9.02,
    "ceiling": 9.3,
    "lens_front": 10.95,
    "floor_top": 11.3,
    "frame_top": 12.1,
    "window_top": 13.3,
    "rim": 22.5,
    "skin": 25.0,
    "top": 25.3,
}


@pytest.mark.parametrize(("name", "z_mm"), LEVELS.items())
def test_levels(original: BuiltSensor, name: str, z_mm: float) -> None:
    assert getattr(original.design.levels, name) == pytest.approx(z_mm, abs=1e-9)


def test_bodies_lie_at_their_levels(original: BuiltSensor) -> None:
    boxes = {body.name: body.solid.bounding_box() for body in original.bodies}
    levels = original.design.levels
    assert float(boxes["sensor_shell"].min.Z) == pytest.approx(levels.plate_top)
    assert float(boxes["led_board"].max.Z) == pytest.approx(levels.led_top)
    assert float(boxes["camera"].max.Z) == pytest.approx(levels.lens_front)
    assert float(boxes["black_gel"].max.Z) == pytest.approx(levels.top)


def test_nothing_interferes_in_the_default(default: BuiltSensor) -> None:
    assert len(default.bodies) == 21
    assert default.interferences == []
    assert [room for room in default.clearances if room.tight] == []


def test_the_original_overlaps_where_its_files_do(original: BuiltSensor) -> None:
    assert [(pair.first, pair.second) for pair in original.interferences] == [("sensor_base", "camera")]
    assert {room.between for room in original.clearances if room.tight} == TIGHT_IN_THE_ORIGINAL


def test_clearances_told_are_clearances_of_the_solids(default: BuiltSensor) -> None:
    bodies = {body.name: body for body in default.bodies}
    told = {room.between: room.mm for room in clearances(default.design)}
    for first, second, between in (
        ("camera", "isolation_ring", "lens head, bore of the ring"),
        ("camera", "led_board", "lens head, hole of the LED board"),
        ("camera", "acrylic_window", "lens front, window"),
        ("led_board", "isolation_ring", "LED, isolation ring"),
        ("led_board", "sensor_shell", "notch of the LED board, screw boss of the shell"),
        ("isolation_ring", "sensor_shell", "isolation ring, window hole of the shell"),
    ):
        # Bodies may be nearest elsewhere, a cable beside a rim: never farther than told, and about as near.
        assert met(bodies[first], bodies[second]).apart_mm == pytest.approx(told[between], abs=0.02)


def test_figures_beside_the_paper(default: BuiltSensor) -> None:
    figures = default.figures
    assert figures.size_mm == pytest.approx((32.5, 25.5, 25.3))
    assert figures.ratio_mm == pytest.approx(PAPER.ratio_mm, abs=0.5)
    assert round(PAPER.ratio_mm) == 49
    assert figures.mass_g == pytest.approx(PAPER.mass_g, rel=0.2)
    assert figures.cost_usd == pytest.approx(PAPER.cost_usd, rel=0.3)


def test_the_report_says_all(default: BuiltSensor) -> None:
    text = "\n".join(default.lines())
    for each in (
        "0 pairs interfere",
        "9DTact, as published",
        "this design (default)",
        "disagree",
        "25.30 by the moulds",
    ):
        assert each in text
