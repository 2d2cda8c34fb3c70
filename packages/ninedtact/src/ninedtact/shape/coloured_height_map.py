"""Images of a height map for display, in colours of height: with contour lines and the edge of the contact
(`draw_height_map_figure`), or shaded as if lit from one side (`render_relief`). Blue is indented, red is bulging, nearly white is
undeformed skin; heights are hatched where they are extrapolated.

The module also holds what the still images share: a page measured in pixels, its text, and the colour bar. matplotlib is slow to
import, so it is imported when an image is drawn; its global state is never changed.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.quantities import HeightMap, HeightSource
from ninedtact.shape.surface import (
    ContactRule,
    ShapeSummary,
    contact_mask,
    max_bulge_mm,
    max_indentation_mm,
    summarise_shape,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure


# ColorBrewer's RdBu, whose colours colour-blind readers can distinguish.
PRESSED = ("#f7f7f7", "#d1e5f0", "#92c5de", "#4393c3", "#2166ac", "#08306b")
BULGED = ("#f7f7f7", "#fddbc7", "#f4a582", "#d6604d", "#b2182b", "#67001f")
OUT_OF_VIEW = "#8c8c8c"


@dataclass(frozen=True)
class ColourScale:
    """The heights at the two ends of the colour scale. The sides are scaled separately, because a bulge is far smaller than the
    indentation that causes it.
    """

    pressed_mm: float = 2.0
    bulged_mm: float = 0.5

    @cached_property
    def table(self) -> UInt8[Array, "256 3"]:
        """RGB of 256 equal steps of height; the first entry stands for out of view."""
        z_mm = np.linspace(-self.pressed_mm, self.bulged_mm, 255)
        return np.asarray(np.vstack([rgb_of_hex(OUT_OF_VIEW), self.colour(z_mm)]), np.uint8)

    def colour(self, z_mm: Float[Array, " n"]) -> Float[Array, "n 3"]:
        """Return the RGB (0 to 255) of some heights."""
        pressed, bulged = (np.array([rgb_of_hex(stop) for stop in stops]) for stops in (PRESSED, BULGED))
        stops = np.vstack([pressed[::-1], bulged[1:]])
        places = [*np.linspace(-self.pressed_mm, 0, len(pressed)), *np.linspace(0, self.bulged_mm, len(bulged))[1:]]
        return np.column_stack([np.rint(np.interp(z_mm, places, channel)) for channel in stops.T])


def fit_colour_scale(height: HeightMap) -> ColourScale:
    """Return a scale that covers one whole height map; noise alone stays pale."""
    faintest = max(0.05, 10 * height.noise_mm)
    pressed = max(max_indentation_mm(height), faintest)
    return ColourScale(pressed, max(max_bulge_mm(height), faintest, pressed / 8))


def colourise_heights(height: HeightMap, scale: ColourScale = ColourScale()) -> UInt8[Array, "rows cols 3"]:
    """Return heights as a BGR image for live display; heights beyond the scale get the colour of its end."""
    steps_per_mm = 254 / (scale.pressed_mm + scale.bulged_mm)
    index = cv2.addWeighted(
        height.z_mm, steps_per_mm, height.z_mm, 0, 1 + scale.pressed_mm * steps_per_mm, dtype=cv2.CV_8U
    )
    index = np.maximum(index, np.uint8(1))
    index *= height.in_view
    return np.asarray(cv2.applyColorMap(index, np.ascontiguousarray(scale.table[:, None, ::-1])))


def rgb_of_hex(colour: str) -> tuple[int, ...]:
    """Return red, green and blue (0 to 255) of #rrggbb."""
    return tuple(bytes.fromhex(colour[1:]))


DPI = 110
LEFT_PX = 80
TOP_PX = 105
RIGHT_PX = 175
BOTTOM_PX = 110
"""Margins in pixels. Left: the axis and its numbers; top: the headings; right: the colour bar; bottom: the axis and the legend."""
NARROWEST_PX = 900
"""Smallest width of a page, set by its headings."""
INK, PALE_INK = "#22262b", "#6b7280"
EXTRAPOLATED = "#e69f00"


