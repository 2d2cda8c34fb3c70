"""What a board house gets is the board: read back by gerbonara."""

import csv
from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import pytest
from gerbonara import LayerStack
from read_back import edge_of, hits_of, shape_of, slots_of
from shapely import LineString, Point, union_all

from ninedtact_hardware.led_board.board_outline_and_holes import BoardOutline, LedBoardImpossible
from ninedtact_hardware.led_board.board_parameters import LedBoardDesign
from ninedtact_hardware.led_board.complete_layout import (
    BoardLayout,
    component_outline,
    hole_polygon,
    lay_out_board,
    milled_board_polygon,
    pad_polygon,
)
from ninedtact_hardware.led_board.components import BoardSide
from ninedtact_hardware.led_board.design_rule_check import list_copper_pieces
from ninedtact_hardware.led_board.fabrication_files import build_board_files, write_checked_board_files
from ninedtact_hardware.led_board.silkscreen import place_designators

PUBLISHED_AREA_MM2 = 551.23
"""Of the outline, lens hole not taken out."""
SIDES: list[tuple[BoardSide, str]] = [("top", "F"), ("bottom", "B")]


def gerber(folder: Path, name: str) -> Path:
    return folder / "gerbers" / f"led_board-{name}"


def test_the_outline_read_back_is_the_boards(folder: Path, improved: BoardLayout) -> None:
    read, meant = edge_of(gerber(folder, "Edge_Cuts.gbr")), milled_board_polygon(improved.board.outline)
    assert read.bounds == pytest.approx((-14, -10.5, 14, 10.5), abs=1e-5)
    assert read.symmetric_difference(meant).area < 0.05
    lens = 3.14159265 * 5.1**2
    assert read.area + lens == pytest.approx(PUBLISHED_AREA_MM2, abs=0.02)


@pytest.mark.parametrize("outline", [BoardOutline(40, 30), BoardOutline(64, 48, notch_radius_mm=3.5)])
def test_other_outlines_read_back(outline: BoardOutline, tmp_path: Path) -> None:
    from ninedtact_hardware.led_board.board_outline_and_holes import outline_segments
    from ninedtact_hardware.led_board.gerber_and_drill import format_gerber_outline

    (tmp_path / "edge.gbr").write_text(format_gerber_outline(outline_segments(outline)))
    assert edge_of(tmp_path / "edge.gbr").symmetric_difference(milled_board_polygon(outline)).area < 0.08


def test_the_originals_board_has_the_published_volume(original: BoardLayout) -> None:
    """Small drills left in, as the published volume has it."""
    outline = original.board.outline
    holes = sum(hole_polygon(hole).area for hole in original.holes if not hole.plated and hole.width_mm > 1)
    assert (milled_board_polygon(outline).area - holes) * outline.thickness_mm == pytest.approx(372.50, rel=1e-3)


@pytest.mark.parametrize(("side", "letter"), SIDES)
def test_copper_read_back_is_the_boards(folder: Path, improved: BoardLayout, side: BoardSide, letter: str) -> None:
    meant = union_all([piece.shape for piece in list_copper_pieces(improved) if side in piece.sides])
    read = shape_of(gerber(folder, f"{letter}_Cu.gbr"))
    assert read.symmetric_difference(meant).area < 0.001 * meant.area


@pytest.mark.parametrize(("side", "letter"), SIDES)
def test_every_pad_is_open_in_the_mask(folder: Path, improved: BoardLayout, side: BoardSide, letter: str) -> None:
    mask = shape_of(gerber(folder, f"{letter}_Mask.gbr"))
    bare = union_all([pad_polygon(pad) for pad in improved.pads if side in pad.sides])
    assert mask.buffer(1e-4).contains(bare)
    assert mask.area < bare.buffer(0.0501, join_style="mitre").area


def test_paste_stays_on_pads(folder: Path, improved: BoardLayout) -> None:
    for side, letter in SIDES:
        pads = union_all([pad_polygon(pad) for pad in improved.pads if pad.sides == (side,)])
        assert pads.buffer(1e-4).contains(shape_of(gerber(folder, f"{letter}_Paste.gbr")))


def test_marks_keep_off_pads_and_edges(folder: Path, improved: BoardLayout) -> None:
    for _, letter in SIDES:
        marks = shape_of(gerber(folder, f"{letter}_Silkscreen.gbr"))
        assert marks.area > 0
        assert marks.distance(shape_of(gerber(folder, f"{letter}_Mask.gbr"))) > 0.05
        assert marks.distance(milled_board_polygon(improved.board.outline).boundary) > 0.1


