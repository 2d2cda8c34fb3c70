"""Shared figure style of the certificate, and the image of a board that was not found.

The image of the board is drawn with OpenCV, which is immediate. The figures of the certificate are drawn with matplotlib, which is
slow to import, so it is imported when a figure is drawn; its global state is never changed.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.atomic_write import FileNotWritten, write_file_atomically
from ninedtact.calibration.board.detection import BoardNotFound

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

Box = tuple[float, float, float, float]
"""Left, bottom, width and height, as fractions of a figure."""

LEAST_SPAN = 12.0
"""Smallest range in grey levels from black to white, so that the noise of an image without content is not amplified."""
TAILS_PERCENT = 0.5
"""Percentage of the pixels at either end of the range that may be clipped."""
SPOT_BGR = (0, 160, 255)
FRACTION_BITS = 4
"""OpenCV draws at sub-pixel positions that are given as integers with this many binary places."""

WIDTH_IN, DPI = 4.5, 220
"""On half a page of A4, a figure has about three quarters of this width and is sharp in print."""
INK, PALE_INK = "#22262b", "#6b7280"


def stretch_contrast(image: Float32[Array, "rows cols"]) -> UInt8[Array, "rows cols"]:
    """Return the image with its range stretched from black to white."""
    low, high = np.percentile(image, [TAILS_PERCENT, 100 - TAILS_PERCENT])
    span = max(high - low, LEAST_SPAN)
    return np.asarray(np.clip((image - (low + high) / 2) * (255 / span) + 127.5, 0, 255), np.uint8)


def draw_board_not_found(error: BoardNotFound) -> UInt8[Array, "rows cols 3"]:
    """Return the change that the press caused, from black to white, with the detected spots circled and counted; BGR."""
    canvas = cv2.cvtColor(stretch_contrast(error.change), cv2.COLOR_GRAY2BGR)
    rows, cols = error.change.shape
    long_side = max(rows, cols)
    inside = ((error.detected_px >= 0) & (error.detected_px < (cols, rows))).all(axis=1)
    for x, y in np.rint(error.detected_px[inside] * 2**FRACTION_BITS).astype(int).tolist():
        cv2.circle(canvas, (x, y), long_side * 2**FRACTION_BITS // 50, SPOT_BGR, 2, cv2.LINE_AA, FRACTION_BITS)
    _write_caption(
        canvas,
        f"found {error.found_pins} of {error.expected_pins} pins; spots circled: {inside.sum()}",
        long_side / 1300,
    )
    return np.asarray(canvas)


def save_board_not_found_drawing(error: BoardNotFound, path: Path) -> BoardNotFound:
    """Draw what was detected into a PNG file; return the error with the file's path, as it was where nothing can be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file_atomically(path, cv2.imencode(".png", draw_board_not_found(error))[1].tobytes())
    except (OSError, FileNotWritten):
        return error
    return error.with_drawing(path)


def _write_caption(canvas: UInt8[Array, "rows cols 3"], words: str, size: float) -> None:
    """Draw text in the lower left corner, on a dark strip."""
    font, margin, bottom = cv2.FONT_HERSHEY_SIMPLEX, round(10 * size), canvas.shape[0]
    (width, height), below = cv2.getTextSize(words, font, size, 1)
    cv2.rectangle(
        canvas, (0, bottom - height - below - 2 * margin), (width + 2 * margin, bottom), (0, 0, 0), cv2.FILLED
    )
    cv2.putText(canvas, words, (margin, bottom - below - margin), font, size, (255, 255, 255), 1, cv2.LINE_AA)


def new_certificate_figure(height_per_width: float = 0.75) -> "Figure":
    """Return an empty white figure of the certificate's width."""
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH_IN, WIDTH_IN * height_per_width), dpi=DPI, facecolor="white")


def add_labelled_axes(figure: "Figure", box: Box, x_label: str, y_label: str) -> "Axes":
    """Return labelled axes in a box of the figure."""
    axes = figure.add_axes(box)
    for axis, words in ((axes.xaxis, x_label), (axes.yaxis, y_label)):
        _label_axis(axis, words)
    axes.spines[:].set(color="#9ca3af", linewidth=0.6)
    return axes


def _label_axis(axis: "Axis", words: str) -> None:
    """Set round tick values and the label of an axis."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(8, steps=[1, 2, 5, 10]))
    axis.set_label_text(words, color=INK, fontsize=8.5)
    axis.set_tick_params(colors=INK, labelsize=8, width=0.6, length=3)


def add_colour_bar(figure: "Figure", shown: "ScalarMappable", box: Box, words: str) -> None:
    """Draw the colour bar of a figure in a box of it."""
    bar = figure.colorbar(shown, cax=figure.add_axes(box))
    _label_axis(bar.ax.yaxis, words)
    bar.outline.set_visible(False)
