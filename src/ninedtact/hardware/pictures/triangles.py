"""Solids as triangles."""

import numpy as np
from build123d import Part
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.hardware.parts.stl import stl

Triangles = Float[Array, "_ 3 3"]
FLAT_MM, TURN_RAD = 0.02, 0.25
"""How far triangles may stand off curved faces, and turn from one to the next: finer than a picture shows."""
HEADER_BYTES = 84
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
"""Of a binary STL file, once for each triangle after the header."""


def triangles_of(solid: Part) -> Triangles:
    """Its surface in mm; by way of STL, since corner by corner through Python takes ten times as long."""
    return np.frombuffer(stl(solid, FLAT_MM, TURN_RAD), RECORD, offset=HEADER_BYTES)["corners"].astype(float)
