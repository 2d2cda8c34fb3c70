"""Files of single parts: solids as STEP, as watertight binary STL and as triangles; flat parts as DXF for the laser cutter, closed
outlines at 1:1, each line once, holes on a layer of their own. Lengths in mm.
"""

from collections.abc import Sequence
from datetime import UTC, datetime
from io import BytesIO, StringIO
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from build123d import Axis, Compound, Edge, GeomType, Part, Solid, Vector, Wire, export_step
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.design import DesignImpossible
from ninedtact_hardware.design import XY
from ninedtact_hardware.sensor_assembly import BuiltPart

STL_HEADER_BYTES = 84
"""A title of 80 bytes, then the number of triangles."""
STL_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
"""One triangle of a binary STL file."""
CORNER_DECIMALS = 5
"""Corners are rounded to 10⁻⁵ mm: faces that meet agree on their corners only to about 10⁻¹⁵."""


def _solid_to_stl(solid: Part, flat_mm: float, turn_rad: float) -> bytes:
    """Return a watertight binary STL in which every edge is shared by exactly two triangles.

    flat_mm, turn_rad: greatest distance of a triangle from a curved face, and greatest angle between neighbouring triangles. The
    modelling library's own `export_stl` is not used because it takes flat_mm for a share of each edge's length.
    """
    from OCP.BRepMesh import BRepMesh_IncrementalMesh  # type: ignore[import-untyped]
    from OCP.StlAPI import StlAPI_Writer  # type: ignore[import-untyped]

    BRepMesh_IncrementalMesh(solid.wrapped, flat_mm, False, turn_rad, False).Perform()
    writer = StlAPI_Writer()
    writer.ASCIIMode = False
    with TemporaryDirectory() as folder:
        path = Path(folder) / "part.stl"
        writer.Write(solid.wrapped, str(path))
        file = path.read_bytes()
    triangles = np.frombuffer(file, STL_RECORD, offset=STL_HEADER_BYTES).copy()
    triangles["corners"] = corners = triangles["corners"].astype(float).round(CORNER_DECIMALS) + 0.0
    # Coincident corners are equal now, which leaves some triangles no area.
    degenerate = (corners == np.roll(corners, 1, axis=1)).all(axis=2).any(axis=1)
    kept = triangles[~degenerate]
    return file[: STL_HEADER_BYTES - 4] + np.array(len(kept), "<u4").tobytes() + kept.tobytes()


Triangles = Float[Array, "_ 3 3"]
IMAGE_DEVIATION_MM, IMAGE_ANGLE_RAD = 0.02, 0.25
"""Tolerances of triangles for images: finer than an image shows."""


def triangulate_solid(solid: Part) -> Triangles:
    """Return the surface of a solid as triangles in mm. It goes by way of STL, since corner by corner through Python
    takes ten times as long."""
    return np.frombuffer(
        _solid_to_stl(solid, IMAGE_DEVIATION_MM, IMAGE_ANGLE_RAD), STL_RECORD, offset=STL_HEADER_BYTES
    )["corners"].astype(float)


STEP_TIMESTAMP = datetime(2023, 8, 28, tzinfo=UTC)
"""Date of every STEP file: the same design gives the same bytes."""
PRINT_DEVIATION_MM, PRINT_ANGLE_RAD = 0.01, 0.3
"""Tolerances of triangles for printing: a tenth of what a printer resolves."""


def part_to_step(name: str, solid: Part) -> bytes:
    """Return a part as a STEP file, exact and in mm."""
    return _shape_to_step(_label_solid(name, solid))


def assembly_to_step(bodies: Sequence[BuiltPart]) -> bytes:
    """Return all bodies in position as one STEP file, each under its name."""
    return _shape_to_step(Compound(label="sensor", children=[_label_solid(body.name, body.solid) for body in bodies]))


def _label_solid(name: str, solid: Part) -> Solid:
    (alone,) = solid.solids()
    named = Solid(alone.wrapped)
    named.label = name
    return named


def _shape_to_step(shape: Compound | Solid) -> bytes:
    buffer = BytesIO()
    export_step(shape, buffer, timestamp=STEP_TIMESTAMP)
    return buffer.getvalue()


