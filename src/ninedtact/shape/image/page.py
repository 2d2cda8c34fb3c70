"""What the images for people share: a page measured in pixels, its words, and the bar that explains the colours.

matplotlib is slow to import, so it is imported when an image is drawn; its global state is never touched.
"""

import math
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np

from ninedtact.shape.image.palette import ColourScale
from ninedtact.shape.measures import ShapeSummary

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

DPI = 110
LEFT_PX = 80
TOP_PX = 105
RIGHT_PX = 175
BOTTOM_PX = 110
"""Margins: for the axis and its numbers, the headings, the colour bar, the axis and the legend."""
NARROWEST_PX = 900
"""What the headings need."""
INK, PALE_INK = "#22262b", "#6b7280"
EXTRAPOLATED = "#e69f00"


def page(title: str, subtitle: str, width_px: int, height_px: int) -> "Figure":
    """A white page with a drawing area of this size between its margins, and headings above it."""
    from matplotlib.figure import Figure

    size_px = max(LEFT_PX + width_px + RIGHT_PX, NARROWEST_PX), TOP_PX + height_px + BOTTOM_PX
    figure = Figure(figsize=(size_px[0] / DPI, size_px[1] / DPI), dpi=DPI, facecolor="white")
    note(figure, LEFT_PX, 48, title, size=16, weight="bold", color=INK)
    note(figure, LEFT_PX, 80, subtitle, size=11)
    return figure


def note(figure: "Figure", x_px: int, y_px: int, words: str, **style: Any) -> None:
    """Words at a pixel of the page, counted from its upper left corner."""
    width_px, height_px = figure.get_size_inches() * DPI
    look: dict[str, Any] = {"color": PALE_INK, "size": 9} | style
    figure.text(x_px / width_px, 1 - y_px / height_px, words, **look)


def axes_at(figure: "Figure", x_px: int, y_px: int, width_px: int, height_px: int) -> "Axes":
    """Axes whose upper left corner is at a pixel of the page."""
    page_width, page_height = figure.get_size_inches() * DPI
    return figure.add_axes(
        (x_px / page_width, 1 - (y_px + height_px) / page_height, width_px / page_width, height_px / page_height)
    )


def colour_bar(figure: "Figure", scale: ColourScale, x_px: int, height_px: int) -> None:
    """The colours of all heights, in mm, equally spaced."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    shown = ScalarMappable(Normalize(-scale.pressed_mm, scale.bulged_mm), colour_map(scale))
    bar = figure.colorbar(shown, cax=axes_at(figure, x_px, TOP_PX, 24, height_px))
    bar.set_label("height (mm): pressed in < 0 < bulging", color=INK, size=10)
    bar.outline.set_visible(False)
    bar.ax.tick_params(colors=INK, labelsize=9)


def colour_map(scale: ColourScale) -> "Colormap":
    """The colours of a scale as matplotlib takes them."""
    from matplotlib.colors import ListedColormap

    z_mm = np.linspace(-scale.pressed_mm, scale.bulged_mm, 2048)
    return ListedColormap((scale.colour(z_mm) / 255).tolist())


def in_words(summary: ShapeSummary) -> str:
    """The measures of a height map in one line."""
    if summary.contact_area_mm2 == 0:
        return f"no contact: nowhere pressed in by more than {summary.contact_threshold_mm:.2f} mm"
    return (
        f"pressed in {summary.max_indentation_mm:.2f} mm at most · contact {summary.contact_area_mm2:.1f} mm² · "
        f"displaced {summary.displaced_volume_mm3:.1f} mm³ · bulge {summary.max_bulge_mm:.2f} mm at most"
    )


def signed(length_mm: float) -> str:
    """A number with a true minus sign and no idle zeros."""
    return f"{length_mm:g}".replace("-", "\N{MINUS SIGN}")


def round_number(at_least: float) -> float:
    """The smallest of 1, 2, 5, 10, 20, … that is not below, also below 1."""
    power = 10.0 ** math.floor(math.log10(at_least))
    return float(next(factor * power for factor in (1, 2, 5, 10) if factor * power >= at_least))


def png(figure: "Figure") -> bytes:
    """The page as a PNG."""
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()
