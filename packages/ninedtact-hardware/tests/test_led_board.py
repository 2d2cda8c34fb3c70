"""The stored LED board: what a board house gets has the outline of the design, the nets of the schematic, and none of the faults of
the original; and a design that it does not fit says what to redraw."""

import csv
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import ezdxf
import numpy as np
import pytest
from ezdxf.bbox import extents
from gerbonara import LayerStack
from gerbonara.cad.kicad.pcb import Board
from hypothesis import given
from hypothesis import strategies as st
from shapely import Point, Polygon
from shapely.geometry.base import BaseGeometry

import ninedtact_hardware
from ninedtact.design import SensingArea, SensorDesign
from ninedtact_hardware.design import HardwareDesign, original_hardware_design
from ninedtact_hardware.led_board import (
    LedOperatingPoint,
    describe_redrawing,
    list_board_differences,
    read_board_files,
)
from ninedtact_hardware.part_dimensions import LedBoardDimensions
from ninedtact_hardware.part_files import part_to_dxf
from ninedtact_hardware.part_solids import build_bare_board
from read_board_files import edge_of, hits_of, pads_of, shape_of, slots_of

DESIGN = HardwareDesign()
PROJECT = Path(ninedtact_hardware.__file__).parent / "led_board_project"
GERBERS = PROJECT / "gerbers"
BOARD = Board.open(PROJECT / "led_board.kicad_pcb")
PADS = pads_of(BOARD)
EDGE = edge_of(GERBERS / "led_board-Edge_Cuts.gbr")
MASK = {side: shape_of(GERBERS / f"led_board-{side}_Mask.gbr") for side in "FB"}
COPPER = {side: shape_of(GERBERS / f"led_board-{side}_Cu.gbr") for side in "FB"}
PLATED, UNPLATED = (hits_of(GERBERS / f"led_board-{kind}.drl") for kind in ("PTH", "NPTH"))
LEDS = range(1, 9)
NETS = {
    "VCC": {"USB3.1", "U1.3", "U1.4", "U1.8", "C1.1"},
    "GND": {"U1.2", "U1.9", "R1.1", "C1.2", *(f"LED{n}.1" for n in LEDS), *(f"USB3.{n}" for n in range(5, 10))},
    "LED+": {"U1.5", "U1.6", *(f"LED{n}.2" for n in LEDS)},
    "ISET": {"U1.1", "R1.2"},
}
"""Those of the original, with C1, and with the shield, USB3.6 to .9, on ground."""
CLEARANCE_MM, TO_EDGE_MM, TO_HOLE_MM = 0.2, 0.25, 0.2
"""Least distances that an ordinary board house makes."""
ROUNDING_MM = 0.005


def pieces(shape: BaseGeometry) -> list[Polygon]:
    return [piece for piece in getattr(shape, "geoms", (shape,)) if piece.area > 1e-6]


def pad_shape(pin: str) -> BaseGeometry:
    """The opening of the mask over a pad, less its margin of 0.05."""
    pad = PADS[pin]
    (opening,) = (piece for piece in pieces(MASK[pad.sides[0]]) if piece.covers(Point(pad.at_mm)))
    return opening.buffer(-0.05, join_style="mitre")


def net_groups() -> list[tuple[set[str], dict[str, BaseGeometry]]]:
    """Copper that conducts: the pins on it, and its shape on both sides."""
    groups = [(side, piece) for side in "FB" for piece in pieces(COPPER[side])]
    joined = [{number} for number in range(len(groups))]
    through = [Point(x, y).buffer(wide / 2) for x, y, wide in PLATED] + slots_of(GERBERS / "led_board-PTH.drl")
    for hole in through:
        met = {n for n, (_, piece) in enumerate(groups) if piece.intersects(hole)}
        touched = [group for group in joined if group & met]
        joined = [group for group in joined if group not in touched] + [set().union(*touched)]
    found = []
    for group in joined:
        shapes = {side: Polygon().union(Polygon()) for side in "FB"}
        for number in group:
            side, piece = groups[number]
            shapes[side] = shapes[side] | piece
        pins = {pin for pin, pad in PADS.items() if any(shapes[s].intersects(Point(pad.at_mm)) for s in pad.sides)}
        found.append((pins, shapes))
    return found


