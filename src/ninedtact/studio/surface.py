"""The skin as the browser draws it: points in mm in the sensor frame, coloured and lit, and triangles between them."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32, UInt8
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap
from ninedtact.shape.cloud import point_cloud
from ninedtact.shape.mesh import faces_between

FINEST_POINTS = 40_000
"""What a browser draws smoothly even without a graphics card; figures are measured on the full map, never on this."""
LIGHT = np.array([-0.5, 0.35, 0.79], np.float32)
"""Direction towards the light: grazing, from the upper left of the first view, so that shallow relief shows."""
SHADE = 0.45
"""Brightness of skin that faces away from the light; level skin keeps its colour."""


@dataclass(frozen=True)
class Surface:
    """Points on the skin, and triangles between neighbouring ones."""

    points_mm: Float32[Array, "n 3"]
    colours: UInt8[Array, "n 3"]
    """Red, green, blue: the colour of the height, lit from a side, since points have no shading of their own."""
    faces: Int32[Array, "m 3"]
    spacing_mm: float
    """Between neighbouring points on untouched skin."""


def surface_of(height: HeightMap, colours_bgr: UInt8[Array, "rows cols 3"]) -> Surface:
    """Every so-manieth point of a height map, with its colour in an image of the same size."""
    every = step_for(height)
    cloud, seen = point_cloud(height, every), height.in_view[::every, ::every]
    colours = colours_bgr[::every, ::every][seen][:, ::-1]
    return Surface(cloud.points_mm, lit(colours, cloud.normals), faces_between(seen), every * height.mm_per_px)


def step_for(height: HeightMap) -> int:
    """Each how-manieth row and column to keep."""
    return int(np.ceil(np.sqrt(height.z_mm.size / FINEST_POINTS)))


def lit(colours: UInt8[Array, "n 3"], normals: Float32[Array, "n 3"]) -> UInt8[Array, "n 3"]:
    """Colours under a light from a side."""
    towards = np.maximum(normals @ (LIGHT / LIGHT[2]), 0)
    brightness = SHADE + (1 - SHADE) * towards
    return np.clip(colours * brightness[:, None], 0, 255).astype(np.uint8)
