"""Dark spots of an image, and their order as a square lattice that is seen through a lens of unknown pitch, position, tilt and
distortion.

`detect_dark_spots` finds spots of one size with their contrast. A lattice grows from a seed: each next node is sought where the
steps of its neighbours predict it, so that the step may change across the image as the lens bends it. Lattices in noise stay small;
the lattice with most contrast wins.

`CameraRotation` is the angle from the image's column axis to the sensor's x axis, in degrees, clockwise on the screen. The sensor's
x axis runs along the board's long side, so an image in which that side is upright has 90° or 270°. No board distinguishes these
two, nor 0° and 180°; "auto" takes the first.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy import ndarray as Array
from scipy import ndimage

from ninedtact.design import PinBoard
from ninedtact.shape.lens import Points
from ninedtact.shape.rectification import CameraRotation

CAMERA_ROTATIONS: dict[CameraRotation | Literal["auto"], tuple[CameraRotation, ...]] = {
    "auto": (0, 90),
    0: (0,),
    90: (90,),
    180: (180,),
    270: (270,),
}


def lattice_size(board: PinBoard, mounting: CameraRotation) -> tuple[int, int]:
    """Return (columns, rows) of the board's lattice along the image's axes."""
    return (board.cols, board.rows) if mounting in (0, 180) else (board.rows, board.cols)


def pin_positions_mm(nodes: Int[Array, "n 2"], board: PinBoard, mounting: CameraRotation) -> Points:
    """Return the positions on the skin (sensor frame) of lattice nodes (column, row along the image's axes)."""
    size = np.array(lattice_size(board, mounting))
    along_image = (nodes - (size - 1) / 2) * board.pitch_mm
    return along_image @ _rotation_matrix(mounting)


def _rotation_matrix(mounting: CameraRotation) -> Int[Array, "2 2"]:
    """Return the rotation by the mounting angle; a row vector times this goes from image axes to sensor axes."""
    cosine, sine = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1)}[mounting]
    return np.array([[cosine, -sine], [sine, cosine]])


SpotPoints = Float[Array, "n 2"]

STRONGEST = 250
"""Number of spots kept: some four times the pins of the largest usual board."""


@dataclass(frozen=True)
class DarkSpots:
    """Dark spots, strongest first."""

    points_px: SpotPoints
    strength: Float[Array, " n"]
    """Scale-normalised Laplacian at the spot, in the image's own unit."""


def detect_dark_spots(image: Float32[Array, "rows cols"], size_px: float) -> DarkSpots:
    """Return the local maxima of the scale-normalised Laplacian of Gaussian (Lindeberg 1998) at standard deviation `size_px`."""
    response = ndimage.gaussian_laplace(image, size_px, mode="nearest") * size_px**2
    neighbourhood = 2 * round(1.5 * size_px) + 1
    peaks = (response == ndimage.maximum_filter(response, size=neighbourhood)) & (response > 0)
    points, strength = np.argwhere(peaks)[:, ::-1].astype(float), response[peaks].astype(float)
    order = np.argsort(-strength)[:STRONGEST]
    return DarkSpots(points[order], strength[order])


Node = tuple[int, int]
"""(column, row) on the lattice, along image columns and image rows."""

SEEDS = 16
NEIGHBOURS = 8
REACH = 0.3
"""Largest distance of a node from its predicted position, as a fraction of a step."""
LENGTH_RATIO = 1.6
SQUARENESS = 0.35
"""Largest |cosine| of the angle between the two steps at the seed; boards that are tilted further are not sought."""


@dataclass(frozen=True)
class PinLattice:
    """Spots with their lattice nodes."""

    nodes: Int[Array, "n 2"]
    points_px: Float[Array, "n 2"]
    strength: Float[Array, " n"]

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def score(self) -> float:
        """Return the summed contrast; the square root keeps a few strong spots from outweighing many."""
        return float(np.sqrt(self.strength).sum())

    def window(self, cols: int, rows: int) -> "PinLattice":
        """Return the cols × rows part with most contrast, with its nodes counted from (0, 0)."""
        return max((self.cut(corner, cols, rows) for corner in self.corners(cols, rows)), key=lambda part: part.score)

    def cut(self, corner: Node, cols: int, rows: int) -> "PinLattice":
        """Return the part that begins at one corner."""
        nodes = self.nodes - corner
        inside = ((nodes >= 0) & (nodes < (cols, rows))).all(axis=1)
        return PinLattice(nodes[inside], self.points_px[inside], self.strength[inside])

    def corners(self, cols: int, rows: int) -> Iterator[Node]:
        """Yield every corner whose cols × rows window overlaps the lattice."""
        (left, top), (right, bottom) = self.nodes.min(axis=0), self.nodes.max(axis=0)
        for column in range(min(left, right - cols + 1), max(left, right - cols + 1) + 1):
            for row in range(min(top, bottom - rows + 1), max(top, bottom - rows + 1) + 1):
                yield column, row


