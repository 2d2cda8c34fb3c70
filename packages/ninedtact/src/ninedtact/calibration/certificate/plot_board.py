"""Plots of the board press for the certificate: the detected pins, and the leave-one-out error of each pin. Each plot is returned
as a PNG. Also the figure style that these plots share with those of the ball, and the image of a board that was not found.

The image of the board is drawn with OpenCV, which is immediate. The figures are drawn with matplotlib, which is slow to import, so
it is imported when a figure is drawn; its global state is never changed.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.atomic_write import FileNotWritten, write_file_atomically
from ninedtact.calibration.board.board_fit import SMOOTHING_PX, BoardFit
from ninedtact.calibration.board.detection import BoardNotFound
from ninedtact.calibration.brightness_change import smooth_gaussian
from ninedtact.calibration.certificate.checks import LEAVE_ONE_OUT_RMS_MM
from ninedtact.calibration.procedure import Calibration
from ninedtact.calibration.sensor_toml_schema import PinMapTable
from ninedtact.quantities import centred_axis_mm
from ninedtact.shape.coloured_height_map import figure_to_png
from ninedtact.shape.lens_and_rectification import Points

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


FOUND, MISSING = "#ffd84d", "#d81b78"
AXIS_COLOURS = {"x": "#ff4b3e", "y": "#35d07f"}
VIEW: dict[str, Any] = {"color": "#2f6fed", "linewidth": 1.0, "linestyle": (0, (5, 3))}
MAGNIFICATIONS = (1, 2, 5, 10, 20, 50, 100)


def plot_pin_detection(calibration: Calibration) -> bytes:
    """Return a PNG of the change that the board caused, with found pins, missing pins, the sensor's axes and the
    outline of the view.
    """
    board, grey = calibration.board, stretch_contrast(smooth_gaussian(calibration.board.change, SMOOTHING_PX))
    rows, cols = grey.shape
    figure = new_certificate_figure(rows / cols)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(grey, cmap="gray", vmin=0, vmax=255)
    axes.plot(*_grid_outline(calibration.rectify.source_px).T, **VIEW)
    axes.plot(*board.points_px[board.found].T, "+", color=FOUND, markersize=8, markeredgewidth=1.1)
    _plot_missing_pins(axes, board)
    _plot_sensor_axes(axes, board)
    axes.set(xlim=(-0.5, cols - 0.5), ylim=(rows - 0.5, -0.5))
    axes.set_axis_off()
    return figure_to_png(figure)


def _grid_outline(grid: Float[Array, "rows cols 2"]) -> Float[Array, "n 2"]:
    """Return the border of a grid of points as a closed line."""
    return np.vstack([grid[0], grid[:, -1], grid[-1, ::-1], grid[::-1, 0]])


def _plot_missing_pins(axes: "Axes", board: BoardFit) -> None:
    """Draw circles where missing pins are predicted, with their names in the gap towards the middle of the image."""
    missing_px, (rows, cols) = board.points_px[~board.found], board.change.shape
    axes.plot(*missing_px.T, "o", color=MISSING, markerfacecolor="none", markersize=10, markeredgewidth=1.6)
    ground = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1}
    for name, (x, y) in zip(board.missing_pins, missing_px.tolist(), strict=True):
        side = {0: "left", 1: "center", 2: "right"}[int(3 * np.clip(x / cols, 0, 0.99))]
        lift, stand = (10, "bottom") if y > rows / 2 else (-10, "top")
        style: dict[str, Any] = {"color": MISSING, "fontsize": 7.5, "ha": side, "va": stand, "bbox": ground}
        axes.annotate(name, (x, y), (0, lift), textcoords="offset points", **style)


def _plot_sensor_axes(axes: "Axes", board: BoardFit) -> None:
    """Draw the sensor's x and y axes from the centre of the skin, each labelled between two pins."""
    length_mm = 1.3 * board.board.pitch_mm
    middle, *tips = board.lens.to_px(np.array([(0, 0), (length_mm, 0), (0, length_mm)], float))
    for (name, colour), tip in zip(AXIS_COLOURS.items(), tips, strict=True):
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.6, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tip, middle, arrowprops=arrow)
        x, y = tip + 0.16 * (tip - middle)
        axes.text(x, y, name, color=colour, fontsize=11, fontweight="bold", ha="center", va="center")


def plot_leave_one_out_errors(calibration: Calibration) -> bytes:
    """Return a PNG of the error of every pin predicted from all others: arrows magnified, coloured by length, in mm."""
    figure, board = new_certificate_figure(), calibration.board
    axes = add_labelled_axes(figure, (0.13, 0.135, 0.69, 0.785), "x (mm)", "y (mm)")
    seen_mm, error_mm = board.points_mm[board.found], _leave_one_out_errors_mm(calibration)
    _plot_error_arrows(figure, axes, seen_mm, error_mm, arrow_magnification(error_mm, board.board.pitch_mm))
    axes.plot(*board.points_mm[~board.found].T, "o", color=MISSING, markerfacecolor="none", markersize=8)
    rows, cols = calibration.rectify.source_px.shape[:2]
    corners = np.meshgrid(*(centred_axis_mm(n, calibration.rectify.mm_per_px)[[0, -1]] for n in (cols, rows)))
    axes.plot(*_grid_outline(np.stack(corners, axis=-1)).T, **VIEW)
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.04)
    axes.invert_yaxis()
    return figure_to_png(figure)


def _plot_error_arrows(figure: "Figure", axes: "Axes", at_mm: Points, error_mm: Points, times: int) -> None:
    """Draw arrows from each pin towards its predicted position, with the scales of their length and of their colour."""
    lengths = np.hypot(*error_mm.T)
    arrows = axes.quiver(
        *at_mm.T,
        *(error_mm * times).T,
        lengths,
        cmap="viridis_r",
        angles="xy",
        scale_units="xy",
        scale=1,
        width=0.005,
        minlength=0.5,
    )
    arrows.set_clim(0, max(2 * LEAVE_ONE_OUT_RMS_MM.good, lengths.max()))
    axes.plot(*at_mm.T, ".", color=PALE_INK, markersize=2.5)
    axes.set_title(f"arrows {times} times as long as the error", fontsize=8.5, color=INK, pad=5)
    add_colour_bar(figure, arrows, (0.845, 0.135, 0.025, 0.785), "error (mm)")


def _leave_one_out_errors_mm(calibration: Calibration) -> Points:
    """Return the leave-one-out errors of the lens that the calibration uses."""
    is_published_map = isinstance(calibration.record.lens, PinMapTable)
    return (calibration.board.published_map if is_published_map else calibration.board).leave_one_out_errors_mm


def arrow_magnification(error_mm: Points, pitch_mm: float) -> int:
    """Return the largest round factor at which arrows still hardly reach beyond the next pin."""
    longest_mm = float(np.hypot(*error_mm.T).max())
    return max((factor for factor in MAGNIFICATIONS if factor * longest_mm <= 1.5 * pitch_mm), default=1)
