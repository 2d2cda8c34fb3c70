"""Solids as triangles."""

import numpy as np
from build123d import Part
from jaxtyping import Float
from numpy import ndarray as Array

Triangles = Float[Array, "_ 3 3"]
FLAT_MM, TURN_RAD = 0.02, 0.25
"""How far triangles may stand off curved faces, and turn from one to the next: finer than a picture shows."""


def triangles_of(solid: Part) -> Triangles:
    """Its surface in mm."""
    places, corners = solid.tessellate(FLAT_MM, TURN_RAD)
    at = np.array([(place.X, place.Y, place.Z) for place in places], float).reshape(-1, 3)
    return np.asarray(at[np.array(corners, int).reshape(-1, 3)])