def test_hits_are_the_holes(folder: Path, improved: BoardLayout) -> None:
    for plated, name in ((True, "PTH.drl"), (False, "NPTH.drl")):
        drilled = [hole for hole in improved.holes if hole.plated == plated and hole.start_mm == hole.end_mm]
        meant = sorted((round(hole.start_mm[0], 4), round(hole.start_mm[1], 4), hole.width_mm) for hole in drilled)
        assert hits_of(gerber(folder, name)) == meant


def test_slots_are_the_connectors(folder: Path) -> None:
    assert slots_of(gerber(folder, "NPTH.drl")) == []
    slots = slots_of(gerber(folder, "PTH.drl"))
    assert [(x, width) for x, _, _, _, width in slots] == [(-2.825, 0.61), (2.825, 0.61)]
    assert [abs(y2 - y1) for _, y1, _, y2, _ in slots] == pytest.approx([0.99, 0.99])


def test_a_strangers_program_knows_every_layer(folder: Path) -> None:
    stack = LayerStack.open(folder / "gerbers")
    names = {f"{side} {use}" for side in ("top", "bottom") for use in ("copper", "mask", "silk", "paste")}
    assert names <= {" ".join(name) for name in stack.graphic_layers}
    assert stack.outline is not None and len(list(stack.drill_layers)) == 2


def test_the_archive_holds_the_gerbers(folder: Path) -> None:
    with ZipFile(folder / "led_board_gerbers.zip") as archive:
        names = set(archive.namelist())
    assert names == {file.name for file in (folder / "gerbers").iterdir()} | {"led_board_notes.txt"}


def test_lists_name_every_part_once(folder: Path, improved: BoardLayout) -> None:
    bom = list(csv.DictReader((folder / "led_board_bom.csv").open()))
    places = list(csv.DictReader((folder / "led_board_placement.csv").open()))
    references = {part.reference for part in improved.parts}
    assert {name for row in bom for name in row["Designator"].split(",")} == references
    assert {row["Designator"] for row in places} == references and len(places) == len(references)
    led, resistor = (next(row for row in bom if name in row["Designator"]) for name in ("LED1", "R1"))
    assert led["Quantity"] == "8" and resistor["LCSC Part #"] == "C706298"
    assert resistor["Manufacturer Part"] == "RT0805CRE0720KL"
    first = next(row for row in places if row["Designator"] == "LED1")
    assert (first["Mid X"], first["Mid Y"], first["Layer"]) == ("-8.800mm", "7.500mm", "Top")


def test_gerbers_and_placement_have_one_origin(folder: Path, improved: BoardLayout) -> None:
    """Every pad, put where the placement list says that its part is, lies on an opening of the mask."""
    parts = {part.reference: part for part in improved.parts}
    masks = {"Top": shape_of(gerber(folder, "F_Mask.gbr")), "Bottom": shape_of(gerber(folder, "B_Mask.gbr"))}
    for row in csv.DictReader((folder / "led_board_placement.csv").open()):
        at = float(row["Mid X"].removesuffix("mm")), float(row["Mid Y"].removesuffix("mm"))
        told = replace(parts[row["Designator"]], at_mm=at, rotation_deg=float(row["Rotation"]))
        for land in told.part.footprint.lands:
            assert masks[row["Layer"]].contains(Point(told.to_board_frame(land.at_mm))), (
                row["Designator"],
                land.number,
            )


@pytest.mark.parametrize("size", [(28.0, 21.0), (64.0, 48.0)])
def test_every_part_has_its_name_beside_it(size: tuple[float, float]) -> None:
    layout = lay_out_board(LedBoardDesign.for_size(*size))
    for side, _ in SIDES:
        meant = {part.reference: part for part in layout.parts if part.side == side}
        words = place_designators(layout, side)
        assert {word.reference for word in words} == set(meant)
        for word in words:
            line = LineString(word.lines[0])
            assert min(meant, key=lambda name: component_outline(meant[name]).distance(line)) == word.reference


def test_notes_tell_the_thickness(folder: Path) -> None:
    notes = (folder / "led_board_notes.txt").read_text()
    assert "Thickness: 0.8 mm" in notes and "DO NOT ORDER" not in notes


def test_the_original_is_written_with_a_warning(tmp_path: Path) -> None:
    write_checked_board_files(LedBoardDesign.original(), tmp_path)
    assert "DO NOT ORDER" in (tmp_path / "led_board_notes.txt").read_text()


def test_a_faulty_board_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(LedBoardImpossible):
        write_checked_board_files(LedBoardDesign(usb_contact_mm=1.5), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_same_board_gives_the_same_files(improved: BoardLayout, folder: Path) -> None:
    for name, content in build_board_files(improved).items():
        assert (folder / name).read_bytes() == content, name
