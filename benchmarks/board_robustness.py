"""Whether the board is found with the defaults in altered real images, and refused where there is none.

Every sensor's real pair is altered in some forty ways; a summary line says, per kind, in how many pairs the board was found, in how
many of them with every pin that is there, the worst left-out error, and how many pins were claimed that had been taken away.
Images without a board, and boards with too much missing, must all be refused.

Every alteration takes a pair (untouched, pressed) of float images (rows, cols, 3) and gives a pair of uint8 images.
Where light or contrast is altered, fresh noise of one real frame is added, as the altered images have lost some of theirs.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice

import cv2
import numpy as np
import tyro
from figures import Figure, answer, holds
from real_images import calibration_images, sensor_folders
from tqdm import tqdm

from ninedtact import SensorDesign
from ninedtact.calibration.board.board_fit import BoardFit, fit_board
from ninedtact.calibration.board.detection import BoardNotFound

Pair = tuple[np.ndarray, np.ndarray]

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
FRAME_NOISE = 0.6
"""Grey levels of one pixel of one frame."""
SHAPE = 480, 640, 3
GREY = 160.0


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


def board_robustness(quick: bool = False, json: bool = False) -> None:
    """Try all, and print how many were found."""
    cv2.setNumThreads(1)
    trials = list(islice(all_trials(), 1 if quick else None))
    outcomes = [outcome(trial) for trial in tqdm(trials, unit=" pairs", disable=None)]
    kinds = dict.fromkeys(one.trial.kind for one in outcomes)
    figures = [summary(kind, [one for one in outcomes if one.trial.kind == kind]) for kind in kinds]
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


def quantised(image: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """Return an image as the camera gives it: noise, then 8 bits."""
    noisy = image + np.random.default_rng(seed).normal(0, noise, image.shape) if noise else image
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def both(untouched: np.ndarray, pressed: np.ndarray, noise: float = 0.0) -> Pair:
    return quantised(untouched, noise, 1), quantised(pressed, noise, 2)


def fainter(pair: Pair, part: float) -> Pair:
    """Return the press with a part of its contrast; its noise is smoothed away before, so that it is not scaled."""
    untouched, pressed = pair
    change = cv2.GaussianBlur(pressed - untouched, (0, 0), 1)
    return both(untouched, untouched + part * change, FRAME_NOISE)


def seen_through(pair: Pair, homography: np.ndarray) -> Pair:
    """Return the images moved by a homography, their edges repeated outside."""
    size, how = pair[0].shape[1::-1], {"flags": cv2.INTER_CUBIC, "borderMode": cv2.BORDER_REPLICATE}
    untouched, pressed = (cv2.warpPerspective(image, homography, size, **how) for image in pair)
    return both(untouched, pressed)


def rotated(pair: Pair, degrees: float, scale: float) -> Pair:
    """Return the images turned about the middle; a little smaller, so that the board's corners stay in view."""
    rows, cols = pair[0].shape[:2]
    return seen_through(pair, np.vstack([cv2.getRotationMatrix2D((cols / 2, rows / 2), degrees, scale), [0, 0, 1]]))


def tilted(pair: Pair, along_x: float, along_y: float) -> Pair:
    """Return tilted images: the scale changes by these parts from the middle to 100 pixels right of it, and below it."""
    rows, cols = pair[0].shape[:2]
    to_middle = np.array([[1, 0, -cols / 2], [0, 1, -rows / 2], [0, 0, 1]])
    tilt = np.array([[1, 0, 0], [0, 1, 0], [along_x / 100, along_y / 100, 1]])
    return seen_through(pair, np.linalg.inv(to_middle) @ tilt @ to_middle)


def quarter_turned(pair: Pair, turns: int) -> Pair:
    untouched, pressed = (np.ascontiguousarray(np.rot90(image, turns)) for image in pair)
    return both(untouched, pressed)


def vignetted(pair: Pair, strength: float) -> Pair:
    """Return images darker towards the corners: brightness divided by 1 + strength · (r / half the diagonal)⁴."""
    shade = 1 / (1 + strength * (distance(pair[0].shape, (0.5, 0.5)) ** 4))[..., None]
    return both(pair[0] * shade, pair[1] * shade, FRAME_NOISE)


