"""DXF for the laser: closed outlines in mm, 1:1, each line once, holes on a layer of their own."""

from io import StringIO
from typing import Any

from build123d import Part

from ninedtact.hardware.export.outline import Circle, Loop, outlines

MILLIMETRES = 4
"""$INSUNITS."""
OUTSIDE, INSIDE = "outside", "inside"
"""Layers: holes are cut first, or the plate falls out before them."""


def dxf(part: Part) -> bytes:
    """A flat part as DXF R2010; the kerf is not taken off: the cutter knows its laser."""
    from ezdxf._options import options
    from ezdxf.filemanagement import new

    # Instead of today's date and a new identity: the same design gives the same file.
    options.write_fixed_meta_data_for_testing = True
    drawing = new("R2010", units=MILLIMETRES)
    for number, outline in enumerate(outlines(part)):
        layer = INSIDE if number else OUTSIDE
        if layer not in drawing.layers:
            drawing.layers.add(layer, color=1 if number else 7)
        add(drawing.modelspace(), outline, layer)
    # ezdxf would list them in the order of a set, another one in every process.
    for kind in sorted(drawing.entitydb.dxf_types_in_use()):
        drawing.classes.add_class(kind)
    text = StringIO()
    drawing.write(text)
    return text.getvalue().encode()


def add(space: Any, outline: Circle | Loop, layer: str) -> None:
    """One outline as one entity."""
    if isinstance(outline, Circle):
        space.add_circle(outline.centre, outline.radius_mm, dxfattribs={"layer": layer})
        return
    points = [(x, y, bulge) for (x, y), bulge in zip(outline.corners, outline.bulges, strict=True)]
    space.add_lwpolyline(points, format="xyb", close=True, dxfattribs={"layer": layer})
