"""Everything about one design, written as one folder."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2

from ninedtact.atomic_write import write_file_atomically
from ninedtact.hardware.design_file import hardware_toml
from ninedtact.hardware.drawings.sheet import Sheet
from ninedtact.hardware.drawings.table import table
from ninedtact.hardware.export.bill_files import bill_csv, bill_html
from ninedtact.hardware.export.cutting import dxf
from ninedtact.hardware.export.folder import MANIFEST, new_parts_folder
from ninedtact.hardware.export.shop_notes import cut_path, shop_notes
from ninedtact.hardware.export.solid_files import assembly_step, printable, step
from ninedtact.hardware.images.scenes import exploded_image, part_image, section_image, sensor_image
from ninedtact.hardware.images.shaded import Image
from ninedtact.hardware.led_board.export import write_layout
from ninedtact.hardware.materials import MADE_OF
from ninedtact.hardware.parts.catalogue import TO_MAKE, BuiltPart
from ninedtact.hardware.report import BuiltSensor

File = tuple[str, bytes]
"""Path within the folder, and content."""
Progress = Callable[[str], None]


def quiet(_: str) -> None:
    """No word about the work."""


def export_parts(sensor: BuiltSensor, out: Path, tell: Progress = quiet) -> dict[str, Any]:
    """Write the folder, whole or not at all, and return its manifest.

    tell: called with what is being written. Raises `FolderRefused`, and `FileNotWritten` from the disk.
    """
    with new_parts_folder(out) as folder:
        for path, content in files(sensor):
            tell(path)
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            write_file_atomically(folder / path, content)
        tell("led_board")
        write_layout(sensor.circuit, folder / "led_board")
        manifest = manifest_of(sensor, folder)
        write_file_atomically(folder / MANIFEST, json.dumps(manifest, indent=1, ensure_ascii=False).encode())
    return manifest


def files(sensor: BuiltSensor) -> Iterator[File]:
    """All but the circuit board and the manifest."""
    for part in sensor.parts.values():
        yield from part_files(sensor, part)
    yield from shop_notes(sensor)
    yield from assembly_files(sensor)
    yield "bom.csv", bill_csv(sensor.bill)
    yield "bom.html", bill_html(sensor.design, sensor.bill)
    yield "check.txt", "\n".join(sensor.lines()).encode()
    yield "check.json", json.dumps(sensor.as_table(), indent=1, ensure_ascii=False).encode()
    yield "design.toml", hardware_toml(sensor.design).encode()


def part_files(sensor: BuiltSensor, part: BuiltPart) -> Iterator[File]:
    """One part: for machines, and for eyes."""
    yield f"{part.way}/{part.name}.step", step(part.name, part.solid)
    if part.way == "printed":
        yield f"{part.way}/{part.name}.stl", printable(part.solid)
    if part.way == "cut":
        yield cut_path(part), dxf(part.solid)
    yield f"images/{part.name}.png", encoded(part_image(part))
    if part.way in TO_MAKE:
        sheet = Sheet(part, table(sensor.design, part))
        yield from ((f"drawings/{part.name}.{ending}", content) for ending, content in sheet.files())


def assembly_files(sensor: BuiltSensor) -> Iterator[File]:
    """The finished sensor."""
    yield "assembly/sensor.step", assembly_step(sensor.bodies)
    for name, drawn in (("sensor", sensor_image), ("exploded", exploded_image), ("section", section_image)):
        yield f"images/{name}.png", encoded(drawn(sensor.bodies))


def manifest_of(sensor: BuiltSensor, folder: Path) -> dict[str, Any]:
    """What is in the folder, and what every part should measure."""
    parts = {
        part.name: {
            "way": part.way,
            "material": MADE_OF[part.name].name,
            "volume_mm3": round(part.volume_mm3, 4),
            "box_mm": [round(side, 4) for side in part.size_mm],
        }
        for part in sensor.parts.values()
    }
    names = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())
    table = sensor.as_table()
    kept = "variant", "figures", "lens_reach_mm", "interferences", "led_board_faults"
    told = {name: table[name] for name in kept}
    return {"lengths": "mm", **told, "parts": parts, "files": [*names, MANIFEST]}


def encoded(image: Image) -> bytes:
    """As PNG."""
    return cv2.imencode(".png", image)[1].tobytes()
