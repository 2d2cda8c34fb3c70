"""Real images as another sensor, another light or another hand would have given them, and images without a board.

Every alteration takes a pair (untouched, pressed) of float images (rows, cols, 3) and gives a pair of uint8 images.
Where light or contrast is altered, fresh noise of one real frame is added, as the altered images have lost some of theirs.
"""

from collections.abc import Iterator

import cv2
import numpy as np

Pair = tuple[np.ndarray, np.ndarray]

FRAME_NOISE = 0.6
"""Grey levels of one pixel of one frame."""
SHAPE = 480, 640, 3
GREY = 160.0


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
