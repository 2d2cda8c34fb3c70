"""Whether the board is found with the defaults in altered real pictures, and refused where there is none.

Every sensor's real pair is altered in some forty ways (`altered.py`); a summary line says, per kind, in how many pairs
all pins were found, in how many at least 57 of 63 (the others predicted and named), the worst left-out error, and how
many pairs were refused. With `--every` each pair has its own line. Pictures without a board (`no_board.py`), and boards with
too much missing, must all be refused.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
import tyro
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
from figures import Figure, answer, holds
from no_board import invented, mistaken
from real_pictures import sensor_folders
from tqdm import tqdm

from ninedtact import SensorDesign, read_picture
from ninedtact.calibration.board import BoardFit, BoardNotFound, fit_board

BOARD = SensorDesign().pin_board
NO_BOARD = "no board"
TOO_FEW = "more than 6 pins missing"
GLARES = ((0, 0.5, 0.1, 120, 1.0), (1, 0.2, 0.15, 150, 0.6), (0.5, 0, 0.2, 100, 0.8), (0, 0, 0.18, 200, 0.5), (1, 1, 0.15, -80, 0.7))
"""Column and row (parts of the picture), width (half diagonals), grey levels, and the part that the press leaves."""


@dataclass(frozen=True)
class Tried:
    """One pair and what came of it."""

    kind: str
    name: str
    found: int
    """Pins; 0 when refused."""
    left_out_mm: float
    refusal: str = ""

    @property
    def in_words(self) -> str:
        return self.refusal or f"{self.found} of {BOARD.count}, left-out error {self.left_out_mm:.4f} mm"


def board_robustness(every: bool = False, json: bool = False) -> None:
    """Try all, and print how many were found."""
    cv2.setNumThreads(1)
    pairs = list(all_pairs())
    tried = [attempt(*pair) for pair in tqdm(pairs, unit=" pairs", disable=None)]
    figures = [Figure(f"{one.kind}: {one.name}", one.in_words) for one in tried] if every else []
    kinds = dict.fromkeys(one.kind for one in tried)
    figures += [summary(kind, [one for one in tried if one.kind == kind]) for kind in kinds]
    answer("Finding the board in altered real pictures", figures, json)


def attempt(kind: str, name: str, pair: Pair) -> Tried:
    """Look for the board with the defaults."""
    try:
        fit = fit_board(*pair, BOARD)
    except BoardNotFound as refusal:
        return Tried(kind, name, 0, np.nan, f"refused: {refusal}")
    return Tried(kind, name, int(fit.found.sum()), fit.lens_fit.left_out_rms_mm)


def all_pairs() -> Iterator[tuple[str, str, Pair]]:
    """Kind, name and pictures of everything that is tried."""
    for folder in sensor_folders():
        untouched, pressed, *ball = (
            read_picture(folder / f"{name}.png") for name in ("board_reference", "board", "ball_reference", "ball")
        )
        pair = untouched.astype(np.float32), pressed.astype(np.float32)
        for kind, name, altered in alterations(pair, fit_board(untouched, pressed, BOARD)):
            yield kind, f"{folder.name} {name}", altered
        for name, wrong in mistaken(*pair, (ball[0], ball[1])):
            yield NO_BOARD, f"{folder.name} {name}", wrong
    for seed in range(4):
        yield from ((NO_BOARD, f"{name} ({seed})", wrong) for name, wrong in invented(seed))


def alterations(pair: Pair, plain: BoardFit) -> Iterator[tuple[str, str, Pair]]:
    """One sensor's pair in every way."""
    yield "as it is", "", both(*pair)
    contrast = float(np.median(plain.contrast))
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
    yield from with_pins_missing(pair, plain)


def in_other_light(pair: Pair) -> Iterator[tuple[str, str, Pair]]:
    for strength in (1, 4, 10):
        yield "vignetted", str(strength), vignetted(pair, strength)
    for x, y, width, levels, left in GLARES:
        yield "glare or shadow at the border", f"at {x}, {y}", glaring(pair, (x, y), width, levels, left)
    yield "light changed between the pictures", "dimmer", both(pair[0], pair[1] * 0.9 - 4)
    slope = np.linspace(0.85, 1.1, pair[0].shape[1])[None, :, None]
    yield "light changed between the pictures", "unevenly", both(pair[0], pair[1] * slope)


def with_pins_missing(pair: Pair, plain: BoardFit) -> Iterator[tuple[str, str, Pair]]:
    """Pins that did not touch, chosen at random, and a whole side."""
    for count in (1, 3, 6, 9, 12):
        chosen = np.random.default_rng(count).choice(BOARD.count, count, replace=False)
        kind = f"{count} pins missing" if count <= 6 else TOO_FEW
        yield kind, str(count), without(pair, plain.points_px[chosen])
    yield TOO_FEW, "a whole side", without(pair, plain.points_px[plain.nodes[:, 0] == 0])


def summary(kind: str, tried: Iterable[Tried]) -> Figure:
    """All pairs of a kind in one line."""
    refused = [one for one in tried if one.refusal]
    found = [one for one in tried if not one.refusal]
    if kind in (NO_BOARD, TOO_FEW):
        return holds(kind, f"{len(refused)} of {len(refused) + len(found)} refused", "all refused", not found)
    whole = sum(one.found == BOARD.count for one in found)
    worst = max((one.left_out_mm for one in found), default=np.nan)
    words = f"{len(found)} of {len(found) + len(refused)} found, {whole} with all pins, worst left-out error {worst:.3f} mm"
    return holds(kind, words, "all found", not refused)


if __name__ == "__main__":
    tyro.cli(board_robustness)
