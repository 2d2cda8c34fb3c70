"""How well the depth curve from one real ball press reads the ball back, and whether the camera's nearness is in the image.

A curve from one half of the disc reads the other half (mean absolute error over four cuts; centre and radius of the disc
are found on the whole). No depth was measured when the images were taken: the truth is the ball, in the disc where it was seen.

The camera stands 14 mm under the skin, so its lines of sight are not parallel. The paper leaves that out, as if the
camera were infinitely far. Here the distance is varied: if it matters, the error is least near the true one.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_most
from real_images import sensor_folder

from ninedtact import SensorDesign, read_image
from ninedtact.calibration.ball.ball_fit import fit_ball
from ninedtact.calibration.ball.ball_press import BallFit
from ninedtact.calibration.board.board_fit import build_rectification, fit_board
from ninedtact.shape.depth import DepthMethod
from ninedtact.shape.lens_and_rectification import Rectification

METHODS: tuple[DepthMethod, ...] = ("ratio", "table")
ON_OTHER_HALF_MM = 0.02
PUBLISHED_MM = "0.0462 (paper, 20 presses)"
FAR_MM = 1e5
SCAN_MM = (8, 10, 11, 12, 13, 14.05, 15, 16, 18, 20, 25, 30, FAR_MM)


def ball_accuracy(quick: bool = False, json: bool = False) -> None:
    """Measure sensor_a."""
    cv2.setNumThreads(1)
    folder, design = sensor_folder("sensor_a"), SensorDesign()
    fit = partial(fitted, folder, grid(folder))
    methods = METHODS[:1] if quick else METHODS
    figures = [on_other_half(method, fit(method, design.camera.distance_mm)) for method in methods]
    for method in methods:
        figures += scan(
            method,
            {
                distance_mm: fit(method, distance_mm).cross_validation_mae_mm
                for distance_mm in (SCAN_MM[4:7] if quick else SCAN_MM)
            },
        )
    answer("Accuracy of the depth calibration, real ball presses", figures, json)


def grid(folder: Path) -> Rectification:
    """The sensor's rectification, from its board."""
    reference, press = (read_image(folder / f"{name}.png") for name in ("board_reference", "board"))
    return build_rectification(fit_board(reference, press, SensorDesign().pin_board), SensorDesign())


def fitted(folder: Path, rectify: Rectification, method: DepthMethod, distance_mm: float) -> BallFit:
    """The ball press read with the camera at this distance."""
    design = SensorDesign()
    design = replace(design, camera=replace(design.camera, distance_mm=float(distance_mm)))
    reference, press = (read_image(folder / f"{name}.png") for name in ("ball_reference", "ball"))
    return fit_ball(rectify, reference, press, design, method)


def on_other_half(method: DepthMethod, fit: BallFit) -> Figure:
    name = f"sensor_a, {method}: error on the other half, mm"
    return at_most(name, fit.cross_validation_mae_mm, ON_OTHER_HALF_MM, peer=PUBLISHED_MM)


def scan(method: DepthMethod, error_mm: dict[float, float]) -> list[Figure]:
    """The same error for each distance of the camera, and where it is least."""
    lines = [Figure(f"{method}, camera at {in_mm(distance)}: the same, mm", mm) for distance, mm in error_mm.items()]
    best = least({distance: mm for distance, mm in error_mm.items() if distance < FAR_MM})
    return [*lines, Figure(f"{method}: distance of least error, mm (14.05 by design)", best)]


def least(errors: dict[float, float]) -> float:
    """Where the parabola through the least error and its neighbours is least."""
    distances, values = np.array(list(errors)), np.array(list(errors.values()))
    middle = int(np.clip(values.argmin(), 1, len(values) - 2))
    square, slope, _ = np.polyfit(distances[middle - 1 : middle + 2], values[middle - 1 : middle + 2], 2)
    return float(-slope / (2 * square))


def in_mm(distance: float) -> str:
    return "infinity (lines of sight ignored)" if distance == FAR_MM else f"{distance:g} mm"


if __name__ == "__main__":
    tyro.cli(ball_accuracy)
