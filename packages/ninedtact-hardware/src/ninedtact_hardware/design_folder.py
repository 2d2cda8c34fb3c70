"""The export folder of a design: the files of all parts, assembly and circuit board, and instructions for the shops.

The folder is written completely or not at all, and replaces nothing but an older export. The instructions are two texts beside
the files, one for the laser cutter and one for the print shop.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ninedtact.atomic_write import (
    create_folder_atomically,
    list_foreign_files,
    refuse_working_directory,
    write_file_atomically,
)
from ninedtact.capture.strict_image_reading import encode_png
from ninedtact.checked_reading import read_json_object
from ninedtact.errors import OutputError
from ninedtact_hardware.bill_of_materials import bill_to_csv, bill_to_html
from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.clearances import fits_of_part
from ninedtact_hardware.design_file import hardware_design_to_toml
from ninedtact_hardware.led_board import read_board_files
from ninedtact_hardware.part_and_assembly_images import (
    render_exploded_view,
    render_part,
    render_section,
    render_sensor,
)
from ninedtact_hardware.part_drawing import TOLERANCES, draw_part_as_svg_and_pdf
from ninedtact_hardware.part_files import assembly_to_step, part_to_dxf, part_to_step, part_to_stl
from ninedtact_hardware.part_solids import build_bare_board
from ninedtact_hardware.sensor_assembly import BuiltPart

STOCK_THICKNESSES_MM = 2.0, 3.0, 4.0, 5.0, 6.0
"""Thicknesses of acrylic sheet that most shops stock, by assumption: no shop was contacted."""
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


def format_shop_notes(sensor: BuildableDesign) -> Iterator[tuple[str, bytes]]:
    """Yield path and content of the instructions for the shops that cut and print the parts."""
    for method, instructions in (("cut", CUTTING_INSTRUCTIONS), ("printed", PRINTING_INSTRUCTIONS)):
        parts = [part for part in sensor.parts.values() if part.method == method]
        lines = [line for part in parts for line in _part_lines(sensor, part)]
        text = "\n".join([f"Tolerance {TOLERANCES[method]}.", "", *lines, "", instructions])
        yield f"{method}/README.txt", text.encode()


def _part_lines(sensor: BuildableDesign, part: BuiltPart) -> Iterator[str]:
    """Yield the line of a part, and of a printed one what has to fit it."""
    material, thick_mm = part.material.name, part.size_mm[2]
    count = next(item.count for item in sensor.bill if item.name == part.name)
    if part.method == "cut":
        shelf = "" if round(thick_mm, 3) in STOCK_THICKNESSES_MM else "; not on every shelf: measure"
        yield f"{part.name}: {thick_mm:.2f} mm, {count} x, {material}{shelf}"
    else:
        yield f"{part.name}: {material}, {count} x, {part.volume_mm3 / 1000:.2f} cm³"
        yield from (f"    {fit.clearance_mm:.3f}  {fit.faces}" for fit in fits_of_part(sensor.design, part.name))


MANIFEST = "manifest.json"


def require_replaceable_parts_folder(out: Path) -> None:
    """Refuse a folder unless it is missing, empty, or an earlier export and nothing else; raises `OutputError`, also for the
    working directory and the folders above it."""
    refuse_working_directory(out)
    ours = _list_exported_files(out / MANIFEST)
    if strange := list_foreign_files(out, ours.__contains__):
        raise OutputError(
            expected="--out to be new, empty or written by this command",
            got=f"{out} with other content ({strange[0]})",
            remedy="move that away, or choose another name",
        )


def _list_exported_files(manifest: Path) -> frozenset[str]:
    try:
        content = read_json_object(manifest)
    except (OSError, ValueError):
        return frozenset()
    listed = content.get("files") if "variant" in content else None
    return frozenset(map(str, listed)) if isinstance(listed, list) else frozenset()


def write_design_folder(
    sensor: BuildableDesign, out: Path, report_progress: Callable[[str], None] = lambda path: None
) -> dict[str, Any]:
    """Write the folder, whole or not at all, and return its manifest.

    report_progress: called with the path of every file before it is written. Raises `OutputError`, and
    `FileNotWritten` from the disk.
    """
    require_replaceable_parts_folder(out)
    with create_folder_atomically(out) as folder:
        for path, content in _folder_files(sensor):
            report_progress(path)
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            write_file_atomically(folder / path, content)
        manifest = _build_manifest(sensor, folder)
        write_file_atomically(folder / MANIFEST, json.dumps(manifest, indent=1, ensure_ascii=False).encode())
    return manifest


def _folder_files(sensor: BuildableDesign) -> Iterator[tuple[str, bytes]]:
    for part in sensor.parts.values():
        yield from _part_files(sensor, part)
    yield from format_shop_notes(sensor)
    yield from ((f"led_board/{name}", content) for name, content in read_board_files(sensor.design))
    if sensor.led_board_differences:
        yield "led_board/led_board_outline.dxf", part_to_dxf(build_bare_board(sensor.design))
    yield "assembly/sensor.step", assembly_to_step(sensor.bodies)
    for name, drawn in (("sensor", render_sensor), ("exploded", render_exploded_view), ("section", render_section)):
        yield f"images/{name}.png", encode_png(drawn(sensor.bodies))
    yield "bom.csv", bill_to_csv(sensor.bill)
    yield "bom.html", bill_to_html(sensor.design, sensor.bill, drawn=sensor.parts)
    yield "check.txt", "\n".join(sensor.check_report_lines()).encode()
    yield "check.json", json.dumps(sensor.to_json_dict(), indent=1, ensure_ascii=False).encode()
    yield "design.toml", hardware_design_to_toml(sensor.design).encode()


def _part_files(sensor: BuildableDesign, part: BuiltPart) -> Iterator[tuple[str, bytes]]:
    yield f"{part.method}/{part.name}.step", part_to_step(part.name, part.solid)
    if part.method == "printed":
        yield f"{part.method}/{part.name}.stl", part_to_stl(part.solid)
    if part.method == "cut":
        # The name states the thickness, because a DXF does not.
        yield f"cut/{part.name}_{part.size_mm[2]:.2f}mm.dxf", part_to_dxf(part.solid)
    yield f"images/{part.name}.png", encode_png(render_part(part))
    if part.method in TOLERANCES:
        drawings = draw_part_as_svg_and_pdf(sensor.design, part)
        yield from ((f"drawings/{part.name}.{ending}", content) for ending, content in drawings)


def _build_manifest(sensor: BuildableDesign, folder: Path) -> dict[str, Any]:
    parts = {
        part.name: {
            "method": part.method,
            "material": part.material.name,
            "volume_mm3": round(part.volume_mm3, 4),
            "box_mm": [round(side, 4) for side in part.size_mm],
        }
        for part in sensor.parts.values()
    }
    names = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    table = sensor.to_json_dict()
    kept = "variant", "specification", "lens_reach_mm", "interferences", "led_board_differences"
    checks = {name: table[name] for name in kept}
    return {"lengths": "mm", **checks, "parts": parts, "files": [*names, MANIFEST]}
