import math
from dataclasses import replace

import pytest

from clearance_agreement import LED_AND_RING, NEAREST, require_agreement
from ninedtact_hardware.buildability import find_broken_rules
from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.clearances import list_clearances
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.part_dimensions import BaseDimensions, ShellDimensions
from ninedtact_hardware.published_specifications import OTHER_PUBLISHED_SENSORS, PUBLISHED_9DTACT

TIGHT_IN_THE_ORIGINAL = {
    "lens head, hole of the LED board",
    "camera body, pocket of the base",
    "camera body, wall of the pocket at +y",
    "camera stiffener, shoulder of the pocket",
    "screw shank, hole of the base",
    "bolt of the robot, hole of the base",
    "plug's overmould, mouth of the receptacle",
}


def test_bodies_lie_at_their_levels(original: BuildableDesign) -> None:
    boxes = {body.name: body.solid.bounding_box() for body in original.bodies}
    levels = original.design.heights
    assert float(boxes["sensor_shell"].min.Z) == pytest.approx(levels.plate_top)
    assert float(boxes["led_board"].max.Z) == pytest.approx(levels.led_top)
    assert float(boxes["camera"].max.Z) == pytest.approx(levels.lens_front)
    assert float(boxes["black_gel"].max.Z) == pytest.approx(levels.top)


def test_nothing_interferes_in_the_default(default: BuildableDesign) -> None:
    assert len(default.bodies) == 21
    assert default.interferences == []
    assert [clearance for clearance in default.clearances if clearance.is_tight] == []


def test_the_original_overlaps_where_its_files_do(original: BuildableDesign) -> None:
    assert [(pair.first, pair.second) for pair in original.interferences] == [("sensor_base", "camera")]
    assert {clearance.faces for clearance in original.clearances if clearance.is_tight} == TIGHT_IN_THE_ORIGINAL


def test_clearances_told_are_clearances_of_the_solids(default: BuildableDesign) -> None:
    require_agreement(default, (*NEAREST, LED_AND_RING))


@pytest.mark.parametrize(
    ("design", "between", "mm"),
    [
        # The ring's half side is 9.95; the nearest faces of the upper row's LEDs stand at y 7.5 − 1.4.
        (replace(HardwareDesign(), shell=ShellDimensions(hole_mm=20.0)), "LED, isolation ring", 6.1 - 9.95),
        # The fillet begins 0.5 below the board's upper edge, the boss 0.1 beside it.
        (
            replace(HardwareDesign(), shell=ShellDimensions(fillet_mm=1.5)),
            "LED board, rounded ceiling of the shell",
            1.5 - math.hypot(1.4, 0.5),
        ),
        (
            replace(HardwareDesign(), base=BaseDimensions(pocket_front_mm=4.0)),
            "camera body, wall of the pocket at +y",
            -0.35,
        ),
    ],
)
def test_what_overlaps_is_told_and_refused(design: HardwareDesign, between: str, mm: float) -> None:
    (clearance,) = (clearance for clearance in list_clearances(design) if clearance.faces == between)
    assert clearance.clearance_mm == pytest.approx(mm, abs=1e-9)
    assert clearance.is_tight
    assert any(between in broken.message for broken in find_broken_rules(design)) == (mm < 0)


def test_figures_beside_the_paper(default: BuildableDesign) -> None:
    figures = default.specification
    assert figures.size_mm == pytest.approx((32.5, 25.5, 25.3))
    assert figures.ratio_mm == pytest.approx(PUBLISHED_9DTACT.ratio_mm, abs=0.5)
    ratios = {row.name: round(row.ratio_mm) for row in (PUBLISHED_9DTACT, *OTHER_PUBLISHED_SENSORS)}
    assert [*ratios.values()] == [49, 508, 88, 102, 90, 165], "as the paper's table has them"
    assert figures.mass_g == pytest.approx(PUBLISHED_9DTACT.mass_g, rel=0.2)
    assert figures.cost_usd == pytest.approx(PUBLISHED_9DTACT.cost_usd, rel=0.3)


def test_the_report_says_all(default: BuildableDesign) -> None:
    text = "\n".join(default.check_report_lines())
    for each in (
        "0 pairs interfere",
        "the stored LED board fits",
        "9DTact, as published",
        "this design (default)",
    ):
        assert each in text
