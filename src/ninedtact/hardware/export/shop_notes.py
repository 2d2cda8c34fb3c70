"""Instructions for the shops beside their files: one text for the laser cutter, one for the print shop."""

from collections.abc import Iterator

from ninedtact.hardware.built_sensor import BuiltSensor
from ninedtact.hardware.clearances import fits_of_part
from ninedtact.hardware.drawings.drawing_sheet import TOLERANCES
from ninedtact.hardware.materials import MATERIAL_OF_PART
from ninedtact.hardware.parts.part_catalogue import BuiltPart

STOCK_THICKNESSES_MM = 2.0, 3.0, 4.0, 5.0, 6.0
"""Thicknesses of acrylic sheet that most shops stock; no shop was asked."""
CUTTING_INSTRUCTIONS = """\
Lengths are in mm, 1:1, each line once. The kerf is not compensated: the lines are the finished edges.
Cut layer "inside" before layer "outside", or the plate falls out before its holes are cut.

Sheets are thinner or thicker than their nominal size, and some (2.5, 2.8 mm) are not in stock everywhere. For the 2.50 and
2.80 mm of the published sensor, take sheets sold as 2.5 and 3 mm and measure them: the gel becomes as thick as its mould.
Before the shell is printed, write the measured values into the design file, and calibrate with that file:

    [gel]
    thickness_mm = what first_mould measures
    [hardware.gels]
    black_top_mm = what second_mould measures, less first_mould

The shell's height follows from the gel. If it is printed already, add the increase in gel thickness to
camera.distance_mm.
"""
PRINTING_INSTRUCTIONS = """\
STL files are in mm; STEP files have the same geometry, exact. Black parts are black throughout, to absorb stray light; the
shell is white, to spread light. Fits are clearances on each side as drawn: try them. The drawings have all dimensions.
"""


def cut_file_path(part: BuiltPart) -> str:
    """Return the path of the cutter's file. A DXF states no thickness, so its name does."""
    return f"cut/{part.name}_{_sheet_thickness_mm(part):.2f}mm.dxf"


def _sheet_thickness_mm(part: BuiltPart) -> float:
    """Return the thickness of the sheet from which a flat part is cut."""
    return part.size_mm[2]


def format_shop_notes(sensor: BuiltSensor) -> Iterator[tuple[str, bytes]]:
    """Yield path within the folder and content of every text."""
    for method, format_part, instructions in (
        ("cut", _format_cut_part, CUTTING_INSTRUCTIONS),
        ("printed", _format_printed_part, PRINTING_INSTRUCTIONS),
    ):
        lines = [line for part in sensor.parts.values() if part.method == method for line in format_part(sensor, part)]
        text = "\n".join([f"Tolerance {TOLERANCES[method]}.", "", *lines, "", instructions])
        yield f"{method}/README.txt", text.encode()


def _format_cut_part(sensor: BuiltSensor, part: BuiltPart) -> Iterator[str]:
    """Yield the line of one plate."""
    shelf = "" if round(_sheet_thickness_mm(part), 3) in STOCK_THICKNESSES_MM else "; not on every shelf: measure"
    material = MATERIAL_OF_PART[part.name].name
    yield f"{part.name}: {_sheet_thickness_mm(part):.2f} mm, {_part_count(sensor, part)} x, {material}{shelf}"


def _format_printed_part(sensor: BuiltSensor, part: BuiltPart) -> Iterator[str]:
    """Yield the line of one printed part, and what has to fit it."""
    made, cm3 = MATERIAL_OF_PART[part.name].name, part.volume_mm3 / 1000
    yield f"{part.name}: {made}, {_part_count(sensor, part)} x, {cm3:.2f} cm³"
    yield from (f"    {fit.clearance_mm:.3f}  {fit.faces}" for fit in fits_of_part(sensor.design, part.name))


def _part_count(sensor: BuiltSensor, part: BuiltPart) -> int:
    """Return how many of a part the bill of materials has."""
    return next(item.count for item in sensor.bill if item.name == part.name)
