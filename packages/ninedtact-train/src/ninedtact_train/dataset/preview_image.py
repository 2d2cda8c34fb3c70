"""The preview image of a data set: tiles of some pairs, red where darker, green where brighter, with the wrench as text below.

The pairs are sorted from the lightest to the heaviest load, so that swapped axes or labels are visible at a glance: a
heavier contact must look larger, and the arrow (the shear force, 20 pixels a newton) must point where the object leans.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from ninedtact.errors import InputError
from ninedtact.force.brightness_channels import render_deformation, split_darker_brighter
from ninedtact.quantities import Deformation
from ninedtact_train.dataset.folder import REFERENCES_FILE, find_pair_files
from ninedtact_train.dataset.parquet_files import (
    ReferenceImageFile,
    StoredImageUnreadable,
    decode_stored_image,
    decode_stored_wrench,
    iterate_rows_at,
    read_columns,
    wrench_array,
)

_ColourImage = UInt8[Array, "_ _ 3"]
_TILE_SIZE = (240, 180)
_CAPTION_PX, _MARGIN_PX = 34, 4
_TILES_PER_ROW = 6
_ARROW_PX_PER_N = 20.0
_CONTRAST = 2
"""Contrast relative to that of the live page: the tiles are small and viewed only briefly."""
_GREY, _WHITE = (170, 170, 170), (255, 255, 255)


def render_preview(folder: Path, pairs: int = 24) -> _ColourImage:
    """Render some pairs of a data set, evenly spread over the loads, as one BGR image.

    Raises `FileFormatError`, `InputError`.
    """
    files = find_pair_files(folder)
    references = ReferenceImageFile(folder / REFERENCES_FILE)
    tiles = [_render_tile(row, references) for row in _read_spread_over_loads(files, pairs)]
    rendered = [tile for tile in tiles if tile is not None]
    if not rendered:
        raise InputError(
            expected=f"pairs with an image and a reference in {folder}",
            got="none",
            remedy="run ninedtact dataset check",
        )
    return _arrange_tiles(rendered)


def _read_spread_over_loads(files: Sequence[Path], pairs: int) -> Iterator[dict[str, Any]]:
    """Yield pairs from the lightest to the heaviest load."""
    columns = [read_columns([file], ["wrench"]) for file in files]
    places = [(file, row) for file, column in zip(files, columns, strict=True) for row in range(column.num_rows)]
    wrenches = np.concatenate([wrench_array(column) for column in columns])
    finite = np.flatnonzero(np.isfinite(wrenches).all(1))
    order = finite[np.argsort(-wrenches[finite, 2], kind="stable")]
    ranks = np.linspace(0, len(order) - 1, min(max(pairs, 1), len(order))).round().astype(int)
    for place in order[np.unique(ranks)]:
        file, row = places[place]
        yield from iterate_rows_at(file, [row])


def _render_tile(row: dict[str, Any], references: ReferenceImageFile) -> _ColourImage | None:
    """Return the image of one pair with its caption; None if it cannot be drawn."""
    try:
        image = decode_stored_image(row["image"])
    except StoredImageUnreadable:
        return None
    reference = references.find(row["reference_id"])
    if reference is None or reference.shape != image.shape:
        return None
    image_and_reference = [
        cv2.resize(grey, _TILE_SIZE, interpolation=cv2.INTER_AREA).astype(np.float32) for grey in (image, reference)
    ]
    darker, brighter = (_CONTRAST * part for part in split_darker_brighter(*image_and_reference))
    tile = render_deformation(Deformation(darker, brighter, image_and_reference[1], 1.0))
    wrench = decode_stored_wrench(row["wrench"])
    _draw_shear_arrow(tile, wrench)
    return np.concatenate([tile, _render_caption(row, wrench)])


def _draw_shear_arrow(tile: _ColourImage, wrench: Array) -> None:
    """Draw the shear force from the middle of the tile."""
    middle = np.array(_TILE_SIZE) / 2
    tip = middle + _ARROW_PX_PER_N * wrench[:2]
    begin, end = ((round(float(x)), round(float(y))) for x, y in (middle, tip))
    cv2.arrowedLine(tile, begin, end, _WHITE, 1, cv2.LINE_AA, tipLength=0.2)


def _render_caption(row: dict[str, Any], wrench: Array) -> _ColourImage:
    """Return two lines of text: the object and the kind of pair; force and torque."""
    strip = np.zeros((_CAPTION_PX, _TILE_SIZE[0], 3), np.uint8)
    texts = (
        f"{row['object'] or '?'}, {row['kind'] or '?'}",
        "F {:+.2f} {:+.2f} {:+.2f} N   Tz {:+.1f} N.mm".format(*wrench[:3], 1e3 * wrench[5]),
    )
    for line, text in enumerate(texts):
        ascii_text = text.encode("ascii", "replace").decode()
        corner = (2, 13 + 15 * line)
        cv2.putText(strip, ascii_text, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (_WHITE, _GREY)[line], 1, cv2.LINE_AA)
    return strip


def _arrange_tiles(tiles: Sequence[_ColourImage]) -> _ColourImage:
    """Return the tiles side by side on a dark background."""
    rows, cols = tiles[0].shape[:2]
    across = min(_TILES_PER_ROW, len(tiles))
    down = -(-len(tiles) // across)
    canvas = np.full((down * (rows + _MARGIN_PX), across * (cols + _MARGIN_PX), 3), 40, np.uint8)
    for number, tile in enumerate(tiles):
        top, left = number // across * (rows + _MARGIN_PX), number % across * (cols + _MARGIN_PX)
        canvas[top : top + rows, left : left + cols] = tile
    return canvas
