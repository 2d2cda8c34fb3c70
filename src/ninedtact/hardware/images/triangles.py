"""Solids as triangles."""

import numpy as np
from build123d import Part
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.hardware.parts.stl import HEADER_BYTES, RECORD, stl

Triangles = Float[Array, "_ 3 3"]
FLAT_MM, TURN_RAD = 0.02, 0.25
"""How far triangles may stand off curved faces, and turn from one to the next: finer than an image shows."""


def triangles_of(solid: Part) -> Triangles:
    """Its surface in mm; by way of STL, since corner by corner through Python takes ten times as long."""
    return np.frombuffer(stl(solid, FLAT_MM, TURN_RAD), RECORD, offset=HEADER_BYTES)["corners"].astype(float)
