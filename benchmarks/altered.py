"""Real images as another sensor, another light or another hand would have given them.

Every alteration takes a pair (untouched, pressed) of float images (rows, cols, 3) and gives a pair of uint8 images.
Where light or contrast is altered, fresh noise of one real frame is added, as the altered images have lost some of theirs.
"""

import cv2
import numpy as np

Pair = tuple[np.ndarray, np.ndarray]

FRAME_NOISE = 0.6
"""Grey levels of one pixel of one frame."""


def quantised(image: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    """As the camera gives it: noise, then 8 bits."""
    noisy = image + np.random.default_rng(seed).normal(0, noise, image.shape) if noise else image
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def both(untouched: np.ndarray, pressed: np.ndarray, noise: float = 0.0) -> Pair:
    return quantised(untouched, noise, 1), quantised(pressed, noise, 2)


def fainter(pair: Pair, part: float, noise: float = FRAME_NOISE) -> Pair:
    """The press with only a part of its contrast; what noise it had is smoothed away before, so that it is not scaled."""
    untouched, pressed = pair
    change = cv2.GaussianBlur(pressed - untouched, (0, 0), 1)
    return both(untouched, untouched + part * change, noise)


def seen_through(pair: Pair, homography: np.ndarray) -> Pair:
    """The image's plane moved by a homography, its edges repeated outside."""
    rows, cols = pair[0].shape[:2]
    warped = [
        cv2.warpPerspective(p, homography, (cols, rows), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        for p in pair
    ]
    return both(*warped)


def rotated(pair: Pair, degrees: float, scale: float) -> Pair:
    """Turned about the middle; a little smaller, so that the board's corners stay in view."""
    rows, cols = pair[0].shape[:2]
    turn = cv2.getRotationMatrix2D((cols / 2, rows / 2), degrees, scale)
    return seen_through(pair, np.vstack([turn, [0, 0, 1]]))


def tilted(pair: Pair, along_x: float, along_y: float) -> Pair:
    """Tilted: the scale changes by these parts from the middle to 100 pixels right of it, and below it."""
    rows, cols = pair[0].shape[:2]
    to_middle = np.array([[1, 0, -cols / 2], [0, 1, -rows / 2], [0, 0, 1]])
    tilt = np.array([[1, 0, 0], [0, 1, 0], [along_x / 100, along_y / 100, 1]])
    return seen_through(pair, np.linalg.inv(to_middle) @ tilt @ to_middle)


def quarter_turned(pair: Pair, turns: int) -> Pair:
    turned = [np.ascontiguousarray(np.rot90(image, turns)) for image in pair]
    return both(*turned)


def vignetted(pair: Pair, strength: float) -> Pair:
    """Darker towards the corners: brightness divided by 1 + strength · (r / half the diagonal)⁴."""
    shade = 1 / (1 + strength * (distance(pair[0].shape, (0.5, 0.5)) ** 4))[..., None]
    return both(pair[0] * shade, pair[1] * shade, FRAME_NOISE)


def glaring(pair: Pair, at: tuple[float, float], width: float, levels: float, left: float) -> Pair:
    """A spot of stray light, of which the press leaves a part; place and width as parts of the image."""
    spot = levels * np.exp(-0.5 * (distance(pair[0].shape, at) / width) ** 2)[..., None]
    return both(pair[0] + spot, pair[1] + left * spot, FRAME_NOISE)


def resized(pair: Pair, factor: float) -> Pair:
    way = cv2.INTER_AREA if factor < 1 else cv2.INTER_CUBIC
    larger = [cv2.resize(image, None, fx=factor, fy=factor, interpolation=way) for image in pair]
    return both(*larger)


def compressed(pair: Pair, quality: int) -> Pair:
    """Through JPEG and back."""
    files = [cv2.imencode(".jpg", quantised(image), [cv2.IMWRITE_JPEG_QUALITY, quality])[1] for image in pair]
    untouched, pressed = (cv2.imdecode(file, cv2.IMREAD_COLOR) for file in files)
    return untouched, pressed


def without(pair: Pair, points_px: np.ndarray, radius_px: float = 28) -> Pair:
    """The press undone around these points, softly."""
    mask = np.zeros(pair[0].shape[:2], np.float32)
    for x, y in points_px:
        cv2.circle(mask, (round(x), round(y)), round(radius_px), 1.0, -1)
    mask = cv2.GaussianBlur(mask, (0, 0), 3)[..., None]
    return both(pair[0], pair[1] * (1 - mask) + pair[0] * mask, FRAME_NOISE)


def distance(shape: tuple[int, ...], at: tuple[float, float]) -> np.ndarray:
    """From a place given in parts of the image, in half diagonals."""
    y, x = np.indices(shape[:2])
    return np.hypot(x - at[0] * shape[1], y - at[1] * shape[0]) / (np.hypot(*shape[:2]) / 2)
