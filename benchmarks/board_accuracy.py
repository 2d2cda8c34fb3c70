"""How well the lens found from each real board predicts a pin that it has not seen, beside the original's way.

The original's way is a cubic radial-basis map through whole-pixel pin centres (`calibration.board.board_fit`). Ours is left-one-out
by an exact update of the linearised fit (PRESS); here it is checked against really fitting the lens again without each pin.
Both keep the centres of the other pins' imprints as found with all pins.
"""

import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_most, holds
from real_images import sensor_folders

from ninedtact import SensorDesign, read_image
from ninedtact.calibration.board.board_fit import BoardFit, fit_board
from ninedtact.calibration.board.lens_fit import LensFit, fit_lens_with_terms, rms_vector_length

SENSOR_A_MM = 0.05
OF_ORIGINAL = 0.8
DENTS = ((10, 560, 240, 90), (14, 80, 80, 100), (8, 320, 300, 60))
"""Largest displacement, place and width of the dents, in pixels."""


def board_accuracy(quick: bool = False, json: bool = False) -> None:
    """Measure every sensor there is."""
    folders = sensor_folders()[:1] if quick else sensor_folders()
    cv2.setNumThreads(1)
    figures = [figure for folder in folders for figure in measured(folder, () if quick else DENTS)]
    answer("Accuracy of the camera calibration, real boards", figures, json)


def measured(folder: Path, dents: Sequence[tuple[float, float, float, float]]) -> Iterator[Figure]:
    """All figures of one board."""
    reference, press = (read_image(folder / f"{name}.png") for name in ("board_reference", "board"))
    start = time.perf_counter()
    board = fit_board(reference, press, SensorDesign().pin_board)
    seconds = time.perf_counter() - start
    found, expected, name = int(board.found.sum()), board.board.count, folder.name
    yield holds(f"{name}: pins found", f"{found} of {expected}", f"{expected} of {expected}", found == expected)
    ours, original = rms_vector_length(board.leave_one_out_errors_mm), original_mm(board)
    limit = SENSOR_A_MM if name == "sensor_a" else OF_ORIGINAL * original
    yield at_most(f"{name}: left-out error, mm", ours, limit, peer=original)
    yield at_most(f"{name}: of the original's", ours / original, OF_ORIGINAL)
    yield Figure(f"{name}: left-out error by fitting again, mm", rms_vector_length(refitted_mm(board.lens_fit)))
    yield Figure(f"{name}: radial terms chosen", len(board.lens.radial))
    yield Figure(f"{name}: smooth correction", "none" if board.correction is None else "used")
    yield Figure(f"{name}: seconds to find and fit", seconds)
    for number, dent in enumerate(dents, start=1):
        bent = fit_board(dented(reference, dent), dented(press, dent), SensorDesign().pin_board)
        ours, original, alone = rms_vector_length(bent.leave_one_out_errors_mm), original_mm(bent), bent.lens_fit
        yield at_most(f"{name}, dent {number}: left-out error, mm", ours, original, peer=original)
        yield Figure(f"{name}, dent {number}: lens alone, mm", alone.leave_one_out_rms_mm)


def dented(image: np.ndarray, dent: tuple[float, float, float, float]) -> np.ndarray:
    """The image displaced smoothly near one place, as no lens model follows it; dent: pixels, column, row, width."""
    rows, cols = image.shape[:2]
    x, y = np.meshgrid(np.arange(cols, dtype=np.float32), np.arange(rows, dtype=np.float32))
    largest, column, row, width = dent
    by = largest * np.exp(-((x - column) ** 2 + (y - row) ** 2) / (2 * width**2))
    return cv2.remap(image, x + by, y - 0.6 * by, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)


def original_mm(board: BoardFit) -> float:
    """The original's way on the same board, and on the same pins."""
    return board.published_map.leave_one_out_rms_mm


def refitted_mm(fit: LensFit) -> np.ndarray:
    """For every pin, where a lens fitted to all others really puts it, minus where it is, (n, 2) in mm."""
    return np.concatenate([refitted_without(fit, pin) for pin in range(len(fit.points_mm))])


def refitted_without(fit: LensFit, pin: int) -> np.ndarray:
    others = np.arange(len(fit.points_mm)) != pin
    again = fit_lens_with_terms(fit.points_mm[others], fit.points_px[others], fit.lens.raw_shape, len(fit.lens.radial))
    return again.lens.to_mm(fit.points_px[pin : pin + 1]) - fit.points_mm[pin]


if __name__ == "__main__":
    tyro.cli(board_accuracy)
