"""What the original 9DTact project does with each frame, stated again from its description, with its default settings.

    raw image ─gather all pixels by index, crop, grey─▶ difference ─blur, look up, blur, blur─▶ height ─▶ points

It is the peer of `frame_speed.py`. Nothing here is made slower than it has to be: arrays that the original prepares once
are prepared once, its cloud is one array that every frame overwrites, and drawing (Open3D, windows) is left out. It has
no normals; instead it takes the height's gradient, by which its window shades the points.

Run by itself it is timed alone, also in the environment that the original's own requirements name (docs/figures.md).
"""

from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from real_images import sensor_folder

CROP_ROWS, CROP_COLS = 345, 460
THRESHOLD = 2
"""Grey levels that count as light drifting."""
WRAPPED = 100
"""uint8 differences from here on are brightenings that wrapped around."""
BLUR = (7, 7)
CANVAS_MM = 21.0, 28.0
"""The crop is put on an empty canvas of this size (y, x) before it becomes points."""


class Original:
    """One calibrated sensor of the original project, with this session's untouched image."""

    def __init__(self, folder: Path, untouched: np.ndarray) -> None:
        self.row_index, self.col_index, position_scale = (
            np.load(folder / "camera_calibration" / f"{name}.npy")
            for name in ("row_index", "col_index", "position_scale")
        )
        self.depth_list = np.load(folder / "depth_calibration" / "Pixel_to_Depth.npy")
        top, left = int(position_scale[0] - CROP_ROWS / 2), int(position_scale[1] - CROP_COLS / 2)
        self.crop = np.s_[top : top + CROP_ROWS, left : left + CROP_COLS]
        self.reference = self.grey(untouched)
        self.points_mm = self.flat_points(position_scale[2])

    def flat_points(self, mm_per_px: float) -> np.ndarray:
        """The canvas as points (n, 3), and where on it the crop lies."""
        rows, cols = (int(side / mm_per_px) + 2 for side in CANVAS_MM)
        top, left = (rows - CROP_ROWS) // 2, (cols - CROP_COLS) // 2
        self.canvas_shape, self.on_canvas = (rows, cols), np.s_[top : top + CROP_ROWS, left : left + CROP_COLS]
        x, y = np.meshgrid(np.arange(cols) * mm_per_px, -np.arange(rows) * mm_per_px)
        return np.column_stack([x.ravel(), y.ravel(), np.zeros(rows * cols)])

    def rectified(self, raw: np.ndarray) -> np.ndarray:
        """The whole colour image, pixel by pixel from where the index maps say."""
        return raw[self.row_index, self.col_index]

    def grey(self, raw: np.ndarray) -> np.ndarray:
        return cv2.cvtColor(self.rectified(raw)[self.crop], cv2.COLOR_BGR2GRAY)

    def height(self, raw: np.ndarray) -> np.ndarray:
        """Depth in mm, pressed in counting as positive."""
        darker = self.reference - self.grey(raw) - THRESHOLD
        level = darker * (darker < WRAPPED) + THRESHOLD
        level[level > len(self.depth_list) - 1] = len(self.depth_list) - 1
        level = cv2.GaussianBlur(level.astype(np.float32), BLUR, 0).astype(int)
        depth = self.depth_list[level] - self.depth_list[THRESHOLD]
        for _ in range(2):
            depth = cv2.GaussianBlur(depth.astype(np.float32), BLUR, 0)
        return depth

    def points(self, raw: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
        """The cloud (n, 3) and the gradient of the height along rows and columns."""
        canvas = np.zeros(self.canvas_shape)
        canvas[self.on_canvas] = self.height(raw)
        gradient = np.gradient(canvas)
        self.points_mm[:, 2] = canvas.ravel()
        return self.points_mm, list(gradient)


def timed_alone(rounds: int = 300) -> None:
    """Print the least and the median time of each stage."""
    cv2.setNumThreads(1)
    folder = sensor_folder("sensor_a")
    untouched, pressed = (cv2.imread(str(folder / f"{name}.png")) for name in ("ball_reference", "ball"))
    original = Original(folder / "upstream_layout" / "sensor_1", untouched)
    print(f"NumPy {np.__version__}, OpenCV {cv2.__version__}")
    for stage in (original.rectified, original.height, original.points):
        took_ms = np.array([milliseconds(stage, pressed) for _ in range(rounds)])
        print(f"{stage.__name__:10s} least {took_ms.min():6.2f} ms, median {np.median(took_ms):6.2f} ms")


def milliseconds(stage, image: np.ndarray) -> float:
    start = perf_counter()
    stage(image)
    return (perf_counter() - start) * 1e3


if __name__ == "__main__":
    timed_alone()
