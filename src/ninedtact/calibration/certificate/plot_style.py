"""What the drawings of a calibration share, and the image of a board that was refused.

The refusal is drawn with OpenCV, at once; the certificate's figures with matplotlib, which is slow to import, so it is
imported when a figure is drawn, and its global state is never touched.
"""

from io import BytesIO
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from numpy import ndarray as Array

from ninedtact.calibration.board.detection import BoardNotFound

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

Box = tuple[float, float, float, float]
"""Left, bottom, width, height, as parts of a figure."""

LEAST_SPAN = 12.0
"""Grey levels from black to white at least: an image with nothing in it stays calm, its noise is not blown up."""
TAILS_PERCENT = 0.5
"""Part of the pixels, at either end, that may burn out."""
SPOT_BGR = (0, 160, 255)
FRACTION_BITS = 4
"""OpenCV draws at sub-pixel positions given as integers with this many binary places."""

WIDTH_IN, DPI = 4.5, 220
"""Half a page of A4 shows a figure at about three quarters of this width, sharp in print."""
INK, PALE_INK = "#22262b", "#6b7280"


def stretch_contrast(image: Float32[Array, "rows cols"]) -> UInt8[Array, "rows cols"]:
    """The image from black to white."""
    low, high = np.percentile(image, [TAILS_PERCENT, 100 - TAILS_PERCENT])
    span = max(high - low, LEAST_SPAN)
    return np.asarray(np.clip((image - (low + high) / 2) * (255 / span) + 127.5, 0, 255), np.uint8)


def draw_board_not_found(error: BoardNotFound) -> UInt8[Array, "rows cols 3"]:
    """What the press changed, from black to white, with the spots taken for pins circled and counted; BGR."""
    canvas = cv2.cvtColor(stretch_contrast(error.change), cv2.COLOR_GRAY2BGR)
    rows, cols = error.change.shape
    long_side = max(rows, cols)
    inside = ((error.detected_px >= 0) & (error.detected_px < (cols, rows))).all(axis=1)
    for x, y in np.rint(error.detected_px[inside] * 2**FRACTION_BITS).astype(int).tolist():
        cv2.circle(canvas, (x, y), long_side * 2**FRACTION_BITS // 50, SPOT_BGR, 2, cv2.LINE_AA, FRACTION_BITS)
    _write_caption(
        canvas, f"found {error.found} of {error.expected} pins; spots circled: {inside.sum()}", long_side / 1300
    )
    return np.asarray(canvas)


def _write_caption(canvas: UInt8[Array, "rows cols 3"], words: str, size: float) -> None:
    """Words in the lower left corner, on a dark strip."""
    font, margin, bottom = cv2.FONT_HERSHEY_SIMPLEX, round(10 * size), canvas.shape[0]
    (width, height), below = cv2.getTextSize(words, font, size, 1)
    cv2.rectangle(
        canvas, (0, bottom - height - below - 2 * margin), (width + 2 * margin, bottom), (0, 0, 0), cv2.FILLED
    )
    cv2.putText(canvas, words, (margin, bottom - below - margin), font, size, (255, 255, 255), 1, cv2.LINE_AA)


def new_certificate_figure(height_per_width: float = 0.75) -> "Figure":
    """An empty white figure of the certificate's width."""
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH_IN, WIDTH_IN * height_per_width), dpi=DPI, facecolor="white")


def add_labelled_axes(figure: "Figure", box: Box, x_label: str, y_label: str) -> "Axes":
    """Axes in a box of the figure, labelled."""
    axes = figure.add_axes(box)
    for axis, words in ((axes.xaxis, x_label), (axes.yaxis, y_label)):
        _label_axis(axis, words)
    axes.spines[:].set(color="#9ca3af", linewidth=0.6)
    return axes


def _label_axis(axis: "Axis", words: str) -> None:
    """Round numbers, and what they are."""
    from matplotlib.ticker import MaxNLocator

    axis.set_major_locator(MaxNLocator(8, steps=[1, 2, 5, 10]))
    axis.set_label_text(words, color=INK, fontsize=8.5)
    axis.set_tick_params(colors=INK, labelsize=8, width=0.6, length=3)


def add_colour_bar(figure: "Figure", shown: "ScalarMappable", box: Box, words: str) -> None:
    """What the colours of a figure mean, in a box of it."""
    bar = figure.colorbar(shown, cax=figure.add_axes(box))
    _label_axis(bar.ax.yaxis, words)
    bar.outline.set_visible(False)


def figure_to_png(figure: "Figure") -> bytes:
    """The figure as a PNG."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()
