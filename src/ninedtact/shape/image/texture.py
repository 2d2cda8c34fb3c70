"""What is painted on the skin in a perspective image: colours, graph paper in millimetres, the calibrated range."""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.quantities import Coverage, HeightMap
from ninedtact.shape.image.page import EXTRAPOLATED
from ninedtact.shape.image.palette import ColourScale, colourise, rgb

FINER = 4
"""Pixels of paint per pixel of the height map, each way."""
LINE_MM = {1.0: 0.04, 5.0: 0.10}
"""Width of the graph paper's lines, for each distance between them."""
LINE_STRENGTH = 0.25
RANGE_EDGE_PX = 11


def texture(height: HeightMap, scale: ColourScale) -> UInt8[Array, "fine_rows fine_cols 3"]:
    """The paint as RGB."""
    fine = enlarged(height)
    paint = np.ascontiguousarray(colourise(fine, scale)[..., ::-1])
    lines = graph_paper(fine) & fine.in_view
    paint[lines] = lined(paint[lines])
    paint[range_edge(fine)] = rgb(EXTRAPOLATED)
    return paint


def enlarged(height: HeightMap) -> HeightMap:
    """The same map on a finer grid."""
    seen, measured = (enlarged_mask(height.coverage >= kind) for kind in (Coverage.EXTRAPOLATED, Coverage.MEASURED))
    z_mm = cv2.resize(np.where(height.in_view, height.z_mm, np.float32(0)), None, fx=FINER, fy=FINER)
    return HeightMap(z_mm, seen.astype(np.uint8) + (seen & measured), height.mm_per_px / FINER, height.noise_mm)


def enlarged_mask(mask: Bool[Array, "rows cols"]) -> Bool[Array, "fine_rows fine_cols"]:
    """A mask on a finer grid, its edge smoothed."""
    share = cv2.resize(mask.astype(np.float32), None, fx=FINER, fy=FINER, interpolation=cv2.INTER_LINEAR)
    return np.asarray(share > 0.5)


def graph_paper(height: HeightMap) -> Bool[Array, "rows cols"]:
    """Where the lines of the graph paper run."""
    x, y = height.axes_mm
    paper = np.zeros(height.z_mm.shape, bool)
    for distance_mm, width_mm in LINE_MM.items():
        paper |= on_line(y, distance_mm, width_mm)[:, None] | on_line(x, distance_mm, width_mm)
    return paper


def on_line(axis_mm: Float32[Array, " n"], distance_mm: float, width_mm: float) -> Bool[Array, " n"]:
    """Which coordinates lie within a line's width of a multiple of the distance."""
    return np.asarray(np.abs(axis_mm - distance_mm * np.rint(axis_mm / distance_mm)) < width_mm / 2)


def lined(paint: UInt8[Array, "n 3"]) -> UInt8[Array, "n 3"]:
    """Paint under a line: towards black where it is bright, towards white where it is dark."""
    ink = np.where(paint.mean(axis=1, keepdims=True) > 110, 0, 255)
    return np.asarray(paint * (1 - LINE_STRENGTH) + ink * LINE_STRENGTH, np.uint8)


def range_edge(height: HeightMap) -> Bool[Array, "rows cols"]:
    """The extrapolated side of the edge of the calibrated range."""
    measured = (height.coverage == Coverage.MEASURED).astype(np.uint8)
    touching = cv2.dilate(measured, np.ones((RANGE_EDGE_PX, RANGE_EDGE_PX), np.uint8)).astype(bool)
    return np.asarray(touching & (height.coverage == Coverage.EXTRAPOLATED))
