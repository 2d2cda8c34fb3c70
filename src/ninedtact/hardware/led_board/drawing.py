"""Layers as what a plotter draws: flashes, strokes and areas."""

from dataclasses import dataclass
from typing import Literal

from shapely import Polygon, affinity
from shapely.geometry.base import BaseGeometry

from ninedtact.hardware.led_board.copper import pad_polygon, polygons
from ninedtact.hardware.led_board.designators import PEN_MM, designators
from ninedtact.hardware.led_board.keyhole import without_holes
from ninedtact.hardware.led_board.layout import Layout
from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.pads import Pad
from ninedtact.hardware.led_board.placement import Side

Layer = Literal["copper", "mask", "paste", "silk"]
SILK_MM = 0.15
THERMAL_PASTE_MM = 0.55
"""Five windows of paste on the driver's thermal pad: with all of it pasted, the driver floats."""
THERMAL_WINDOWS = (0.0, 0.0), (0.7, 0.0), (0.0, 0.7), (-0.7, 0.0), (0.0, -0.7)
"""From the pad's middle: between the vias, which would drink the solder."""


@dataclass(frozen=True)
class Disc:
    """A flashed circle."""

    at_mm: Place
    diameter_mm: float


@dataclass(frozen=True)
class Block:
    """A flashed rectangle."""

    at_mm: Place
    size_mm: Place


@dataclass(frozen=True)
class Blob:
    """A flashed shape; its points are told from where it is flashed."""

    at_mm: Place
    points: tuple[Place, ...]


@dataclass(frozen=True)
class Stroke:
    """A line drawn with a round pen."""

    width_mm: float
    points: tuple[Place, ...]


@dataclass(frozen=True)
class Area:
    """A filled contour; holes are reached through cuts of no width."""

    points: tuple[Place, ...]


Shape = Disc | Block | Blob | Stroke | Area


def drawn(layout: Layout, layer: Layer, side: Side) -> tuple[Shape, ...]:
    """One layer of one side."""
    return {"copper": copper, "mask": mask, "paste": paste, "silk": silk}[layer](layout, side)


def copper(layout: Layout, side: Side) -> tuple[Shape, ...]:
    """Pour, tracks, pads, vias."""
    areas = [Area(without_holes(piece)) for piece in layout.pours[side]]
    strokes = [Stroke(track.width_mm, track.points) for track in layout.routes.tracks if track.side == side]
    flashes = [flash(pad, 0.0) for pad in layout.pads if side in pad.sides]
    return (*areas, *strokes, *flashes, *(Disc(via.at_mm, via.diameter_mm) for via in layout.routes.vias))


def mask(layout: Layout, side: Side) -> tuple[Shape, ...]:
    """Openings: all pads, a little larger; vias stay covered."""
    margin = layout.board.rules.mask_margin_mm
    return tuple(flash(pad, margin) for pad in layout.pads if side in pad.sides)


def paste(layout: Layout, side: Side) -> tuple[Shape, ...]:
    """Openings of the stencil."""
    whole = [flash(pad, 0.0) for pad in layout.pads if pad.sides == (side,) and pad.land.paste]
    split = [pad for pad in layout.pads if pad.sides == (side,) and not pad.land.paste]
    return (*whole, *(window for pad in split for window in windows(pad)))


def windows(pad: Pad) -> tuple[Block, ...]:
    """Openings for one large pad."""
    x, y = pad.at_mm
    return tuple(Block((x + dx, y + dy), (THERMAL_PASTE_MM, THERMAL_PASTE_MM)) for dx, dy in THERMAL_WINDOWS)


def silk(layout: Layout, side: Side) -> tuple[Shape, ...]:
    """A bar at each cathode and at pin 1 of the driver; the parts' names where there is room."""
    marks = [(part, part.part.footprint.mark_mm) for part in layout.parts if part.side == side]
    bars = [Stroke(SILK_MM, tuple(part.onto_board(end) for end in mark)) for part, mark in marks if mark]
    return (*bars, *(Stroke(PEN_MM, line) for word in designators(layout, side) for line in word.lines))


def flash(pad: Pad, margin_mm: float) -> Block | Blob:
    """A pad, enlarged by a margin."""
    if not pad.land.corner_mm and not pad.bites:
        return Block(pad.at_mm, (pad.size_mm[0] + 2 * margin_mm, pad.size_mm[1] + 2 * margin_mm))
    shape: BaseGeometry = pad_polygon(pad)
    (outer,) = polygons(shape.buffer(margin_mm) if margin_mm else shape)
    at_origin = affinity.translate(outer, -pad.at_mm[0], -pad.at_mm[1])
    return Blob(pad.at_mm, points_of(at_origin))


def points_of(polygon: Polygon) -> tuple[Place, ...]:
    """Its outer contour, not closed."""
    return tuple((x, y) for x, y in polygon.exterior.coords[:-1])
