"""Letters for the silkscreen, as lines that a pen follows."""

from collections.abc import Iterator

from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.placement import Side

GRID_MM = 0.25
"""Letters are drawn on a grid of 2 x 4 such steps, 3 to the next: one mm tall."""
WIDE, TALL, NEXT = 2, 4, 3
LETTERS: dict[str, tuple[tuple[Place, ...], ...]] = {
    "0": (((0, 0), (0, 4), (2, 4), (2, 0), (0, 0)),),
    "1": (((0, 3), (1, 4), (1, 0)), ((0, 0), (2, 0))),
    "2": (((0, 4), (2, 4), (2, 2), (0, 2), (0, 0), (2, 0)),),
    "3": (((0, 4), (2, 4), (2, 0), (0, 0)), ((0, 2), (2, 2))),
    "4": (((0, 4), (0, 2), (2, 2)), ((2, 4), (2, 0))),
    "5": (((2, 4), (0, 4), (0, 2), (2, 2), (2, 0), (0, 0)),),
    "6": (((2, 4), (0, 4), (0, 0), (2, 0), (2, 2), (0, 2)),),
    "7": (((0, 4), (2, 4), (1, 0)),),
    "8": (((0, 0), (0, 4), (2, 4), (2, 0), (0, 0)), ((0, 2), (2, 2))),
    "9": (((2, 2), (0, 2), (0, 4), (2, 4), (2, 0), (0, 0)),),
    "B": (((0, 0), (0, 4), (1.5, 4), (2, 3), (1.5, 2), (2, 1), (1.5, 0), (0, 0)), ((0, 2), (1.5, 2))),
    "C": (((2, 4), (0, 4), (0, 0), (2, 0)),),
    "D": (((0, 0), (0, 4), (1.3, 4), (2, 3), (2, 1), (1.3, 0), (0, 0)),),
    "E": (((2, 4), (0, 4), (0, 0), (2, 0)), ((0, 2), (1.5, 2))),
    "L": (((0, 4), (0, 0), (2, 0)),),
    "R": (((0, 0), (0, 4), (2, 4), (2, 2), (0, 2)), ((1, 2), (2, 0))),
    "S": (((2, 3.5), (1.5, 4), (0, 4), (0, 2), (2, 2), (2, 0), (0, 0), (0, 0.5)),),
    "U": (((0, 4), (0, 0), (2, 0), (2, 4)),),
}
"""What the pen follows for each letter, in steps from its lower left corner."""


def size_mm(text: str) -> Place:
    """Width and height of a word, the pen's own width left out."""
    return (NEXT * len(text) - (NEXT - WIDE)) * GRID_MM, TALL * GRID_MM


def written(text: str, middle: Place, side: Side) -> Iterator[tuple[Place, ...]]:
    """The lines of a word round its middle; below the board mirrored, so that it is read from there."""
    mirror = 1 if side == "top" else -1
    left = -size_mm(text)[0] / GRID_MM / 2
    for number, letter in enumerate(text):
        for line in LETTERS[letter]:
            yield tuple(
                (
                    round(middle[0] + mirror * (left + NEXT * number + x) * GRID_MM, 6),
                    round(middle[1] + (y - TALL / 2) * GRID_MM, 6),
                )
                for x, y in line
            )