def new_figure_page(title: str, subtitle: str, width_px: int, height_px: int) -> "Figure":
    """Return a white page with a drawing area of this size between its margins, and headings above it."""
    from matplotlib.figure import Figure

    size_px = max(LEFT_PX + width_px + RIGHT_PX, NARROWEST_PX), TOP_PX + height_px + BOTTOM_PX
    figure = Figure(figsize=(size_px[0] / DPI, size_px[1] / DPI), dpi=DPI, facecolor="white")
    add_text_at(figure, LEFT_PX, 48, title, size=16, weight="bold", color=INK)
    add_text_at(figure, LEFT_PX, 80, subtitle, size=11)
    return figure


def add_text_at(figure: "Figure", x_px: int, y_px: int, words: str, **style: Any) -> None:
    """Write text at a pixel of the page, counted from its upper left corner."""
    width_px, height_px = figure.get_size_inches() * DPI
    look: dict[str, Any] = {"color": PALE_INK, "size": 9} | style
    figure.text(x_px / width_px, 1 - y_px / height_px, words, **look)


def add_axes_at(figure: "Figure", x_px: int, y_px: int, width_px: int, height_px: int) -> "Axes":
    """Return axes whose upper left corner is at a pixel of the page."""
    page_width, page_height = figure.get_size_inches() * DPI
    return figure.add_axes(
        (x_px / page_width, 1 - (y_px + height_px) / page_height, width_px / page_width, height_px / page_height)
    )


def add_colour_bar(figure: "Figure", scale: ColourScale, x_px: int, height_px: int) -> None:
    """Draw the colours of all heights, in mm, equally spaced."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    shown = ScalarMappable(Normalize(-scale.pressed_mm, scale.bulged_mm), _matplotlib_colour_map(scale))
    bar = figure.colorbar(shown, cax=add_axes_at(figure, x_px, TOP_PX, 24, height_px))
    bar.set_label("height (mm): indented < 0 < bulging", color=INK, size=10)
    bar.outline.set_visible(False)
    bar.ax.tick_params(colors=INK, labelsize=9)


def _matplotlib_colour_map(scale: ColourScale) -> "Colormap":
    from matplotlib.colors import ListedColormap

    z_mm = np.linspace(-scale.pressed_mm, scale.bulged_mm, 2048)
    return ListedColormap((scale.colour(z_mm) / 255).tolist())


def shape_summary_sentence(summary: ShapeSummary) -> str:
    """Return the measures of a height map in one line."""
    if summary.contact_area_mm2 == 0 and not summary.is_deepest_clipped:
        return f"no contact: nowhere indented by more than {summary.contact_threshold_mm:.2f} mm"
    indentation = f"{summary.max_indentation_mm:.2f} mm"
    if summary.is_deepest_clipped:
        indentation = f"at least {summary.max_indentation_mm:.2f} mm, beyond the calibrated range"
    return (
        f"maximum indentation {indentation} · contact {summary.contact_area_mm2:.1f} mm² · "
        f"displaced {summary.displaced_volume_mm3:.1f} mm³ · bulge {summary.max_bulge_mm:.2f} mm at most"
    )


def format_with_minus_sign(length_mm: float) -> str:
    """Return a number with a true minus sign and no trailing zeros."""
    return f"{length_mm:g}".replace("-", "\N{MINUS SIGN}")


def round_up_to_1_2_5(at_least: float) -> float:
    """Return the smallest number of the series 1, 2, 5, 10, 20, … (also continued below 1) that is not below the given one."""
    power = 10.0 ** math.floor(math.log10(at_least))
    return float(next(factor * power for factor in (1, 2, 5, 10) if factor * power >= at_least))


PNG_COMPRESSION = [cv2.IMWRITE_PNG_COMPRESSION, 4, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_DEFAULT]
"""Higher levels take up to twice the time for files that are 5 % smaller."""


def figure_to_png(figure: "Figure") -> bytes:
    """Return the figure, whose background must be opaque, as a PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    canvas: Any = FigureCanvasAgg(figure)
    canvas.draw()
    drawn = cv2.cvtColor(np.asarray(canvas.buffer_rgba()), cv2.COLOR_RGBA2BGR)
    return cv2.imencode(".png", drawn, PNG_COMPRESSION)[1].tobytes()