def test_outline_and_holes_are_those_of_the_design() -> None:
    bare = build_bare_board(DESIGN)
    locating = [(x, y, wide) for x, y, wide in UNPLATED if wide == DESIGN.board.locating_mm]
    assert EDGE.bounds == pytest.approx((-14, -10.5, 14, 10.5), abs=1e-5)
    drilled = sum(Point(x, y).buffer(wide / 2, quad_segs=64).area for x, y, wide in locating)
    assert EDGE.area - drilled == pytest.approx(bare.volume / DESIGN.board.thick_mm, abs=0.05)
    assert np.array(locating)[:, :2] == pytest.approx(np.array(sorted(DESIGN.horizontal_dimensions.posts)))
    for screw in DESIGN.horizontal_dimensions.shell_screws:
        assert EDGE.distance(Point(screw)) == pytest.approx(DESIGN.board.notch_mm, abs=0.01)
    assert EDGE.distance(Point(0, 0)) == pytest.approx(DESIGN.board.lens_hole_mm / 2, abs=0.01)


def test_components_stand_where_the_design_has_them() -> None:
    placed = {row["Designator"]: row for row in csv.DictReader((PROJECT / "led_board_placement.csv").open())}
    at = {name: tuple(float(row[f"Mid {axis}"].removesuffix("mm")) for axis in "XY") for name, row in placed.items()}
    assert np.array([at[f"LED{n}"] for n in LEDS]) == pytest.approx(np.array([*DESIGN.horizontal_dimensions.leds]))
    assert at["U1"] == pytest.approx((DESIGN.board.driver_at_mm[0], 10.5 + DESIGN.board.driver_at_mm[1]))
    assert {name for name, row in placed.items() if row["Layer"] == "Top"} == {f"LED{n}" for n in LEDS}
    drawn = {part.texts[0].text: (part.at.x - 148.5, 105 - part.at.y) for part in BOARD.footprints if part.texts}
    assert drawn.keys() == at.keys()
    assert all(drawn[name] == pytest.approx(place) for name, place in at.items()), "as in the KiCad project"
    bill = [
        name for row in csv.DictReader((PROJECT / "led_board_bom.csv").open()) for name in row["Designator"].split(",")
    ]
    assert sorted(bill) == sorted(at)


def test_nets_are_those_of_the_schematic() -> None:
    assert {net: {pin for pin, pad in PADS.items() if pad.net == net} for net in NETS} == NETS
    assert {pin for pin, pad in PADS.items() if pad.net is None} == {"U1.7", "USB3.2", "USB3.3", "USB3.4"}


def test_every_net_is_one_conductor_and_touches_no_other() -> None:
    groups = net_groups()
    opens = [{pin} for pin in ("U1.7", "USB3.2", "USB3.3", "USB3.4")]
    assert sorted(map(sorted, (pins for pins, _ in groups))) == sorted(map(sorted, [*NETS.values(), *opens]))
    for number, (_, one) in enumerate(groups):
        for _, other in groups[number + 1 :]:
            for side in "FB":
                if not (one[side].is_empty or other[side].is_empty):
                    assert one[side].distance(other[side]) > CLEARANCE_MM - ROUNDING_MM


def test_copper_is_clear_of_edges_and_holes() -> None:
    for copper in COPPER.values():
        assert EDGE.contains(copper) and copper.distance(EDGE.boundary) > TO_EDGE_MM - ROUNDING_MM
        for x, y, wide in UNPLATED:
            assert copper.distance(Point(x, y)) - wide / 2 > TO_HOLE_MM - ROUNDING_MM


@pytest.mark.parametrize(
    ("pin", "other"),
    [
        ("LED7.1", "USB3.9"),
        ("LED7.2", "USB3.8"),
        *((pin, "edge") for pin in ("LED1.2", "LED3.1", "LED6.2", "LED8.1", "USB3.2", "USB3.3", "USB3.4")),
        ("LED7.2", "peg"),
        ("LED7.1", "peg"),
    ],
)
def test_a_fault_of_the_original_is_mended(pin: str, other: str) -> None:
    """The eleven that its design rule check finds: pads too near each other, too near a milled edge, or on a peg's hole."""
    pad = pad_shape(pin)
    if other == "edge":
        assert pad.distance(EDGE.boundary) > TO_EDGE_MM - ROUNDING_MM
    elif other == "peg":
        pegs = [Point(x, y).buffer(wide / 2) for x, y, wide in UNPLATED if wide == 0.6]
        assert len(pegs) == 2 and min(map(pad.distance, pegs)) > TO_HOLE_MM - ROUNDING_MM
        assert pad.area > 0.8 * (2.30 if pin == "LED7.1" else 1.55) * 2.10, "enough of the pad is left to solder"
    else:
        assert pad.distance(pad_shape(other)) > CLEARANCE_MM - ROUNDING_MM


