"""Board and ball explained by one twin: each in turn with what the other told.

The ball's image tells light and gel, through a lens; the board's image, drawn in that light, tells how deep its imprints are
and from how near they are seen, and so the lens; the ball is fitted again through it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from ninedtact.calibration.ball.contact_circle import BallRefused
from ninedtact.calibration.ball.fit import BallFit
from ninedtact.calibration.board.fit import BoardFit
from ninedtact.calibration.board_press.fit import START, BoardPressFit, fit_board_press, with_lens
from ninedtact.calibration.board_press.observed import ObservedBoard
from ninedtact.calibration.brightness import Image
from ninedtact.calibration.twin.fit import Belief
from ninedtact.calibration.twin.parameters import Vector
from ninedtact.quantities import Frame
from ninedtact.shape.rectification import Rectification

TURNS = 2
"""The first begins with a light that a wrong lens and nearness told; the second mends what followed from that."""

LensOnGrid = Callable[[BoardFit], Rectification]
FitOfBall = Callable[[Rectification, tuple[Belief, ...], Vector | None], BallFit]


@dataclass(frozen=True)
class Together:
    """Board, lens and ball as they explain each other."""

    board: BoardFit
    rectify: Rectification
    ball: BallFit
    told: BoardPressFit | None = None
    """By the board's image; None where no physics was fitted to the ball's."""

    def next(self, images: tuple[Image, Image], lens_on_grid: LensOnGrid, fit_of_ball: FitOfBall) -> "Together":
        """After one more turn; where the board is not as the twin draws it, the same, and what it told beside it."""
        if self.ball.physical is None:
            return self
        fit, before, after = self.ball.physical.fit, *(self.rectify(Frame(image)) for image in images)
        observed = ObservedBoard(before, after, self.board)
        told = fit_board_press(observed, fit, START if self.told is None else self.told.press)
        if not told.believed:
            return replace(self, told=self.told or told)
        board = with_lens(observed, fit, told)
        rectify = lens_on_grid(board)
        return Together(board, rectify, fit_of_ball(rectify, told.beliefs, fit.vector), told)


def in_turns(
    first: Together, images: tuple[Image, Image], lens_on_grid: LensOnGrid, fit_of_ball: FitOfBall
) -> Together:
    """From board and ball each for itself. images: raw, before and under the board."""
    found = first
    for _ in range(TURNS):
        try:
            found = found.next(images, lens_on_grid, fit_of_ball)
        except BallRefused:
            return found
        if found.told is None or not found.told.believed:
            return found
    return found
