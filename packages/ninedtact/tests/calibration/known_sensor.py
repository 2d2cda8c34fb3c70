"""Images of a sensor whose lens, light and presses are known exactly: drawn from formulas, without any simulator."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy import ndarray as Array
from scipy.interpolate import RectBivariateSpline

from ninedtact.calibration.ball.ball_press import intersect_rays_with_sphere
from ninedtact.calibration.procedure import CalibrationImages
from ninedtact.design import PinBoard, SensorDesign
from ninedtact.shape.lens_and_rectification import LensModel

LENS = LensModel(
    homography=(0.059, -0.0003, 0.025, 0.0002, 0.059, 0.0005, 0.0005, -0.0008),
    centre=(0.04, -0.01),
    radial=(1.16, -1.5, 0.82),
    tangential=(-0.004, 0.003),
    raw_shape=(480, 640),
)
DARK_PER_MM = 0.17
BRIGHT = 0.1
PIN_REACH_MM = 6.5
"""Beyond it a pin changes no grey level, not even by the rounding of a number."""


@dataclass(frozen=True)
class KnownSensor:
    """A lens looking at a skin whose brightness factor is given by formulas on the skin."""

    design: SensorDesign = SensorDesign()
    lens: LensModel = LENS
    noise: float = 0.6
    contrast: float = 0.11
    seed: int = 0

    def skin_mm(self) -> Array:
        """The skin point that every raw pixel sees, (rows, cols, 2)."""
        return seen_points_mm(self.lens)

    def light(self) -> Array:
        """Grey level of the untouched skin: bright in the middle, dim in the corners."""
        x, y = np.moveaxis(self.skin_mm(), -1, 0)
        return 165 - 0.25 * (x**2 + y**2) + 0.4 * x

    def image(self, factor: Array, seed: int) -> Array:
        """An 8-bit image of the skin at this brightness factor."""
        grey = self.light() * factor + np.random.default_rng((self.seed, seed)).normal(0, self.noise, factor.shape)
        return np.repeat(np.clip(np.round(grey), 0, 255).astype(np.uint8)[..., None], 3, axis=2)

    def board_factor(self, skip: tuple[int, ...] = ()) -> Array:
        """Every pin makes a round dark spot with a faint bright rim; pins in `skip` do not touch."""
        skin = self.skin_mm()
        factor = np.ones(skin.shape[:2])
        for number, pin in enumerate(pins_mm(self.design.pin_board)):
            if number not in skip:
                near = (np.abs(skin - pin) < PIN_REACH_MM).all(axis=-1)
                squared = ((skin[near] - pin) ** 2).sum(axis=-1)
                factor[near] -= self.contrast * (np.exp(-squared / 0.6) - 0.2 * np.exp(-squared / 1.6))
        return factor

    def ball_factor(self, centre_mm: tuple[float, float] = (0.6, 0.7), edge_mm: float = 3.2) -> Array:
        """The depth that each line of sight meets on the ball, darkened in proportion, in a bright ring."""
        skin, distance = self.skin_mm(), self.design.camera.distance_mm
        radius = self.design.ball.radius_mm
        ball = np.array([*centre_mm, np.sqrt(radius**2 - edge_mm**2)])
        sight = np.concatenate([skin, np.full((*skin.shape[:2], 1), distance)], axis=-1)
        part = intersect_rays_with_sphere(np.array([0.0, 0.0, -distance]) - ball, sight, radius)
        outside = np.hypot(*np.moveaxis(skin - np.array(centre_mm), -1, 0)) - edge_mm
        ring = np.where(outside > 0, BRIGHT * outside * np.exp(-outside / 0.8), 0)
        return 1 - DARK_PER_MM * np.maximum(distance * (1 - part), 0) + ring

    @cache  # noqa: B019 - the sensors of a test run are few
    def images(self, skip: tuple[int, ...] = ()) -> CalibrationImages:
        """The four calibration images."""
        untouched = np.ones(self.lens.raw_shape)
        return CalibrationImages(
            self.image(untouched, 1),
            self.image(self.board_factor(skip), 2),
            self.image(untouched, 3),
            self.image(self.ball_factor(), 4),
        )

    def turned(self, quarter_turns: int) -> CalibrationImages:
        """The same images from a camera that is turned."""
        return CalibrationImages(
            **{
                name: np.rot90(image, quarter_turns).copy()
                for name, image in vars(self.images()).items()
                if image is not None
            }
        )


@cache
def seen_points_mm(lens: LensModel, every: int = 8) -> Array:
    """The lens backwards for every pixel: Newton's method on a coarse grid, splines between."""
    rows, cols = lens.raw_shape
    y, x = np.arange(0, rows + every, every), np.arange(0, cols + every, every)
    pixels = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2).astype(float)
    points = lens.from_affine(pixels)
    for _ in range(40):
        step = np.linalg.solve(lens.px_per_mm(points), (pixels - lens.to_px(points))[..., None])[..., 0]
        points = points + np.clip(step, -1, 1)
    grid = points.reshape(len(y), len(x), 2)
    fields = [RectBivariateSpline(y, x, grid[..., axis])(np.arange(rows), np.arange(cols)) for axis in (0, 1)]
    return np.stack(fields, axis=-1)


def pins_mm(board: PinBoard) -> Array:
    """Pins row by row, as `BoardFit.nodes` counts them when the camera is not turned."""
    columns, rows = np.meshgrid(np.arange(board.cols), np.arange(board.rows))
    nodes = np.column_stack([columns.ravel(), rows.ravel()])
    return (nodes - (np.array([board.cols, board.rows]) - 1) / 2) * board.pitch_mm


def with_board(board: PinBoard) -> KnownSensor:
    """A sensor whose design has another pin board."""
    return KnownSensor(design=replace(SensorDesign(), pin_board=board))
