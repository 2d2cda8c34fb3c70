"""Four images of a sensor, drawn: just enough to calibrate from."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from ninedtact.calibration.procedure import CalibrationImages

PX_PER_MM = 10.0
BARREL = 0.12
"""How much more of the skin a pixel at the end of the long side shows than one in the middle."""
ROWS, COLS = 240, 320
BALL_RADIUS_MM = 4.0


@dataclass(frozen=True)
class DrawnPresses:
    """What the images show."""

    missing: tuple[tuple[int, int], ...] = ()
    """(column, row) of pins that leave no imprint, counted from 1."""
    press_mm: float = 1.5
    grey: float = 160.0
    noise: float = 0.5

    def images(self) -> CalibrationImages:
        """Untouched, board, untouched, ball."""
        return CalibrationImages(self.seen(0, 0), self.seen(self.board, 1), self.seen(0, 2), self.seen(self.ball, 3))

    def seen(self, change: Float[Array, "rows cols"] | int, seed: int) -> UInt8[Array, "rows cols 3"]:
        """The camera's image of a relative change."""
        noise = np.random.default_rng(seed).normal(0, self.noise, (ROWS, COLS))
        grey = np.clip(np.rint(self.grey * (1 + change) + noise), 0, 255).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=2)

    @property
    def board(self) -> Float[Array, "rows cols"]:
        """Dark spots, 7 rows of 9."""
        pins = [(c, r) for r in range(1, 8) for c in range(1, 10) if (c, r) not in self.missing]
        x, y = skin_mm()
        return -0.12 * sum(np.exp(-((x - 2.5 * (c - 5)) ** 2 + (y - 2.5 * (r - 4)) ** 2) / 0.5) for c, r in pins)

    @property
    def ball(self) -> Float[Array, "rows cols"]:
        """A dark disc in a bright rim, off the middle."""
        x, y = skin_mm()
        distance = np.hypot(x - 0.5, y + 0.3)
        edge = np.sqrt(BALL_RADIUS_MM**2 - (BALL_RADIUS_MM - self.press_mm) ** 2)
        depth = np.sqrt(np.maximum(BALL_RADIUS_MM**2 - distance**2, 0)) - (BALL_RADIUS_MM - self.press_mm)
        rim = 0.08 * np.exp(-(((distance - edge - 1) / 0.6) ** 2))
        return np.where(distance < edge, -0.18 * depth, rim)


def skin_mm() -> tuple[Float[Array, "rows cols"], Float[Array, "rows cols"]]:
    """x and y of every raw pixel, through a lens that bends."""
    rows, cols = np.indices((ROWS, COLS))
    x, y = cols - (COLS - 1) / 2, rows - (ROWS - 1) / 2
    growth = 1 + BARREL * (x**2 + y**2) / (COLS / 2) ** 2
    return x * growth / PX_PER_MM, y * growth / PX_PER_MM