LONGEST_PX = 840
"""Length of the longer side of the map."""
LINE_SMOOTHING_PX = 1.5
"""Standard deviation of the Gaussian that removes noise from the contour lines; the colours are not smoothed."""
UNSEEN: dict[str, Any] = {"facecolor": OUT_OF_VIEW, "hatch": "////", "edgecolor": "#a8a8a8"}
BEYOND: dict[str, Any] = {"facecolor": "none", "hatch": "..", "edgecolor": EXTRAPOLATED}


@checks_arguments
def draw_height_map_figure(height: HeightMap, title: str = "Height of the skin") -> bytes:
    """Return a PNG with the height map as the camera sees it, axes and heights in mm, and contour lines inside the contact."""
    scale = fit_colour_scale(height)
    colours = colourise_heights(height, scale)[..., ::-1]
    return draw_map_page(height, title, colours, scale, "dark line: edge of the contact", _draw_contour_lines)


def draw_map_page(
    height: HeightMap,
    title: str,
    colours: UInt8[Array, "rows cols 3"],
    scale: ColourScale,
    caption: str,
    draw_over: "Callable[[Axes, HeightMap, ColourScale], None] | None" = None,
) -> bytes:
    """Return a PNG with the RGB colours of a height map between axes in mm, the colour bar of their scale, and what hatching means.

    caption: what the picture shows besides, in words. draw_over: draws onto the axes.
    """
    rows, cols = height.z_mm.shape
    width_px, height_px = cols * LONGEST_PX // max(rows, cols), rows * LONGEST_PX // max(rows, cols)
    figure = new_figure_page(title, shape_summary_sentence(summarise_shape(height)), width_px, height_px)
    axes = add_axes_at(figure, LEFT_PX, TOP_PX, width_px, height_px)
    _draw_colours(axes, height, colours)
    if draw_over is not None:
        draw_over(axes, height, scale)
    _draw_range(axes, height)
    add_colour_bar(figure, scale, LEFT_PX + width_px + 36, height_px)
    add_text_at(figure, LEFT_PX, TOP_PX + height_px + 66, _where_it_is(height))
    add_text_at(figure, LEFT_PX, TOP_PX + height_px + 88, " · ".join([caption, *_hatching_in_words(height)]))
    return figure_to_png(figure)


def _where_it_is(height: HeightMap) -> str:
    """Return what the two axes mean, and the scale."""
    place = "" if np.isinf(height.camera_distance_mm) else ", placed where its lines of sight cross the undeformed skin"
    return f"as the camera sees it{place} · 1 pixel = {height.mm_per_px:.4f} mm"


def _hatching_in_words(height: HeightMap) -> list[str]:
    """Return the meaning of the hatchings that occur."""
    words = ["orange dots: extrapolated"] if (height.source == HeightSource.EXTRAPOLATED).any() else []
    return [*words, *([] if height.in_view.all() else ["grey: out of view"])]


def _draw_colours(axes: "Axes", height: HeightMap, colours: UInt8[Array, "rows cols 3"]) -> None:
    """Draw colours where there is a height, and hatching where there is none."""
    x, y = height.axes_mm
    half = height.mm_per_px / 2
    axes.patch.set(**UNSEEN)
    opacity = np.where(height.in_view, np.uint8(255), np.uint8(0))
    axes.imshow(np.dstack([colours, opacity]), extent=(x[0] - half, x[-1] + half, y[-1] + half, y[0] - half))
    axes.set_xlabel("x (mm)", color=INK)
    axes.set_ylabel("y (mm)", color=INK)
    axes.tick_params(colors=INK, labelsize=9)
    axes.spines[:].set(color="#9ca3af", linewidth=0.8)


