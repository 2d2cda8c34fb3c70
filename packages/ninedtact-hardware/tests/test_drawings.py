"""What a shop reads off the sheets."""

import numpy as np
import pytest

from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.part_drawing import draw_part, draw_part_as_svg_and_pdf
from ninedtact_hardware.part_geometry import Polyline, project_section

BARE_MM2 = {
    "acrylic_window": 14.0 * 2.0,
    "base_board": 50.0 * 3.0,
    "first_mould": (50 - 22.5) * 2.5,
    "second_mould": (50 - 24.1) * 2.8,
}
"""Of the plane x = 0 in the original's plates; the base board has no hole there, the moulds their window."""


@pytest.mark.parametrize("name", BARE_MM2)
def test_a_cut_lays_bare_what_the_plane_meets(original: BuildableDesign, name: str) -> None:
    cut = project_section(original.parts[name].solid).cut
    assert sum(map(area_mm2, cut)) == pytest.approx(BARE_MM2[name], abs=0.01)


def area_mm2(face: tuple[Polyline, ...]) -> float:
    """The outline less its holes."""
    outside, *holes = map(enclosed_mm2, face)
    return outside - sum(holes)


def enclosed_mm2(line: Polyline) -> float:
    """Shoelace."""
    x, y = line.T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def test_cutting_the_shell_shows_its_window_hole_and_its_usb_slot(default: BuildableDesign) -> None:
    view = project_section(default.parts["sensor_shell"].solid)
    assert len(view.cut) == 3, "wall at +y with half a floor, floor and wall above the slot, wall below the slot"
    (low_y, low_z), (high_y, high_z) = view.box
    assert (high_y - low_y, high_z - low_z) == pytest.approx(default.parts["sensor_shell"].size_mm[1:], abs=1e-6)


def test_the_table_stays_on_the_sheet_however_long_it_is(default: BuildableDesign) -> None:
    notes = {"rows": [f"row {number}" for number in range(90)]}
    (axes,) = draw_part(default.parts["acrylic_window"], notes).axes
    heights = [text.get_position()[1] for text in axes.texts if text.get_text().startswith("row ")]
    assert len(heights) == 90 and min(heights) >= 15


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("isolation_ring", ("A–A", "± 0.15", "0.050  isolation ring, window hole", "ring.bore_mm  10.1", "1 x ⌀10.10")),
        (
            "calibration_board",
            ("63 x ⌀1.20, pitch 2.50", "9 columns x 7 rows", "pin_board.pitch_mm  2.5", "z 4.00", "R4.00"),
        ),
        (
            "second_mould",
            ("R1.80", "R12.00", "gels.black_top_mm  0.3", "gels.black_side_mm  0.8", "gel.thickness_mm  2.5"),
        ),
    ],
)
def test_a_sheet_tells_all_that_shapes_a_part(default: BuildableDesign, name: str, words: tuple[str, ...]) -> None:
    svg = sheet_svg(default, name)
    for text in words:
        assert text in svg


def sheet_svg(sensor: BuildableDesign, name: str) -> str:
    return dict(draw_part_as_svg_and_pdf(sensor.design, sensor.parts[name]))["svg"].decode()
