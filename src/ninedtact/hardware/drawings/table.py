"""The column of text beside the views: material, tolerance, fits, holes, dimensions by their names in the design file."""

from collections.abc import Iterator
from dataclasses import dataclass, fields

from ninedtact.hardware.clearances import clearances
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.drawings.views import Rounds, rounds
from ninedtact.hardware.materials import MADE_OF
from ninedtact.hardware.parts.catalogue import BuiltPart

SHAPED_BY = {
    "sensor_base": "base",
    "sensor_shell": "shell",
    "isolation_ring": "ring",
    "acrylic_window": "window",
    "calibration_board": "pin_frame",
    "base_board": "moulds",
    "first_mould": "moulds",
    "second_mould": "moulds",
}
"""Table of the design file, by part."""
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
    """Holes and pins."""
    yield Row("round, about z (diameter: places x, y)", heading=True)
    yield from (Row(text) for each in rounds(part.solid) for text in told(each))


def told(found: Rounds) -> Iterator[str]:
    """A group of holes in lines that fit; those of a lattice as their number."""
    head = f"{len(found.places)} x ⌀{found.diameter_mm:.2f}: "
    if len(found.places) > 8:
        yield head + "on the lattice of the pin board"
        return
    places = [f"({x:g}, {y:g})" for x, y in found.places]
    for start in range(0, len(places), 4):
        yield (head if start == 0 else "      ") + " ".join(places[start : start + 4])


def dimensions(design: HardwareDesign, part: str) -> Iterator[Row]:
    """Each as `name value`, as it stands in the design file."""
    name = SHAPED_BY[part]
    found = getattr(design, name)
    yield Row("dimensions of the design", heading=True)
    yield from (Row(f"{name}.{field.name}  {number(getattr(found, field.name))}") for field in fields(found))


def number(value: float | tuple[float, ...]) -> str:
    """As a person writes it."""
    return f"({', '.join(f'{each:g}' for each in value)})" if isinstance(value, tuple) else f"{value:g}"
