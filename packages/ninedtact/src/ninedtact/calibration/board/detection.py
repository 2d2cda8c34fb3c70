"""Detection of the pin board: dark spots of an image, their order as a square lattice that is seen through a lens of unknown
pitch, position, tilt and distortion, and the lattice that may be the board, with a first lens.

`detect_dark_spots` finds spots of one size with their contrast. A lattice grows from a seed: each next node is sought where the
steps of its neighbours predict it, so that the step may change across the image as the lens bends it. Lattices in noise stay
small. They are grown from spots of every likely size. The one with most pins, best explained by a lens, is the candidate that
`board_fit` refines. Where no board is found, `BoardNotFound` says what was detected and what to do.

`CameraRotation` is the angle from the image's column axis to the sensor's x axis, in degrees, clockwise on the screen. The
sensor's x axis runs along the board's long side, so an image in which that side is upright has 90° or 270°. No board
distinguishes these two, nor 0° and 180°; "auto" takes the first.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy import ndarray as Array
from scipy import ndimage

from ninedtact.calibration.board.lens_fit import LensFit, fit_lens_with_terms
from ninedtact.calibration.brightness_change import estimate_pixel_noise, smooth_gaussian
from ninedtact.design import PinBoard
from ninedtact.errors import CalibrationError
from ninedtact.shape.lens_and_rectification import CameraRotation, Points

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


def lattice_to_skin_mm(
    nodes: Int[Array, "n 2"], board: PinBoard, mounting: CameraRotation, mirrored: bool = False
) -> Points:
    """Return the positions on the skin (sensor frame) of lattice nodes (column, row along the image's axes).

    mirrored: whether the camera mirrors the image left to right, which is undone before the rotation.
    """
    size = np.array(lattice_size(board, mounting))
    along_image = (nodes - (size - 1) / 2) * board.pitch_mm * ((-1, 1) if mirrored else (1, 1))
    return along_image @ _rotation_matrix(mounting)


def _rotation_matrix(mounting: CameraRotation) -> Int[Array, "2 2"]:
    """Return the rotation by the mounting angle; a row vector times this goes from image axes to sensor axes."""
    cosine, sine = {0: (1, 0), 90: (0, 1), 180: (-1, 0), 270: (0, -1)}[mounting]
    return np.array([[cosine, -sine], [sine, cosine]])


SpotPoints = Float[Array, "n 2"]

_MAX_SPOTS = 250
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
    order = np.argsort(-strength)[:_MAX_SPOTS]
    return DarkSpots(points[order], strength[order])


Node = tuple[int, int]
"""(column, row) on the lattice, along image columns and image rows."""

_MAX_SEEDS = 16
_NEIGHBOUR_COUNT = 8
_MAX_PREDICTION_ERROR = 0.3
"""Largest distance of a node from its predicted position, as a fraction of a step."""
_MAX_LENGTH_RATIO = 1.6
_MAX_COSINE = 0.35
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
        corners, roots = list(self.corners(cols, rows)), np.sqrt(self.strength)
        nodes = self.nodes - np.array(corners)[:, None]
        scores = [float(roots[inside].sum()) for inside in ((nodes >= 0) & (nodes < (cols, rows))).all(axis=2)]
        return self.cut(corners[int(np.argmax(scores))], cols, rows)

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


def find_pin_lattices(dark_spots: DarkSpots, middle_px: Float[Array, "2"]) -> list[PinLattice]:
    """Return the different lattices that grow from spots around the middle."""
    grown = (_grow_lattice(dark_spots, *seed) for seed in _lattice_seeds(dark_spots, middle_px))
    return list({(len(lattice), lattice.score): lattice for lattice in grown}.values())


def _lattice_seeds(dark_spots: DarkSpots, middle_px: Float[Array, "2"]) -> Iterator[tuple[int, Array, Array]]:
    """Yield a spot near the middle with a step to the right and a step down that could span a square lattice."""
    nearest_first = np.argsort(np.hypot(*(dark_spots.points_px - middle_px).T))[:_MAX_SEEDS]
    for seed in nearest_first:
        steps = dark_spots.points_px - dark_spots.points_px[seed]
        around = steps[np.argsort(np.hypot(*steps.T))[1 : _NEIGHBOUR_COUNT + 1]]
        right = around[around[:, 0] > np.abs(around[:, 1])]
        down = around[around[:, 1] >= np.abs(around[:, 0])]
        yield from ((int(seed), u, v) for u in right for v in down if _spans_square_lattice(u, v))


def _spans_square_lattice(u: Float[Array, "2"], v: Float[Array, "2"]) -> bool:
    """Return whether two steps are of similar length and nearly at right angles."""
    lengths = np.hypot(*u), np.hypot(*v)
    similar = max(lengths) < _MAX_LENGTH_RATIO * min(lengths)
    return bool(similar and abs(u @ v) < _MAX_COSINE * lengths[0] * lengths[1])


def _grow_lattice(dark_spots: DarkSpots, seed: int, right: Float[Array, "2"], down: Float[Array, "2"]) -> PinLattice:
    """Return the lattice grown breadth first from a seed, each node where its neighbours' steps predict it."""
    places: list[_Vector] = [(x, y) for x, y in dark_spots.points_px.tolist()]
    taken: dict[Node, int] = {(0, 0): seed}
    (u, v), (s, t) = right.tolist(), down.tolist()
    steps: dict[Node, _Vector] = {(1, 0): (u, v), (-1, 0): (-u, -v), (0, 1): (s, t), (0, -1): (-s, -t)}
    queue = deque([(0, 0)])
    while queue:
        node = queue.popleft()
        for direction, first_step in steps.items():
            target = (node[0] + direction[0], node[1] + direction[1])
            if target in taken:
                continue
            step, (x, y) = _expected_step(places, taken, node, direction, first_step), places[taken[node]]
            spot = _find_spot_near(dark_spots, taken, (x + step[0], y + step[1]), step)
            if spot is not None:
                taken[target] = spot
                queue.append(target)
    spots = list(taken.values())
    return PinLattice(np.array(list(taken)), dark_spots.points_px[spots], dark_spots.strength[spots])


_Vector = tuple[float, float]
"""Two numbers: a lattice takes thousands of steps, each of which is too small for arrays."""


def _expected_step(
    places: list[_Vector], taken: dict[Node, int], node: Node, direction: Node, first_step: _Vector
) -> _Vector:
    """Return the mean of the parallel steps already taken next to this one, or the seed's step."""
    (column, row), (across, along) = node, direction
    count, x, y = 0, 0.0, 0.0
    for end_node in product((column - 1, column, column + 1), (row - 1, row, row + 1)):
        end, start = taken.get(end_node), taken.get((end_node[0] - across, end_node[1] - along))
        if end is not None and start is not None:
            count, x, y = count + 1, x + (places[end][0] - places[start][0]), y + (places[end][1] - places[start][1])
    return (x / count, y / count) if count else first_step


def _find_spot_near(dark_spots: DarkSpots, taken: dict[Node, int], expected_px: _Vector, step: _Vector) -> int | None:
    """Return the free spot nearest to the predicted position, or None where none is near enough."""
    x, y = dark_spots.points_px.T
    distance = np.hypot(x - expected_px[0], y - expected_px[1])
    nearest = int(distance.argmin())
    near_enough = distance[nearest] < _MAX_PREDICTION_ERROR * np.hypot(*step)
    return nearest if near_enough and nearest not in taken.values() else None


_SPOT_SIZES = tuple(1 / part for part in (107, 80, 160, 58, 213))
"""Spot sizes that are tried, as fractions of the image's long side, likeliest first (6, 8, 4, 11, 3 of 640 pixels)."""
_MIN_PIN_SHARE = 0.5
"""Smallest fraction of the pins that a lattice must have to be a candidate."""
_UNAMBIGUOUS_ERROR = 0.08
"""Leave-one-out error of the first lens, in pitches, below which a complete board is accepted without trying other spot sizes."""
_MAX_MEDIAN_ERROR = 0.10
"""Median leave-one-out error over the pins, in pitches, above which spots are no board: chance lattices lie near 0.2, real boards
near 0.04.
"""
_MIN_PINS_FOR_LENS = 9


@dataclass(frozen=True)
class BoardCandidate:
    """A lattice that may be the board, with a first lens."""

    lattice: PinLattice
    mounting: CameraRotation
    fit: LensFit
    mirrored: bool = False

    @property
    def median_error_mm(self) -> float:
        """Median leave-one-out error: the deviation of this lattice from a lens."""
        return float(np.median(np.hypot(*self.fit.leave_one_out_errors_mm.T)))

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key: more pins first, then the better lens."""
        return len(self.lattice), -self.median_error_mm

    def consistent_spots_px(self, board: PinBoard) -> Points:
        """Return the spots that lie where the lens fitted to all of them predicts them."""
        error_mm = np.hypot(*self.fit.leave_one_out_errors_mm.T)
        return self.lattice.points_px[error_mm < _MAX_MEDIAN_ERROR * board.pitch_mm]


def find_board_candidate(
    change: Float32[Array, "rows cols"],
    board: PinBoard,
    mounting: CameraRotation | Literal["auto"],
    mirrored: bool = False,
) -> BoardCandidate | None:
    """Return the most complete and best explained lattice over all spot sizes and orientations."""
    best: BoardCandidate | None = None
    for candidate in _generate_board_candidates(change, board, mounting, mirrored):
        best = candidate if best is None or candidate.rank > best.rank else best
        if _is_unambiguous(best, board):
            break
    return best


def is_plausible_board(candidate: BoardCandidate, board: PinBoard) -> bool:
    """Return whether the candidate is worth refining."""
    return (
        candidate.median_error_mm < _MAX_MEDIAN_ERROR * board.pitch_mm
        and len(candidate.lattice) >= _MIN_PIN_SHARE * board.count
    )


def predict_missing_pins(
    candidate: BoardCandidate, board: PinBoard, seen_px: Float[Array, "seen 2"], shape: tuple[int, ...]
) -> Float[Array, "missing 2"]:
    """Return where a candidate's lens predicts pins within the image that were not seen."""
    nearest, extent = _predict_board_px(candidate, board, shape), np.array(shape[1::-1])
    size = lattice_size(board, candidate.mounting)
    apart_px = np.hypot(*(nearest[:, None] - seen_px[None]).transpose(2, 0, 1)).min(axis=1, initial=np.inf)
    pitch_px = float(np.median(np.hypot(*np.diff(nearest.reshape(size[1], size[0], 2), axis=1).reshape(-1, 2).T)))
    return nearest[(apart_px > pitch_px / 2) & ((nearest >= 0) & (nearest < extent)).all(axis=1)]


def _predict_board_px(candidate: BoardCandidate, board: PinBoard, shape: tuple[int, ...]) -> Float[Array, "pins 2"]:
    """Return where a candidate's lens predicts all pins of the board.

    Where a whole side is missing, the lattice may continue on either side: the board whose middle is nearest to that of the image
    is taken, which is likely but not certain, so that this serves to advise and not to calibrate.
    """
    nodes, size = candidate.lattice.nodes, np.array(lattice_size(board, candidate.mounting))
    grid = np.array([(column, row) for row in range(size[1]) for column in range(size[0])])
    ranges = (range(low, high + 1) for low, high in zip(nodes.max(axis=0) - size + 1, nodes.min(axis=0), strict=True))
    boards_px = [
        candidate.fit.lens.to_px(lattice_to_skin_mm(grid + corner, board, candidate.mounting, candidate.mirrored))
        for corner in product(*ranges)
    ]
    extent = np.array(shape[1::-1])
    return min(boards_px, key=lambda px: float(np.hypot(*(px.mean(axis=0) - extent / 2))))


def _is_unambiguous(candidate: BoardCandidate, board: PinBoard) -> bool:
    """Return whether no other candidate could be better."""
    return (
        len(candidate.lattice) == board.count
        and candidate.fit.leave_one_out_rms_mm < _UNAMBIGUOUS_ERROR * board.pitch_mm
    )


def _generate_board_candidates(
    change: Float32[Array, "rows cols"], board: PinBoard, mounting: CameraRotation | Literal["auto"], mirrored: bool
) -> Iterator[BoardCandidate]:
    """Yield, at each spot size, the board-sized part of all lattices and orientations that has most contrast."""
    middle = np.array(change.shape[::-1]) / 2
    for size in _SPOT_SIZES:
        lattices = find_pin_lattices(detect_dark_spots(change, size * max(change.shape)), middle)
        parts = [(one.window(*lattice_size(board, way)), way) for one in lattices for way in CAMERA_ROTATIONS[mounting]]
        if parts:
            part, way = max(parts, key=lambda one: one[0].score)
            if len(part) >= _MIN_PINS_FOR_LENS:
                points_mm = lattice_to_skin_mm(part.nodes, board, way, mirrored)
                yield BoardCandidate(
                    part, way, fit_lens_with_terms(points_mm, part.points_px, change.shape, 1), mirrored
                )


_MIN_CONTACT_RANGE = 4.0
"""Range of a smoothed change, in standard deviations of a pixel, below which there is no contact."""


class BoardNotFound(CalibrationError):
    """The pin board is not in the image, or too little of it. Holds what was detected, for a drawing."""

    def __init__(
        self,
        sentence: str,
        found_pins: int,
        expected_pins: int,
        detected_px: Points,
        change: Float32[Array, "rows cols"],
        missing_px: Float[Array, "missing 2"] | None = None,
    ) -> None:
        super().__init__(sentence)
        self.found_pins, self.expected_pins = found_pins, expected_pins
        self.detected_px, self.change = detected_px, change
        self.missing_px = np.empty((0, 2)) if missing_px is None else missing_px
        """Where the other pins are likely; empty where too little of the board was detected."""

    def with_drawing(self, path: Path) -> "BoardNotFound":
        """Return the same error, its message with the path of a drawing of what was detected."""
        sentence = f"{self}; what was detected is drawn in {path}"
        return BoardNotFound(
            sentence, self.found_pins, self.expected_pins, self.detected_px, self.change, self.missing_px
        )


def make_board_not_found_error(
    change: Float32[Array, "rows cols"], board: PinBoard, seen_px: Points, candidate: BoardCandidate | None = None
) -> BoardNotFound:
    """Return the error with advice; swapped images are distinguished from an image without contact."""
    if np.ptp(smooth_gaussian(change, 2.0)) < _MIN_CONTACT_RANGE * estimate_pixel_noise(change):
        seen_px, advice = seen_px[:0], "nothing touched the skin: press the board while the second image is taken"
    elif _images_look_swapped(change, board, candidate):
        advice = "the images look swapped: give the image without contact as the reference"
    else:
        advice = "press harder, hold the board flatter so that all pins touch, and check that it is the design's board"
    is_plausible = candidate is not None and is_plausible_board(candidate, board)
    if candidate is not None and is_plausible and len(seen_px):
        board_px, extent = _predict_board_px(candidate, board, change.shape), np.array(change.shape[1::-1])
        beyond = int(((board_px < 0) | (board_px >= extent)).any(axis=1).sum())
        if 2 * beyond > board.count - len(seen_px) > 0:
            advice = (
                f"{beyond} pins lie beyond the border of the image: this mode of the camera cuts the picture; choose one that "
                "shows the whole board (--size; `ninedtact doctor` lists the modes)"
            )
    words = f"expected {board.count} pins ({board.cols} x {board.rows}), found {len(seen_px)}; {advice}"
    missing_px = None
    if candidate is not None and len(seen_px) and is_plausible:
        missing_px = predict_missing_pins(candidate, board, seen_px, change.shape)
    return BoardNotFound(words, len(seen_px), board.count, seen_px, change, missing_px)


def _images_look_swapped(
    change: Float32[Array, "rows cols"], board: PinBoard, candidate: BoardCandidate | None
) -> bool:
    """Return whether a whole board stands out brighter than the reference, more than any darker one."""
    inverted = find_board_candidate(-change, board, "auto")
    if inverted is None or not _is_unambiguous(inverted, board):
        return False
    return candidate is None or bool(np.median(inverted.lattice.strength) > np.median(candidate.lattice.strength))
