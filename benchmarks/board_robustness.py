"""Whether the board is found with the defaults in altered real images, and refused where there is none.

Every sensor's real pair is altered in some forty ways; a summary line says, per kind, in how many pairs the board was found, in how
many of them with every pin that is there, the worst left-out error, and how many pins were claimed that had been taken away. With
`--every` each pair has its own line. Images without a board, and boards with too much missing, must all be refused.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np
import tyro
from altered_images import (
    Pair,
    both,
    compressed,
    fainter,
    glaring,
    invented,
    mistaken,
    quarter_turned,
    resized,
    rotated,
    tilted,
    vignetted,
    without,
)
from figures import Figure, answer, holds
from real_images import calibration_images, sensor_folders
from tqdm import tqdm

from ninedtact import SensorDesign
from ninedtact.calibration.board.board_fit import BoardFit, fit_board
from ninedtact.calibration.board.detection import BoardNotFound

BOARD = SensorDesign().pin_board
MAX_MISSING = 6
NO_BOARD, TOO_FEW = "no board", f"more than {MAX_MISSING} pins missing"
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
        return self.pins_there >= BOARD.count - MAX_MISSING


@dataclass(frozen=True)
class Outcome:
    """One pair and what came of it."""

    trial: Trial
    found: int = 0
    """Pins; 0 when refused."""
    left_out_mm: float = np.nan
    refusal: str = ""

    @property
    def in_words(self) -> str:
        return f"refused: {self.refusal}" if self.refusal else f"{self.found} pins, {self.left_out_mm:.4f} mm"


def board_robustness(every: bool = False, quick: bool = False, json: bool = False) -> None:
    """Try all, and print how many were found."""
    cv2.setNumThreads(1)
    trials = list(islice(all_trials(), 1 if quick else None))
    outcomes = [outcome(trial) for trial in tqdm(trials, unit=" pairs", disable=None)]
    figures = [Figure(f"{one.trial.kind}: {one.trial.name}", one.in_words) for one in outcomes] if every else []
    for kind in dict.fromkeys(one.trial.kind for one in outcomes):
        figures.append(summary(kind, [one for one in outcomes if one.trial.kind == kind]))
    answer("Finding the board in altered real images", figures, json)


def all_trials() -> Iterator[Trial]:
    """Yield everything that is tried, sensor by sensor."""
    for folder in sensor_folders():
        images = calibration_images(folder.name)
        pair = images.board_reference.astype(np.float32), images.board.astype(np.float32)
        plain = fit_board(images.board_reference, images.board, BOARD)
        for kind, name, altered in alterations(pair, float(np.median(plain.contrast))):
            yield Trial(kind, f"{folder.name} {name}", altered)
        yield from with_pins_missing(folder.name, pair, plain)
        for name, wrong in mistaken(*pair, (images.ball_reference, images.ball)):
            yield Trial(NO_BOARD, f"{folder.name} {name}", wrong, 0)
    for seed in range(4):
        yield from (Trial(NO_BOARD, f"{name} ({seed})", wrong, 0) for name, wrong in invented(seed))


def alterations(pair: Pair, contrast: float) -> Iterator[tuple[str, str, Pair]]:
    """Yield one sensor's pair in every way."""
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
    for strength in (1, 4, 10):
        yield "vignetted", str(strength), vignetted(pair, strength)
    for x, y, width, levels, left in GLARES:
        yield "glare or shadow at the border", f"at {x}, {y}", glaring(pair, (x, y), width, levels, left)
    yield "light changed between the images", "dimmer", both(pair[0], pair[1] * 0.9 - 4)
    slope = np.linspace(0.85, 1.1, pair[0].shape[1])[None, :, None]
    yield "light changed between the images", "unevenly", both(pair[0], pair[1] * slope)
    for factor in (0.5, 0.75, 1.5, 2):
        yield "half to double resolution", f"x{factor}", resized(pair, factor)
    for quality in (90, 60):
        yield "JPEG", f"quality {quality}", compressed(pair, quality)


def with_pins_missing(sensor: str, pair: Pair, plain: BoardFit) -> Iterator[Trial]:
    """Yield pins that did not touch, chosen at random, and a whole side."""
    for count in (1, 3, 6, 9, 12):
        chosen = np.random.default_rng(count).choice(BOARD.count, count, replace=False)
        kind = f"up to {MAX_MISSING} pins missing" if count <= MAX_MISSING else TOO_FEW
        yield Trial(kind, f"{sensor}: {count}", without(pair, plain.points_px[chosen]), BOARD.count - count)
    side = plain.nodes[:, 0] == 0
    yield Trial(TOO_FEW, f"{sensor}: a whole side", without(pair, plain.points_px[side]), int((~side).sum()))


def outcome(trial: Trial) -> Outcome:
    """Search the board with the defaults."""
    try:
        fit = fit_board(*trial.pair, BOARD)
    except BoardNotFound as refusal:
        return Outcome(trial, refusal=str(refusal))
    return Outcome(trial, int(fit.found.sum()), fit.lens_fit.leave_one_out_rms_mm)


def summary(kind: str, outcomes: Sequence[Outcome]) -> Figure:
    """Return all pairs of a kind in one line."""
    found = [one for one in outcomes if not one.refusal]
    if not outcomes[0].trial.to_be_found:
        refused = len(outcomes) - len(found)
        return holds(kind, f"{refused} of {len(outcomes)} refused", "all refused", not found)
    whole = sum(one.found >= one.trial.pins_there for one in found)
    claimed = sum(max(one.found - one.trial.pins_there, 0) for one in found)
    worst = max((one.left_out_mm for one in found), default=np.nan)
    too_many = f", {claimed} claimed that is not there" if claimed else ""
    words = f"{len(found)} of {len(outcomes)} found, {whole} with every pin, error at most {worst:.3f} mm{too_many}"
    return holds(kind, words, "all found", len(found) == len(outcomes))


if __name__ == "__main__":
    tyro.cli(board_robustness)
