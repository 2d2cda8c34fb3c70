"""What a shop reads off the sheets."""

import numpy as np
import pytest

from ninedtact.design import Gel, SensingArea, SensorDesign
from ninedtact.hardware.design import default_hardware
from ninedtact.hardware.drawings.sheet import Sheet
from ninedtact.hardware.drawings.table import Row, table
from ninedtact.hardware.drawings.views import Line, cut_open
from ninedtact.hardware.parts.moulds import first_mould, second_mould
from ninedtact.hardware.report import BuiltSensor

BARE_MM2 = {
    "acrylic_window": 14.0 * 2.0,
    "base_board": 50.0 * 3.0,
    "first_mould": (50 - 22.5) * 2.5,
    "second_mould": (50 - 24.1) * 2.8,
}
"""Of the plane x = 0 in the original's plates; the base board has no hole there, the moulds their window."""


@pytest.mark.parametrize("name", BARE_MM2)
def test_a_cut_lays_bare_what_the_plane_meets(original: BuiltSensor, name: str) -> None:
    cut = cut_open(original.parts[name].solid).cut
    assert sum(map(area_mm2, cut)) == pytest.approx(BARE_MM2[name], abs=0.01)


@pytest.mark.parametrize(("width", "height", "gel"), [(10.0, 10.0, 1.5), (60.0, 45.0, 5.0)])
def test_so_it_does_in_every_size(width: float, height: float, gel: float) -> None:
    design = default_hardware(SensorDesign(gel=Gel(gel), sensing_area=SensingArea(width, height)))
    for build, window, thick_mm in (
        (first_mould, design.plan.translucent, gel),
        (second_mould, design.plan.black, gel + 0.3),
    ):
        cut = cut_open(build(design)).cut
        assert sum(map(area_mm2, cut)) == pytest.approx((design.plan.plate[1] - window[1]) * thick_mm, abs=0.01)


def area_mm2(face: tuple[Line, ...]) -> float:
    """The outline less its holes."""
    outside, *holes = map(enclosed_mm2, face)
    return outside - sum(holes)


def enclosed_mm2(line: Line) -> float:
    """Shoelace."""
    x, y = line.T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def test_cutting_the_shell_shows_its_window_hole_and_its_usb_slot(default: BuiltSensor) -> None:
    view = cut_open(default.parts["sensor_shell"].solid)
    assert len(view.cut) == 3, "wall at +y with half a floor, floor and wall above the slot, wall below the slot"
    (low_y, low_z), (high_y, high_z) = view.box
    assert (high_y - low_y, high_z - low_z) == pytest.approx(default.parts["sensor_shell"].size_mm[1:], abs=1e-6)


def test_a_sheet_says_how_exact_a_part_must_be(default: BuiltSensor) -> None:
    part = default.parts["isolation_ring"]
    svg = dict(Sheet(part, table(default.design, part)).files())["svg"].decode()
    for text in (
        "A–A",
        "tolerance ± 0.15",
        "0.050  isolation ring, window hole of the shell",
        "ring.bore_mm  10.1",
        "1 x ⌀10.10",
    ):
        assert text in svg


def test_the_table_stays_on_the_sheet_however_long_it_is(default: BuiltSensor) -> None:
    rows = [Row(f"row {number}") for number in range(90)]
    (axes,) = Sheet(default.parts["acrylic_window"], rows).drawn().axes
    heights = [text.get_position()[1] for text in axes.texts if text.get_text().startswith("row ")]
    assert len(heights) == 90 and min(heights) >= 15
