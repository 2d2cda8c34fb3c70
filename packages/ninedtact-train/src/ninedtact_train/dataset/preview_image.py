"""The preview image of a data set: tiles of some pairs, red where darker, green where brighter, with the wrench as text above.

The pairs are sorted from the lightest to the heaviest load, so that swapped axes or labels are visible at a glance: a
heavier contact must look larger, and the arrow (the shear force) must point where the object leans.
"""

from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from ninedtact.errors import InputError
from ninedtact.force.brightness_channels import render_brightness_change, split_darker_brighter
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

_TILES_PER_ROW, _TILE_IN = 6, (2.4, 2.2)
_ARROW_WIDTHS_PER_N = 1 / 12
"""Length of the arrow in widths of the image."""
_CONTRAST = 2
"""Contrast relative to that of the live page: the tiles are small and viewed only briefly."""


def render_preview(folder: Path, pairs: int = 24) -> bytes:
    """Render some pairs of a data set, evenly spread over the loads, as one PNG image.

    Raises `FileFormatError`, `InputError`.
    """
    from matplotlib.figure import Figure

    files = find_pair_files(folder)
    references = ReferenceImageFile(folder / REFERENCES_FILE)
    rendered = [(row, _render_pair(row, references)) for row in _read_spread_over_loads(files, pairs)]
    shown = [(row, tile) for row, tile in rendered if tile is not None]
    if not shown:
        raise InputError(
            expected=f"pairs with an image and a reference in {folder}",
            got="none",
            remedy="run ninedtact dataset check",
        )
    across = min(_TILES_PER_ROW, len(shown))
    down = -(-len(shown) // across)
    figure = Figure(figsize=(_TILE_IN[0] * across, _TILE_IN[1] * down), layout="constrained")
    all_axes = figure.subplots(down, across, squeeze=False).ravel()
    for axes in all_axes:
        axes.axis("off")
    for axes, (row, tile) in zip(all_axes, shown, strict=False):
        wrench, middle = decode_stored_wrench(row["wrench"]), np.array(tile.shape[1::-1]) / 2
        tip = middle + _ARROW_WIDTHS_PER_N * tile.shape[1] * wrench[:2]
        axes.imshow(tile[..., ::-1])
        axes.annotate("", tip, middle, arrowprops={"arrowstyle": "->", "color": "white"})
        force = "F {:+.2f} {:+.2f} {:+.2f} N   Tz {:+.1f} N·mm".format(*wrench[:3], 1e3 * wrench[5])
        axes.set_title(f"{row['object'] or '?'}, {row['kind'] or '?'}\n{force}", fontsize=7, parse_math=False)
    content = BytesIO()
    figure.savefig(content, format="png")
    return content.getvalue()


def _read_spread_over_loads(files: Sequence[Path], pairs: int) -> Iterator[dict[str, Any]]:
    columns = [read_columns([file], ["wrench"]) for file in files]
    places = [(file, row) for file, column in zip(files, columns, strict=True) for row in range(column.num_rows)]
    wrenches = np.concatenate([wrench_array(column) for column in columns])
    finite = np.flatnonzero(np.isfinite(wrenches).all(1))
    order = finite[np.argsort(-wrenches[finite, 2], kind="stable")]
    ranks = np.linspace(0, len(order) - 1, min(max(pairs, 1), len(order))).round().astype(int)
    for place in order[np.unique(ranks)]:
        file, row = places[place]
        yield from iterate_rows_at(file, [row])


def _render_pair(row: dict[str, Any], references: ReferenceImageFile) -> UInt8[Array, "rows cols 3"] | None:
    """Return the change of one image; None if it cannot be drawn."""
    try:
        image = decode_stored_image(row["image"])
    except StoredImageUnreadable:
        return None
    reference = references.find(row["reference_id"])
    if reference is None or reference.shape != image.shape:
        return None
    grey, reference_grey = image.astype(np.float32), reference.astype(np.float32)
    darker, brighter = (_CONTRAST * part for part in split_darker_brighter(grey, reference_grey))
    return render_brightness_change(Deformation(darker, brighter, reference_grey, 1.0))