def _draw_contour_lines(axes: "Axes", height: HeightMap, scale: ColourScale) -> None:
    """Draw contour lines inside the contact, and its edge."""
    seen, threshold = height.in_view, ContactRule().threshold_mm(height.noise_mm)
    smooth = cv2.GaussianBlur(np.where(seen, height.z_mm, np.float32(0)), (0, 0), LINE_SMOOTHING_PX)
    z_mm, (x, y) = np.ma.masked_where(~seen, smooth), height.axes_mm
    levels = [level for level in _contour_levels(scale.pressed_mm) if level < -threshold]
    colours = ["white" if -level > 0.45 * scale.pressed_mm else "#1f3b5c" for level in levels]
    if levels:
        lines = axes.contour(x, y, z_mm, levels, colors=colours, linewidths=0.8, linestyles="solid", alpha=0.8)
        axes.clabel(lines, fmt=format_with_minus_sign, fontsize=8)
    contact = cv2.GaussianBlur(contact_mask(height).astype(np.float32), (0, 0), LINE_SMOOTHING_PX)
    axes.contour(x, y, contact, [0.5], colors=INK, linewidths=1.2, linestyles="solid")


def _draw_range(axes: "Axes", height: HeightMap) -> None:
    """Draw dots on extrapolated heights, and the edge of the calibrated range."""
    beyond = np.ma.masked_where(~height.in_view, height.source == HeightSource.EXTRAPOLATED).astype(float)
    axes.contour(*height.axes_mm, beyond, [0.5], colors=EXTRAPOLATED, linewidths=1.3, linestyles="dashed")
    dots = axes.contourf(*height.axes_mm, beyond, [0.5, 1.5], colors="none", hatches=[BEYOND["hatch"]])
    dots.set(edgecolor=EXTRAPOLATED, linewidth=0)


def _contour_levels(deepest_mm: float) -> list[float]:
    """Return at most four round depths, lowest first."""
    step = round_up_to_1_2_5(deepest_mm / 4)
    return [-step * count for count in range(int(deepest_mm / step), 0, -1)]


TOWARDS_LIGHT = np.array([-0.43, -0.43, 0.79])
"""Direction from the skin to the light, in front of the upper left corner."""
AMBIENT = 0.3
"""Fraction of the light that is ambient."""
SMOOTHING_PX = 2.0
"""Standard deviation of the Gaussian on the heights that are shaded; grazing light would otherwise amplify noise."""


@checks_arguments
def render_relief(height: HeightMap, title: str = "Height of the skin") -> bytes:
    """Return a PNG with the skin in colours of height, shaded as if lit from the upper left; axes and heights are in mm."""
    scale = fit_colour_scale(height)
    return draw_map_page(height, title, shade_heights(height, scale)[..., ::-1], scale, "lit from the upper left")


def shade_heights(height: HeightMap, scale: ColourScale = ColourScale()) -> UInt8[Array, "rows cols 3"]:
    """Return heights as a BGR image, in the colours of `colourise_heights` and shaded by `facing_light`."""
    z_mm = cv2.GaussianBlur(np.where(height.in_view, height.z_mm, np.float32(0)), (0, 0), SMOOTHING_PX)
    light = np.where(height.in_view, facing_light(z_mm, height.mm_per_px), np.float32(1))
    return np.asarray(np.clip(colourise_heights(height, scale) * light[..., None], 0, 255), np.uint8)


def facing_light(z_mm: Float32[Array, "rows cols"], mm_per_px: float) -> Float32[Array, "rows cols"]:
    """Return the brightness of a surface of these heights, 1 where it is level: ambient light and Lambert's cosine law."""
    slope_y, slope_x = np.gradient(z_mm, mm_per_px)
    to_x, to_y, to_z = TOWARDS_LIGHT
    cosine = (to_z - slope_x * to_x - slope_y * to_y) / np.sqrt(1 + slope_x**2 + slope_y**2)
    return np.asarray(AMBIENT + (1 - AMBIENT) * np.maximum(cosine, 0) / to_z, np.float32)