def part_to_stl(solid: Part) -> bytes:
    """Return a part as a binary STL file for printing."""
    return _solid_to_stl(solid, PRINT_DEVIATION_MM, PRINT_ANGLE_RAD)


MILLIMETRES = 4
"""Value of $INSUNITS for millimetres."""
OUTSIDE_LAYER, INSIDE_LAYER = "outside", "inside"
"""Layers: holes are cut first, or the plate falls out before them."""
SAME_POINT_MM = 1e-4
"""Distance below which two ends are the same point."""


def part_to_dxf(part: Part) -> bytes:
    """Return a flat part as DXF R2010: the outer outline, then every hole.

    The kerf is not compensated, because it depends on the laser of the shop. Raises `DesignImpossible`.
    """
    from ezdxf import options  # type: ignore[attr-defined]  # public by its documentation
    from ezdxf.filemanagement import new

    # These replace today's date and a new identifier, so that the same design gives the same file.
    options.write_fixed_meta_data_for_testing = True
    drawing = new("R2010", units=MILLIMETRES)
    top = part.faces().filter_by(Axis.Z).sort_by(Axis.Z)[-1]
    holes = sorted(top.inner_wires(), key=lambda wire: _round_point(wire.center()))
    drawing.layers.add(OUTSIDE_LAYER, color=7)
    _add_outline(drawing.modelspace(), top.outer_wire(), OUTSIDE_LAYER)
    if holes:
        drawing.layers.add(INSIDE_LAYER, color=1)
    for hole in holes:
        _add_outline(drawing.modelspace(), hole, INSIDE_LAYER)
    # ezdxf would list them in the order of a set, which differs between processes.
    for kind in sorted(drawing.entitydb.dxf_types_in_use()):
        drawing.classes.add_class(kind)
    text = StringIO()
    drawing.write(text)
    return text.getvalue().encode()


def _add_outline(space: Any, wire: Wire, layer: str) -> None:
    edges = [*wire.order_edges()]
    if len(edges) == 1 and edges[0].geom_type == GeomType.CIRCLE:
        centre = edges[0].arc_center
        space.add_circle((centre.X, centre.Y), edges[0].radius, dxfattribs={"layer": layer})
    else:
        space.add_lwpolyline(_polyline_corners(edges), format="xyb", close=True, dxfattribs={"layer": layer})


def _polyline_corners(edges: Sequence[Edge]) -> list[tuple[float, float, float]]:
    """Return x, y and bulge of every corner of a closed outline; raises `DesignImpossible`.

    The modelling library may begin anywhere: here the lowest corner is first, and its lower neighbour is next.
    """
    for edge, following in pairwise([*edges, edges[0]]):
        if (edge @ 1 - following @ 0).length > SAME_POINT_MM:
            raise DesignImpossible(
                expected=f"an outline that continues at {edge @ 1}", got="a gap", remedy="report this part"
            )
    corners, bulges = [edge @ 0 for edge in edges], [_bulge_of_edge(edge) for edge in edges]
    first = min(range(len(corners)), key=lambda number: _round_point(corners[number]))
    corners, bulges = corners[first:] + corners[:first], bulges[first:] + bulges[:first]
    if _round_point(corners[-1]) < _round_point(corners[1]):
        corners, bulges = [corners[0], *corners[:0:-1]], [0.0 - bulge for bulge in reversed(bulges)]
    return [(corner.X, corner.Y, bulge) for corner, bulge in zip(corners, bulges, strict=True)]


def _bulge_of_edge(edge: Edge) -> float:
    """Return the tangent of a quarter of an arc, positive for left turns; 0 for a line; raises `DesignImpossible` for others."""
    from ezdxf.math import bulge_3_points

    if edge.geom_type == GeomType.LINE:
        return 0.0
    if edge.geom_type == GeomType.CIRCLE:
        start, end, middle = ((place.X, place.Y) for place in (edge @ 0, edge @ 1, edge @ 0.5))
        return bulge_3_points(start, end, middle)
    raise DesignImpossible(
        expected="lines and arcs to cut along", got=f"{edge.geom_type}", remedy="cut this part another way"
    )


def _round_point(place: Vector) -> XY:
    return round(place.X, 4) + 0.0, round(place.Y, 4) + 0.0