def test_mask_and_paste_fit_the_pads() -> None:
    for pin, pad in PADS.items():
        for side in pad.sides:
            assert any(piece.covers(Point(pad.at_mm)) for piece in pieces(MASK[side])), pin
    for side in "FB":
        marks = shape_of(GERBERS / f"led_board-{side}_Silkscreen.gbr")
        assert marks.area > 0 and marks.distance(MASK[side]) > 0.05 and marks.distance(EDGE.boundary) > 0.1
        assert MASK[side].contains(shape_of(GERBERS / f"led_board-{side}_Paste.gbr"))


def test_another_program_knows_every_layer() -> None:
    stack = LayerStack.open(GERBERS)
    names = {f"{side} {use}" for side in ("top", "bottom") for use in ("copper", "mask", "silk", "paste")}
    assert names <= {" ".join(name) for name in stack.graphic_layers}
    assert stack.outline is not None and len(list(stack.drill_layers)) == 2


def written(design: HardwareDesign, tmp_path: Path) -> dict[str, bytes]:
    files = dict(read_board_files(design))
    for name in ("led_board_gerbers.zip", "led_board_notes.txt"):
        if name in files:
            (tmp_path / name).write_bytes(files[name])
    return files


@pytest.mark.parametrize("design", [DESIGN, original_hardware_design()], ids=lambda design: design.variant)
def test_the_stored_board_fits_both_variants(design: HardwareDesign, tmp_path: Path) -> None:
    """The original's own board is not written: it has eleven faults. The stored one fits its shell and its lens."""
    assert list_board_differences(design) == []
    files = written(design, tmp_path)
    with ZipFile(tmp_path / "led_board_gerbers.zip") as archive:
        names = set(archive.namelist())
    gerbers = {name.removeprefix("gerbers/") for name in files if name.startswith("gerbers/")}
    assert names == gerbers | {"led_board_notes.txt"} and len(gerbers) == 11
    notes = files["led_board_notes.txt"].decode()
    assert "Thickness: 0.8 mm. NOT the usual 1.6 mm, with which the LEDs would press" in notes and "DO NOT" not in notes


def test_a_board_that_does_not_fit_is_not_for_the_board_house(tmp_path: Path) -> None:
    large = HardwareDesign(SensorDesign(sensing_area=SensingArea(36, 27)))
    files = written(large, tmp_path)
    assert set(files) == {"led_board_notes.txt", "led_board.kicad_pro", "led_board.kicad_pcb"}
    notes = files["led_board_notes.txt"].decode()
    assert "DO NOT ORDER" in notes and "outline 40.00 / 30.00 mm instead of 28.00 / 21.00 mm" in notes
    (tmp_path / "outline.dxf").write_bytes(part_to_dxf(build_bare_board(large)))
    size = extents(ezdxf.readfile(tmp_path / "outline.dxf").modelspace()).size
    assert (size.x, size.y) == pytest.approx((40.0, 30.0))


@pytest.mark.parametrize(
    ("change", "feature"),
    [
        ({"lens_hole_mm": 10.3}, "diameter of the lens hole"),
        ({"led_inset_mm": (5.4, 3.0)}, "columns of LEDs"),
        ({"driver_at_mm": (3.7, -2.6)}, "LED driver"),
        ({"usb_mm": (7.4, 5.0, 2.65)}, "body of the micro-USB receptacle"),
        ({"locating_inset_mm": (1.6, 5.0)}, "centres of the locating holes"),
    ],
)
def test_what_to_redraw_is_named(change: dict[str, object], feature: str) -> None:
    (difference,) = list_board_differences(replace(DESIGN, board=replace(DESIGN.board, **change)))
    assert difference.startswith(feature)
    assert "expected" in describe_redrawing([difference]) and "; redraw" in describe_redrawing([difference])


def test_the_resistor_of_the_design_is_ordered(tmp_path: Path) -> None:
    """Only the usual one has an order number here."""
    files = written(replace(DESIGN, board=LedBoardDimensions(resistor_ohm=10_000)), tmp_path)
    assert "\n1,R1,10k,0805,,\n" in files["led_board_bom.csv"].decode()
    assert b"R1,10k," in files["led_board_placement.csv"] and b'value "10k"' in files["led_board.kicad_pcb"]
    assert "180 mA in total" in files["led_board_notes.txt"].decode()
    assert "R1,20k,0805,RT0805CRE0720KL,C706298" in (PROJECT / "led_board_bom.csv").read_text()


@given(ohm=st.floats(1_200, 30_000))
def test_brightness_and_resistor_are_inverse(ohm: float) -> None:
    assert LedOperatingPoint(ohm).relative_brightness * ohm == pytest.approx(20_000)
