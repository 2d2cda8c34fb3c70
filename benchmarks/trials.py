"""The pairs of images in which the board is looked for: real ones, altered, and images without a board."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from altered import (
    Pair,
    both,
    compressed,
    fainter,
    glaring,
    quarter_turned,
    resized,
    rotated,
    tilted,
    vignetted,
    without,
)
from no_board import invented, mistaken
from real_images import sensor_folders

from ninedtact import SensorDesign, read_image
from ninedtact.calibration.board.board_fit import BoardFit, fit_board

BOARD = SensorDesign().pin_board
MAX_MISSING_FRACTION = 6
NO_BOARD = "no board"
TOO_FEW = f"more than {MAX_MISSING_FRACTION} pins missing"
GLARES = (
    (0, 0.5, 0.1, 120, 1.0),
    (1, 0.2, 0.15, 150, 0.6),
    (0.5, 0, 0.2, 100, 0.8),
    (0, 0, 0.18, 200, 0.5),
    (1, 1, 0.15, -80, 0.7),
)
"""Column and row (parts of the image), width (half diagonals), grey levels, and the part that the press leaves."""


@dataclass(frozen=True)
class Trial:
    """One pair of images."""

    kind: str
    name: str
    pair: Pair
    pins_there: int = BOARD.count

    @property
    def to_be_found(self) -> bool:
        return self.pins_there >= BOARD.count - MAX_MISSING_FRACTION


def all_trials() -> Iterator[Trial]:
    """Everything that is tried, sensor by sensor."""
    for folder in sensor_folders():
        untouched, pressed, *ball = (
            read_image(folder / f"{name}.png") for name in ("board_reference", "board", "ball_reference", "ball")
        )
        pair = untouched.astype(np.float32), pressed.astype(np.float32)
        plain = fit_board(untouched, pressed, BOARD)
        for kind, name, altered in alterations(pair, float(np.median(plain.contrast))):
            yield Trial(kind, f"{folder.name} {name}", altered)
        yield from with_pins_missing(folder.name, pair, plain)
        for name, wrong in mistaken(*pair, (ball[0], ball[1])):
            yield Trial(NO_BOARD, f"{folder.name} {name}", wrong, 0)
    for seed in range(4):
        yield from (Trial(NO_BOARD, f"{name} ({seed})", wrong, 0) for name, wrong in invented(seed))


def alterations(pair: Pair, contrast: float) -> Iterator[tuple[str, str, Pair]]:
    """One sensor's pair in every way."""
    yield "as it is", "", both(*pair)
    for levels in (10, 6, 4):
        if levels < contrast:
            yield f"pins of {levels} grey levels", "", fainter(pair, levels / contrast)
    yield "noise of 3 grey levels", "", both(*pair, 3.0)
    for tilt in ((0.04, 0), (0, 0.06), (-0.05, 0.04)):
        yield "tilted", str(tilt), tilted(pair, *tilt)
    for degrees in (-15, -8, 8, 15):
        yield "turned up to 15°", f"{degrees}°", rotated(pair, degrees, 0.85 if abs(degrees) > 10 else 0.95)
    for turns in (1, 2, 3):
        yield "turned 90°, 180°, 270° (portrait)", f"{90 * turns}°", quarter_turned(pair, turns)
    yield from in_other_light(pair)
    for factor in (0.5, 0.75, 1.5, 2):
        yield "half to double resolution", f"x{factor}", resized(pair, factor)
    for quality in (90, 60):
        yield "JPEG", f"quality {quality}", compressed(pair, quality)


def in_other_light(pair: Pair) -> Iterator[tuple[str, str, Pair]]:
    for strength in (1, 4, 10):
        yield "vignetted", str(strength), vignetted(pair, strength)
    for x, y, width, levels, left in GLARES:
        yield "glare or shadow at the border", f"at {x}, {y}", glaring(pair, (x, y), width, levels, left)
    yield "light changed between the images", "dimmer", both(pair[0], pair[1] * 0.9 - 4)
    slope = np.linspace(0.85, 1.1, pair[0].shape[1])[None, :, None]
    yield "light changed between the images", "unevenly", both(pair[0], pair[1] * slope)


def with_pins_missing(sensor: str, pair: Pair, plain: BoardFit) -> Iterator[Trial]:
    """Pins that did not touch, chosen at random, and a whole side."""
    for count in (1, 3, 6, 9, 12):
        chosen = np.random.default_rng(count).choice(BOARD.count, count, replace=False)
        kind = f"up to {MAX_MISSING_FRACTION} pins missing" if count <= MAX_MISSING_FRACTION else TOO_FEW
        yield Trial(kind, f"{sensor}: {count}", without(pair, plain.points_px[chosen]), BOARD.count - count)
    side = plain.nodes[:, 0] == 0
    yield Trial(TOO_FEW, f"{sensor}: a whole side", without(pair, plain.points_px[side]), int((~side).sum()))
