"""How the camera is turned against the sensor.

`Mounting` is the angle from the image's column axis to the sensor's x axis, in degrees, clockwise on the screen. The
sensor's x axis runs along the board's long side, so an image in which that side is upright is one of 90° or 270°;
which of the two, like 0° or 180°, no board can tell: "auto" takes the first.
"""

from typing import Literal

import numpy as np
from jaxtyping import Int
from numpy import ndarray as Array

from ninedtact.design import PinBoard
from ninedtact.shape.lens import Points

Mounting = Literal[0, 90, 180, 270]

MOUNTINGS: dict[Mounting | Literal["auto"], tuple[Mounting, ...]] = {
    "auto": (0, 90),
    0: (0,),
    90: (90,),
    180: (180,),
    270: (270,),
}


def lattice_size(board: PinBoard, mounting: Mounting) -> tuple[int, int]:
    """(columns, rows) of the board's lattice along the image's axes."""
    return (board.cols, board.rows) if mounting in (0, 180) else (board.rows, board.cols)


def skin_points_mm(nodes: Int[Array, "n 2"], board: PinBoard, mounting: Mounting) -> Points:
    """Where lattice nodes (column, row along the image's axes) lie on the skin, sensor frame."""
    size = np.array(lattice_size(board, mounting))
    along_image = (nodes - (size - 1) / 2) * board.pitch_mm
    return along_image @ turn(mounting)


def turn(mounting: Mounting) -> Int[Array, "2 2"]:
    """Rotation by the mounting angle; a row vector times this goes from image axes to sensor axes."""
    cosine, sine = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1)}[mounting]
    return np.array([[cosine, -sine], [sine, cosine]])
