"""The height map as a map: colours, lines of equal height, the edge of the contact, and what not to trust."""

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from ninedtact.quantities import Coverage, HeightMap
from ninedtact.shape.image.page import (
    EXTRAPOLATED,
    INK,
    LEFT_PX,
    PALE_INK,
    TOP_PX,
    axes_at,
    colour_bar,
    colour_map,
    in_words,
    note,
    page,
    png,
    round_number,
    signed,
)
from ninedtact.shape.image.palette import OUT_OF_VIEW, ColourScale, scale_for
from ninedtact.shape.measures import ContactRule, contact, summarise

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LONGEST_PX = 840
"""Width or height of the map, whichever is larger."""
LINE_SMOOTHING_PX = 1.5
"""Standard deviation of the Gaussian that keeps noise out of the lines of equal height; the colours are as measured."""
UNSEEN: dict[str, Any] = {"facecolor": OUT_OF_VIEW, "hatch": "////", "edgecolor": "#a8a8a8"}
BEYOND: dict[str, Any] = {"facecolor": "none", "hatch": "..", "edgecolor": EXTRAPOLATED}


def height_image(height: HeightMap, title: str = "Height of the skin") -> bytes:
    """A PNG with the height map as the camera sees it, axes and heights in mm."""
    rows, cols = height.z_mm.shape
    width_px, height_px = cols * LONGEST_PX // max(rows, cols), rows * LONGEST_PX // max(rows, cols)
    figure, scale = page(title, in_words(summarise(height)), width_px, height_px), scale_for(height)
    axes = axes_at(figure, LEFT_PX, TOP_PX, width_px, height_px)
    draw_colours(axes, height, scale)
    draw_lines(axes, height, scale)
    draw_range(axes, height)
    draw_legend(axes, height, height_px)
    colour_bar(figure, scale, LEFT_PX + width_px + 36, height_px)
    note(figure, LEFT_PX, TOP_PX + height_px + 100, where_it_is(height))
    return png(figure)


def where_it_is(height: HeightMap) -> str:
    """What the two axes mean, and the scale."""
    place = "" if np.isinf(height.camera_distance_mm) else ", placed where its lines of sight cross the untouched skin"
    return f"as the camera sees it{place} · 1 pixel = {height.mm_per_px:.4f} mm"


def draw_colours(axes: "Axes", height: HeightMap, scale: ColourScale) -> None:
    """Colours where there is a height, hatching where there is none."""
    x, y = height.axes_mm
    half = height.mm_per_px / 2
    axes.patch.set(**UNSEEN)
    axes.imshow(
        np.ma.masked_where(~height.in_view, height.z_mm),
        cmap=colour_map(scale),
        vmin=-scale.pressed_mm,
        vmax=scale.bulged_mm,
        extent=(x[0] - half, x[-1] + half, y[-1] + half, y[0] - half),
    )
    axes.set_xlabel("x (mm)", color=INK)
    axes.set_ylabel("y (mm)", color=INK)
    axes.tick_params(colors=INK, labelsize=9)
    axes.spines[:].set(color="#9ca3af", linewidth=0.8)


def draw_lines(axes: "Axes", height: HeightMap, scale: ColourScale) -> None:
    """Lines of equal height inside the contact, and its edge."""
    seen, threshold = height.in_view, ContactRule().threshold_mm(height.noise_mm)
    smooth = cv2.GaussianBlur(np.where(seen, height.z_mm, np.float32(0)), (0, 0), LINE_SMOOTHING_PX)
    z_mm, (x, y) = np.ma.masked_where(~seen, smooth), height.axes_mm
    levels = [level for level in contour_levels(scale.pressed_mm) if level < -threshold]
    colours = ["white" if -level > 0.45 * scale.pressed_mm else "#1f3b5c" for level in levels]
    if levels:
        lines = axes.contour(x, y, z_mm, levels, colors=colours, linewidths=0.8, linestyles="solid", alpha=0.8)
        axes.clabel(lines, fmt=signed, fontsize=8)
    near_contact = cv2.dilate(contact(height).astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
    z_there = np.ma.masked_where(~near_contact, z_mm)
    axes.contour(x, y, z_there, [-threshold], colors=INK, linewidths=1.2, linestyles="solid")


def draw_range(axes: "Axes", height: HeightMap) -> None:
    """Dots on what is extrapolated, and the edge of the calibrated range."""
    beyond = np.ma.masked_where(~height.in_view, height.coverage == Coverage.EXTRAPOLATED).astype(float)
    axes.contour(*height.axes_mm, beyond, [0.5], colors=EXTRAPOLATED, linewidths=1.3, linestyles="dashed")
    dots = axes.contourf(*height.axes_mm, beyond, [0.5, 1.5], colors="none", hatches=[BEYOND["hatch"]])
    dots.set(edgecolor=EXTRAPOLATED, linewidth=0)


def contour_levels(deepest_mm: float) -> list[float]:
    """Round depths, lowest first, four at most."""
    step = round_number(deepest_mm / 4)
    return [-step * count for count in range(int(deepest_mm / step), 0, -1)]


def draw_legend(axes: "Axes", height: HeightMap, axes_height_px: int) -> None:
    """Explain the lines and hatchings that occur."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    edge = signed(-round(ContactRule().threshold_mm(height.noise_mm), 3))
    entries: list[Line2D | Patch] = [Line2D([], [], color=INK, linewidth=1.2, label=f"edge of the contact, {edge} mm")]
    if (height.coverage == Coverage.EXTRAPOLATED).any():
        entries.append(Patch(label="extrapolated", linestyle="dashed", **BEYOND))
    if not height.in_view.all():
        entries.append(Patch(label="out of view", **UNSEEN))
    axes.legend(
        handles=entries,
        loc="upper left",
        bbox_to_anchor=(0, -58 / axes_height_px),
        ncol=3,
        borderaxespad=0,
        borderpad=0,
        frameon=False,
        fontsize=9,
        labelcolor=PALE_INK,
    )
