"""An image of the board as it is seen from the gel and from below. matplotlib is imported when an image is drawn."""

from io import BytesIO
from math import hypot
from typing import TYPE_CHECKING

import numpy as np
from shapely import Polygon, union_all
from shapely.geometry.base import BaseGeometry

from ninedtact.hardware.led_board.board_outline import PointMm
from ninedtact.hardware.led_board.complete_layout import SIDES, BoardLayout
from ninedtact.hardware.led_board.components import BoardSide, PlacedComponent
from ninedtact.hardware.led_board.copper_geometry import (
    bare_board_polygon,
    component_outline,
    hole_polygon,
    pad_polygon,
    split_polygons,
    track_polygon,
    via_polygon,
)
from ninedtact.hardware.led_board.silkscreen import place_designators

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.path import Path

MASK, METAL, SOLDERED, BODY, INK = "#1f6b45", "#2f9a63", "#d9b65d", "#f4f1e6", "#22262b"
DARK_BODY = "#3b3f46"
USUAL_INCHES = 13.0, 5.6
"""Width and height of the figure for a board of 28 x 21 mm."""
INCHES_PER_MM = USUAL_INCHES[0] / 14.0, USUAL_INCHES[1] / 10.5
NAME_MM = 0.7
"""Height of a component's name."""
HEADINGS: dict[BoardSide, str] = {"top": "from the gel", "bottom": "from below, mirrored as one sees it"}


def render_board_image(layout: BoardLayout, kind: str = "png") -> bytes:
    """Return both sides beside one another, as `png` or `svg`."""
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    (x, y), (wide, tall) = layout.board.outline.half, _figure_inches(layout)
    figure = Figure(figsize=(wide, tall), facecolor="white", layout="constrained")
    for side, axes in zip(SIDES, figure.subplots(1, 2), strict=True):
        _draw_side(axes, layout, side)
        axes.set_xlim(*((-x - 1.2, x + 1.2) if side == "top" else (x + 1.2, -x - 1.2)))
        axes.set_ylim(-y - 1.2, y + 1.2)
        axes.set_aspect("equal")
        axes.set_title(HEADINGS[side], color=INK, size=12)
        axes.set_xlabel("x (mm)")
    file = BytesIO()
    # This replaces a random identifier, so that the same board gives the same file.
    with rc_context({"svg.hashsalt": "ninedtact"}):
        figure.savefig(file, format=kind, dpi=110, metadata={"Date": None} if kind == "svg" else {"Software": None})
    return file.getvalue()


def _figure_inches(layout: BoardLayout) -> tuple[float, float]:
    """Return the size of the figure: the same inches per mm for every board, so that texts keep their size beside the
    pads."""
    x, y = layout.board.outline.half
    return max(x * INCHES_PER_MM[0], USUAL_INCHES[0]), max(y * INCHES_PER_MM[1], USUAL_INCHES[1])


def _draw_side(axes: "Axes", layout: BoardLayout, side: BoardSide) -> None:
    """Draw laminate, copper under the mask, bare pads, holes and bodies of one side."""
    tracks = [track_polygon(track) for track in layout.routes.tracks if track.side == side]
    vias = [via_polygon(via) for via in layout.routes.vias]
    _fill_shape(axes, bare_board_polygon(layout.board.outline), MASK)
    _fill_shape(axes, union_all([*tracks, *vias, *layout.pours[side]]), METAL)
    _fill_shape(axes, union_all([pad_polygon(pad) for pad in layout.pads if side in pad.sides]), SOLDERED)
    _fill_shape(axes, union_all([hole_polygon(hole) for hole in layout.holes]), "white")
    for part in layout.parts:
        if part.side == side:
            _draw_component(axes, part)
    for word in place_designators(layout, side):
        for line in word.lines:
            axes.plot(*zip(*line, strict=True), color="white", linewidth=1.2)
    for pad in layout.pads:
        if side in pad.sides and not pad.pin.startswith("LED"):
            axes.text(
                *_pad_number_position(pad.at_mm, layout), pad.land.number, ha="center", va="center", size=6, color=INK
            )


def _pad_number_position(place: PointMm, layout: BoardLayout) -> PointMm:
    """Return the position of a pad's number: a little lower where it would lie on a component's name."""
    under = any(hypot(place[0] - part.at_mm[0], place[1] - part.at_mm[1]) < NAME_MM for part in layout.parts)
    return place[0], place[1] - (NAME_MM if under else 0.0)


def _draw_component(axes: "Axes", part: PlacedComponent) -> None:
    """Draw a component's outline and name, and the poles of LEDs."""
    (x, y), body = part.to_board_frame(part.part.footprint.body_at_mm), component_outline(part)
    _fill_shape(axes, body, BODY if part.side == "top" else DARK_BODY, alpha=0.35)
    axes.plot(*body.exterior.xy, color=INK, linewidth=0.8)
    axes.text(x, y, part.reference, ha="center", va="center", size=8, color=INK, weight="bold")
    if part.reference.startswith("LED"):
        axes.text(x - 1.4, y, "+", ha="center", va="center", size=9, color=INK)
        axes.text(x + 1.4, y, "−", ha="center", va="center", size=9, color=INK)


def _fill_shape(axes: "Axes", shape: BaseGeometry, colour: str, alpha: float = 1.0) -> None:
    """Fill a shape with one colour, its holes left open."""
    from matplotlib.patches import PathPatch

    for polygon in split_polygons(shape):
        axes.add_patch(PathPatch(_polygon_path(polygon), facecolor=colour, edgecolor="none", alpha=alpha))


def _polygon_path(polygon: Polygon) -> "Path":
    """Return outer contour and holes as one path."""
    from matplotlib.path import Path

    return Path.make_compound_path(
        *(Path(np.asarray(ring.coords), closed=True) for ring in (polygon.exterior, *polygon.interiors))
    )
