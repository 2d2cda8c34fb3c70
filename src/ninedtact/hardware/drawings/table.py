"""The column of text beside the views: material, tolerance, fits, holes, dimensions by their names in the design file."""

from collections.abc import Iterator
from dataclasses import dataclass, fields

from ninedtact.hardware.clearances import clearances
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.drawings.features import Rounds, rounds
from ninedtact.hardware.materials import MADE_OF
from ninedtact.hardware.parts.catalogue import BuiltPart

PLATE = ("moulds.beyond_mm", "moulds.corner_radius_mm", "moulds.hole_mm", "moulds.hole_inset_mm", "moulds.pairs_mm")
PINS = ("pin_board.rows", "pin_board.cols", "pin_board.pitch_mm", "pin_board.pin_diameter_mm")
SHAPED_BY = {
    "sensor_base": ("base",),
    "sensor_shell": ("shell",),
    "isolation_ring": ("ring",),
    "acrylic_window": ("window",),
    "calibration_board": ("pin_frame", *PINS),
    "base_board": (*PLATE, "moulds.base_mm", "moulds.shell_screw_mm"),
    "first_mould": (*PLATE, "gel.thickness_mm", "gels.rim_radius_mm"),
    "second_mould": (*PLATE, "gel.thickness_mm", "gels.rim_radius_mm", "gels.black_top_mm", "gels.black_side_mm"),
}
"""Tables of the design file, or single lines of them, by part."""
TOLERANCES = {
    "printed": "± 0.15; what has to fit is listed below: try it",
    "cut": "± 0.10; sheets vary: measure the thickness",
}
"""By way of making; what these shops usually hold, no shop was asked."""


@dataclass(frozen=True)
class Row:
    """One line."""

    text: str
    heading: bool = False


def table(design: HardwareDesign, part: BuiltPart) -> list[Row]:
    """All that is said of a part."""
    return [*making(part), *fits(design, part.name), *round_rows(part), *dimensions(design, part.name)]


def making(part: BuiltPart) -> Iterator[Row]:
    """Material, way, tolerance."""
    yield Row(f"{MADE_OF[part.name].name}, {part.way}")
    yield Row(f"tolerance {TOLERANCES[part.way]}")


def fits(design: HardwareDesign, part: str) -> Iterator[Row]:
    """What has to pass, with its nominal room on each side."""
    found = [each for each in clearances(design) if part in each.held_by]
    if found:
        yield Row("fits: room on each side", heading=True)
        yield from (Row(f"{each.mm:.3f}  {each.between}") for each in found)


def round_rows(part: BuiltPart) -> Iterator[Row]:
    """Holes and pins, if there are any."""
    if found := [*rounds(part.solid)]:
        yield Row("round, about z (diameter: places x, y)", heading=True)
        yield from (Row(text) for each in found for text in told(each))


def told(found: Rounds) -> Iterator[str]:
    """A group of holes in lines that fit; a lattice by its columns, rows and pitch."""
    head = f"{len(found.places)} x ⌀{found.diameter_mm:.2f}: "
    if found.lattice:
        columns, rows, pitch = found.lattice
        (low_x, low_y), (high_x, high_y) = min(found.places), max(found.places)
        yield f"{head}{columns} columns x {rows} rows, pitch {pitch:.2f}"
        yield f"      x from {low_x:g} to {high_x:g}, y from {low_y:g} to {high_y:g}"
        return
    places = [f"({x:g}, {y:g})" for x, y in found.places]
    for start in range(0, len(places), 4):
        yield (head if start == 0 else "      ") + " ".join(places[start : start + 4])


def dimensions(design: HardwareDesign, part: str) -> Iterator[Row]:
    """Each as `name value`, as it stands in the design file; tables of the hardware without their `hardware.`."""
    yield Row("dimensions of the design", heading=True)
    for name in SHAPED_BY[part]:
        table, _, only = name.partition(".")
        found = getattr(design, table, None) or getattr(design.sensor, table)
        names = [only] if only else [field.name for field in fields(found)]
        yield from (Row(f"{table}.{each}  {number(getattr(found, each))}") for each in names)
    if part == "calibration_board":
        yield Row(
            f"tips of the pins at z  {design.pin_frame.floor_mm + design.pin_frame.pin_tall_mm:.2f}, on one plane"
        )


def number(value: float | tuple[float, ...]) -> str:
    """As a person writes it."""
    return f"({', '.join(f'{each:g}' for each in value)})" if isinstance(value, tuple) else f"{value:g}"