def glaring(pair: Pair, at: tuple[float, float], width: float, levels: float, left: float) -> Pair:
    """Return images with a spot of stray light, of which the press leaves a part; place and width as parts of the image."""
    spot = levels * np.exp(-0.5 * (distance(pair[0].shape, at) / width) ** 2)[..., None]
    return both(pair[0] + spot, pair[1] + left * spot, FRAME_NOISE)


def resized(pair: Pair, factor: float) -> Pair:
    how = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    untouched, pressed = (cv2.resize(image, None, fx=factor, fy=factor, interpolation=how) for image in pair)
    return both(untouched, pressed)


def compressed(pair: Pair, quality: int) -> Pair:
    """Return the images after JPEG."""
    files = [cv2.imencode(".jpg", quantised(image), [cv2.IMWRITE_JPEG_QUALITY, quality])[1] for image in pair]
    untouched, pressed = (cv2.imdecode(file, cv2.IMREAD_COLOR) for file in files)
    return untouched, pressed


def without(pair: Pair, points_px: np.ndarray, radius_px: float = 28) -> Pair:
    """Return the press undone around these points, softly."""
    mask = np.zeros(pair[0].shape[:2], np.float32)
    for x, y in points_px:
        cv2.circle(mask, (round(x), round(y)), round(radius_px), 1.0, -1)
    mask = cv2.GaussianBlur(mask, (0, 0), 3)[..., None]
    return both(pair[0], pair[1] * (1 - mask) + pair[0] * mask, FRAME_NOISE)


def distance(shape: tuple[int, ...], at: tuple[float, float]) -> np.ndarray:
    """Return the distance from a place given in parts of the image, in half diagonals."""
    y, x = np.indices(shape[:2])
    return np.hypot(x - at[0] * shape[1], y - at[1] * shape[0]) / (np.hypot(*shape[:2]) / 2)


def mistaken(untouched: np.ndarray, pressed: np.ndarray, ball: Pair) -> Iterator[tuple[str, Pair]]:
    """Yield what a person presses by mistake in place of the board."""
    yield "untouched twice", both(untouched, untouched, FRAME_NOISE)
    yield "a ball", ball
    yield "images swapped", (quantised(pressed), quantised(untouched))


def invented(seed: int) -> Iterator[tuple[str, Pair]]:
    """Yield images of no sensor, of which some look regular."""
    even, rng = np.full(SHAPE, GREY), np.random.default_rng(seed)
    yield "noise", both(even + grains(1, seed), even + grains(1, seed + 100))
    yield "coarse noise", both(even, even + grains(6, seed))
    texture = np.sum([grains(2.0**number, seed + number) for number in range(7)], axis=0)
    yield "random texture", both(even, even + texture)
    yield "dots at random", both(even, even - 20 * dots(rng.uniform((20, 20), (620, 460), (70, 2))), FRAME_NOISE)
    rows, step_px = np.arange(10)[:, None], 48
    x = 40 + step_px * (np.arange(12) + 0.5 * (rows % 2))
    y = 40 + step_px * np.sqrt(0.75) * rows + 0 * x
    honeycomb = np.column_stack([x.ravel(), y.ravel()])
    yield "dots in a honeycomb", both(even, even - 20 * dots(honeycomb), FRAME_NOISE)


def grains(sigma_px: float, seed: int, levels: float = 10) -> np.ndarray:
    """Return noise of one grain size, standard deviation in grey levels."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=SHAPE[:2]), (0, 0), sigma_px)
    return (levels * noise / noise.std())[..., None]


def dots(points_px: np.ndarray, radius_px: float = 8) -> np.ndarray:
    """Return one round soft dot at each place."""
    y, x = np.indices(SHAPE[:2])
    image = np.zeros(SHAPE[:2])
    for column, row in points_px:
        image = np.maximum(image, np.exp(-0.5 * ((x - column) ** 2 + (y - row) ** 2) / radius_px**2))
    return image[..., None]


if __name__ == "__main__":
    tyro.cli(board_robustness)
