"""The height map as a map: colours, lines of equal height, the edge of the contact, and what not to trust."""

from typing import TYPE_CHECKING

import cv2
import numpy as np

from ninedtact.quantities import Coverage, HeightMap
from ninedtact.shape.measures import ContactRule, summarise
from ninedtact.shape.picture.page import (
    EXTRAPOLATED,
    INK,
    LEFT_PX,
    PALE_INK,
    TOP_PX,
    axes_at,
    colour_bar,
    in_words,
    note,
    page,
    png,
    round_number,
    signed,
)
from ninedtact.shape.picture.palette import OUT_OF_VIEW, ColourScale, scale_for

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LONGEST_PX = 840
"""Width or height of the map, whichever is larger."""
LINE_SMOOTHING_PX = 1.5
"""Standard deviation of the Gaussian that keeps noise out of the lines of equal height; the colours are as measured."""
HATCH = {"facecolor": OUT_OF_VIEW, "hatch": "////", "edgecolor": "#a8a8a8"}


def map_picture(height: HeightMap, title: str = "Height of the skin") -> bytes:
    """A PNG with the height map as the camera sees it, axes and heights in mm."""
    rows, cols = height.z_mm.shape
    width_px, height_px = cols * LONGEST_PX // max(rows, cols), rows * LONGEST_PX // max(rows, cols)
    figure, scale = page(title, in_words(summarise(height)), width_px, height_px), scale_for(height)
    axes = axes_at(figure, LEFT_PX, TOP_PX, width_px, height_px)
    draw_colours(axes, height, scale)
    draw_lines(axes, height, scale)
    draw_legend(axes, height)
    colour_bar(figure, scale, LEFT_PX + width_px + 36, height_px)
    note(figure, LEFT_PX, TOP_PX + height_px + 75, f"seen from the camera · 1 pixel = {height.mm_per_px:.4f} mm")
    return png(figure)


def draw_colours(axes: "Axes", height: HeightMap, scale: ColourScale) -> None:
    """Colours where there is a height, hatching where there is none."""
    from matplotlib.colors import ListedColormap

    x, y = height.axes_mm
    half = height.mm_per_px / 2
    axes.patch.set(**HATCH)
    axes.imshow(
        np.ma.masked_where(~height.in_view, height.z_mm),
        cmap=ListedColormap((scale.table[1:] / 255).tolist()),
        vmin=-scale.pressed_mm,
        vmax=scale.bulged_mm,
        extent=(x[0] - half, x[-1] + half, y[-1] + half, y[0] - half),
    )
    axes.set_xlabel("x (mm)", color=INK)
    axes.set_ylabel("y (mm)", color=INK)
    axes.tick_params(colors=INK, labelsize=9)
    axes.spines[:].set(color="#9ca3af", linewidth=0.8)


def draw_lines(axes: "Axes", height: HeightMap, scale: ColourScale) -> None:
    """Lines of equal height inside the contact, its edge, and the edge of the calibrated range."""
    seen, threshold = height.in_view, ContactRule().threshold_mm(height.noise_mm)
    smooth = cv2.GaussianBlur(np.where(seen, height.z_mm, np.float32(0)), (0, 0), LINE_SMOOTHING_PX)
    z_mm, (x, y) = np.ma.masked_where(~seen, smooth), height.axes_mm
    levels = [level for level in contour_levels(scale.pressed_mm) if level < -threshold]
    colours = ["white" if -level > 0.45 * scale.pressed_mm else "#1f3b5c" for level in levels]
    if levels:
        lines = axes.contour(x, y, z_mm, levels, colors=colours, linewidths=0.8, linestyles="solid", alpha=0.8)
        axes.clabel(lines, fmt=signed, fontsize=8)
    axes.contour(x, y, z_mm, [-threshold], colors=INK, linewidths=1.2, linestyles="solid")
    beyond = np.ma.masked_where(~seen, height.coverage == Coverage.EXTRAPOLATED)
    axes.contour(x, y, beyond, [0.5], colors=EXTRAPOLATED, linewidths=1.3, linestyles="dashed")


def contour_levels(deepest_mm: float) -> list[float]:
    """Round depths, lowest first, six at most."""
    step = round_number(deepest_mm / 6)
    return [-step * count for count in range(int(deepest_mm / step), 0, -1)]


def draw_legend(axes: "Axes", height: HeightMap) -> None:
    """Explain the lines and hatchings that occur."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    edge = signed(-round(ContactRule().threshold_mm(height.noise_mm), 3))
    entries: list[Line2D | Patch] = [Line2D([], [], color=INK, linewidth=1.2, label=f"edge of the contact, {edge} mm")]
    if (height.coverage == Coverage.EXTRAPOLATED).any():
        beyond = "beyond it, extrapolated"
        entries.append(Line2D([], [], color=EXTRAPOLATED, linewidth=1.3, linestyle="dashed", label=beyond))
    if not height.in_view.all():
        entries.append(Patch(label="out of view", **HATCH))
    axes.legend(
        handles=entries,
        loc="upper right",
        bbox_to_anchor=(1.005, -0.075),
        ncol=3,
        frameon=False,
        fontsize=9,
        labelcolor=PALE_INK,
    )
