"""Some pairs of a data set as one image for a person: red where darker, green where brighter, the wrench below.

They are drawn from the lightest to the heaviest load, so that a turned axis or a swapped label is seen at once: heavier
must look larger, and the arrow (the shear, 2 mm a newton) must point where the object leans.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from ninedtact.dataset.checks import Untouched
from ninedtact.dataset.columns import bytes_of, rows_at, rows_of, six
from ninedtact.dataset.rows import NotAImage, decoded
from ninedtact.dataset.sources.table import REFERENCES, pair_files
from ninedtact.errors import NinedtactError
from ninedtact.force.deformation import deformation_image, parts
from ninedtact.quantities import Deformation

Colour = UInt8[Array, "_ _ 3"]
TILE = (240, 180)
CAPTION_PX, MARGIN_PX = 34, 4
ACROSS = 6
ARROW_PX_PER_N = 20.0
BRIGHTER_THAN_LIVE = 2
"""Small images, looked at for a moment."""
GREY, WHITE = (170, 170, 170), (255, 255, 255)


class NothingToShow(NinedtactError):
    """No pair that can be drawn."""


@dataclass(frozen=True)
class Place:
    """A pair's file and row."""

    file: Path
    row: int


def contact_sheet(folder: Path, pairs: int = 24) -> Colour:
    """So many pairs, evenly spread over loads, BGR; raises `DataSetDamaged`, `NothingToShow`."""
    files = pair_files(folder)
    untouched = Untouched([folder / REFERENCES])
    tiles = [tile(row, untouched) for row in rows_in(spread(files, pairs))]
    drawn = [one for one in tiles if one is not None]
    if not drawn:
        raise NothingToShow(
            f"expected pairs with an image and a reference in {folder}, got none; run ninedtact dataset check"
        )
    return in_rows(drawn)


def spread(files: Sequence[Path], pairs: int) -> list[Place]:
    """Pairs from the lightest to the heaviest."""
    loads, places = [], []
    for file in files:
        for number, row in enumerate(rows_of(file, ["wrench"])):
            wrench = six(row["wrench"])
            if np.isfinite(wrench).all():
                loads.append(-wrench[2])
                places.append(Place(file, number))
    order = np.argsort(np.array(loads), kind="stable")
    ranks = np.unique(np.linspace(0, len(order) - 1, min(max(pairs, 1), len(order))).round().astype(int))
    return [places[number] for number in order[ranks]] if len(order) else []


def rows_in(places: Sequence[Place]) -> Iterator[dict[str, Any]]:
    """The rows at these places, in their order."""
    numbers: dict[Path, set[int]] = {}
    for place in places:
        numbers.setdefault(place.file, set()).add(place.row)
    found = {
        (file, number): row
        for file, wanted in numbers.items()
        for number, row in zip(sorted(wanted), rows_at(file, wanted), strict=True)
    }
    return (found[place.file, place.row] for place in places)


def tile(row: dict[str, Any], untouched: Untouched) -> Colour | None:
    """One pair with its caption; None where it cannot be drawn."""
    try:
        image = decoded(bytes_of(row["image"]))
    except NotAImage:
        return None
    reference = untouched[row.get("reference")]
    if reference is None or reference.shape != image.shape:
        return None
    small = [cv2.resize(grey, TILE, interpolation=cv2.INTER_AREA).astype(np.float32) for grey in (image, reference)]
    darker, brighter = (BRIGHTER_THAN_LIVE * part for part in parts(*small))
    drawn = deformation_image(Deformation(darker, brighter, small[1], 1.0))
    with_arrow(drawn, six(row["wrench"]))
    return np.concatenate([drawn, caption(row)])


def with_arrow(drawn: Colour, wrench: Array) -> None:
    """The shear, from the middle of the image."""
    middle = np.array(TILE) / 2
    tip = middle + ARROW_PX_PER_N * wrench[:2]
    begin, end = ((round(float(x)), round(float(y))) for x, y in (middle, tip))
    cv2.arrowedLine(drawn, begin, end, WHITE, 1, cv2.LINE_AA, tipLength=0.2)


def caption(row: dict[str, Any]) -> Colour:
    """What pressed, and how hard."""
    strip = np.zeros((CAPTION_PX, TILE[0], 3), np.uint8)
    wrench = six(row["wrench"])
    said = (
        f"{row.get('object') or '?'}, {row.get('kind') or '?'}",
        "F {:+.2f} {:+.2f} {:+.2f} N   Tz {:+.1f} mNm".format(*wrench[:3], 1e3 * wrench[5]),
    )
    for line, text in enumerate(said):
        plain = text.encode("ascii", "replace").decode()
        place = (2, 13 + 15 * line)
        cv2.putText(strip, plain, place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (WHITE, GREY)[line], 1, cv2.LINE_AA)
    return strip


def in_rows(tiles: Sequence[Colour]) -> Colour:
    """Side by side, on black."""
    rows, cols = tiles[0].shape[:2]
    across = min(ACROSS, len(tiles))
    down = -(-len(tiles) // across)
    sheet = np.full((down * (rows + MARGIN_PX), across * (cols + MARGIN_PX), 3), 40, np.uint8)
    for number, drawn in enumerate(tiles):
        top, left = number // across * (rows + MARGIN_PX), number % across * (cols + MARGIN_PX)
        sheet[top : top + rows, left : left + cols] = drawn
    return sheet