def find_pin_lattices(blobs: DarkSpots, middle_px: Float[Array, "2"]) -> list[PinLattice]:
    """Return the different lattices that grow from spots around the middle."""
    grown = (_grow_lattice(blobs, *seed) for seed in _lattice_seeds(blobs, middle_px))
    return list({(len(lattice), lattice.score): lattice for lattice in grown}.values())


def _lattice_seeds(blobs: DarkSpots, middle_px: Float[Array, "2"]) -> Iterator[tuple[int, Array, Array]]:
    """Yield a spot near the middle with a step to the right and a step down that could span a square lattice."""
    nearest_first = np.argsort(np.hypot(*(blobs.points_px - middle_px).T))[:SEEDS]
    for seed in nearest_first:
        steps = blobs.points_px - blobs.points_px[seed]
        around = steps[np.argsort(np.hypot(*steps.T))[1 : NEIGHBOURS + 1]]
        right = around[around[:, 0] > np.abs(around[:, 1])]
        down = around[around[:, 1] >= np.abs(around[:, 0])]
        yield from ((int(seed), u, v) for u in right for v in down if _spans_square_lattice(u, v))


def _spans_square_lattice(u: Float[Array, "2"], v: Float[Array, "2"]) -> bool:
    """Return whether two steps are of similar length and nearly at right angles."""
    lengths = np.hypot(*u), np.hypot(*v)
    similar = max(lengths) < LENGTH_RATIO * min(lengths)
    return bool(similar and abs(u @ v) < SQUARENESS * lengths[0] * lengths[1])


def _grow_lattice(blobs: DarkSpots, seed: int, right: Float[Array, "2"], down: Float[Array, "2"]) -> PinLattice:
    """Return the lattice grown breadth first from a seed, each node where its neighbours' steps predict it."""
    taken: dict[Node, int] = {(0, 0): seed}
    steps = {(1, 0): right, (-1, 0): -right, (0, 1): down, (0, -1): -down}
    queue = deque([(0, 0)])
    while queue:
        node = queue.popleft()
        for direction, first_step in steps.items():
            target = (node[0] + direction[0], node[1] + direction[1])
            step = _expected_step(blobs, taken, node, direction, first_step)
            spot = None if target in taken else _find_spot_near(blobs, taken, blobs.points_px[taken[node]] + step, step)
            if spot is not None:
                taken[target] = spot
                queue.append(target)
    spots = list(taken.values())
    return PinLattice(np.array(list(taken)), blobs.points_px[spots], blobs.strength[spots])


def _expected_step(
    blobs: DarkSpots, taken: dict[Node, int], node: Node, direction: Node, first_step: Float[Array, "2"]
) -> Float[Array, "2"]:
    """Return the mean of the parallel steps already taken next to this one, or the seed's step."""
    around = [(node[0] + a, node[1] + b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    pairs = [(taken.get(end), taken.get((end[0] - direction[0], end[1] - direction[1]))) for end in around]
    known = [
        blobs.points_px[end] - blobs.points_px[start] for end, start in pairs if end is not None and start is not None
    ]
    return np.mean(known, axis=0) if known else first_step


def _find_spot_near(
    blobs: DarkSpots, taken: dict[Node, int], expected_px: Float[Array, "2"], step: Float[Array, "2"]
) -> int | None:
    """Return the free spot nearest to the predicted position, or None where none is near enough."""
    distance = np.hypot(*(blobs.points_px - expected_px).T)
    nearest = int(distance.argmin())
    near_enough = distance[nearest] < REACH * np.hypot(*step)
    return nearest if near_enough and nearest not in taken.values() else None
