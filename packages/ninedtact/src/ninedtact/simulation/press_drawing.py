"""The figure of a simulated press in full.

matplotlib is slow to import, so it is imported when a figure is drawn; its global state is never touched.
"""

from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Indenter
from ninedtact.quantities import BgrImage, Wrench
from ninedtact.simulation.ground_truth import (
    resample_skin_field,
    true_height_map,
    true_pressure_map_mpa,
    true_shear_map_mpa,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


MM_PER_PX = 0.1
INK, PALE_INK, OBJECT = "#22262b", "#6b7280", "#d97706"
STICK, SLIP = "#0f766e", "#be185d"
ARROWS_ACROSS = 18
"""Number of arrows along the longer side of the contact."""
ABOVE_MM = 1.0
"""Height of the object that is drawn above the highest skin."""
ROUND_CONTACT_MM = 2.5
"""Margin of skin around the contact."""
DPI = 110


@dataclass(frozen=True)
class PressFigure:
    """One contact as one figure: image, heights, tractions, a cut, and the wrench."""

    contact: Contact
    indenter: Indenter
    image: BgrImage
    reach_mm: tuple[float, float]
    """Half the width and half the height of the area that is drawn."""
    along: tuple[float, float] = (1.0, 0.0)
    """Direction of the cut, a unit vector."""

    @cached_property
    def shape(self) -> tuple[int, int]:
        """The (rows, cols) of the grid that is drawn."""
        cols, rows = (2 * int(reach / MM_PER_PX) + 1 for reach in self.reach_mm)
        return rows, cols

    @cached_property
    def axes_mm(self) -> tuple[Float[Array, " cols"], Float[Array, " rows"]]:
        """x of the columns and y of the rows of the grid."""
        rows, cols = self.shape
        return (np.arange(cols) - cols // 2) * MM_PER_PX, (np.arange(rows) - rows // 2) * MM_PER_PX

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top of the grid, with y downwards as in the image."""
        (x, y), half = self.axes_mm, MM_PER_PX / 2
        return float(x[0] - half), float(x[-1] + half), float(y[-1] + half), float(y[0] - half)

    def to_png(self) -> bytes:
        """Return the figure as a PNG file."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(15.2, 8.6), dpi=DPI, facecolor="white", layout="constrained")
        (seen, height, pressure), (cut, _, words) = axes = figure.subplots(2, 3, width_ratios=[1, 1.08, 1.08])
        grid = axes[0, 0].get_gridspec()
        for each in axes[1, :2]:
            each.remove()
        cut = figure.add_subplot(grid[1, :2])
        self.draw_image(seen)
        self.draw_heights(height)
        self.draw_tractions(pressure)
        self.draw_cut(cut)
        self.draw_wrench(words)
        buffer = BytesIO()
        figure.savefig(buffer, format="png")
        return buffer.getvalue()

    def draw_image(self, axes: "Axes") -> None:
        """Draw the image that the camera sees."""
        axes.imshow(self.image[..., ::-1])
        axes.set(xticks=[], yticks=[])
        rows, cols = self.image.shape[:2]
        _set_title(axes, f"image, {cols} x {rows} pixels")

    def draw_heights(self, axes: "Axes") -> None:
        """Draw the height of the skin (blue indented, red bulging) and the edge of the contact."""
        from matplotlib.colors import TwoSlopeNorm

        z_mm = true_height_map(self.contact, self.shape, MM_PER_PX).z_mm
        ends = min(float(z_mm.min()), -0.01), max(float(z_mm.max()), 0.01)
        shown = axes.imshow(z_mm, cmap="RdBu_r", norm=TwoSlopeNorm(0, *ends), extent=self.extent_mm)
        self.draw_edge(axes)
        _add_colour_bar(axes, shown, "height (mm)")
        self.set_labels(axes, "height of the skin; line: edge of the contact")

    def draw_edge(self, axes: "Axes") -> None:
        """Draw the edge of the contact as a line."""
        pressure = true_pressure_map_mpa(self.contact, self.shape, MM_PER_PX)
        if pressure.max() > 0:
            axes.contour(*self.axes_mm, pressure > 0, [0.5], colors=INK, linewidths=0.9)

    def draw_tractions(self, axes: "Axes") -> None:
        """Draw pressure as colours, and shear as arrows coloured by stick and slip."""
        pressure = true_pressure_map_mpa(self.contact, self.shape, MM_PER_PX)
        shown = axes.imshow(np.ma.masked_equal(1e3 * pressure, 0), cmap="Blues", vmin=0, extent=self.extent_mm)
        _add_colour_bar(axes, shown, "pressure (kPa)")
        self.set_labels(axes, "pressure, and shear on the skin")
        if not pressure.any():
            return
        self.draw_arrows(axes, pressure > 0)
        here = np.nonzero(pressure)
        for zoom, axis, places in (
            (axes.set_xlim, self.axes_mm[0], here[1]),
            (axes.set_ylim, self.axes_mm[1], here[0]),
        ):
            ends = axis[places.min()] - ROUND_CONTACT_MM, axis[places.max()] + ROUND_CONTACT_MM
            zoom(*(ends if zoom == axes.set_xlim else ends[::-1]))

    def draw_arrows(self, axes: "Axes", touched: Array) -> None:
        """Draw the shear at evenly spaced points, in the colours of stick and slip."""
        from matplotlib.lines import Line2D

        rows, cols = np.nonzero(touched)
        every = max(int(np.ceil(max(np.ptp(rows), np.ptp(cols)) / ARROWS_ACROSS)), 1)
        chosen = np.zeros_like(touched)
        chosen[every // 2 :: every, every // 2 :: every] = True
        chosen &= touched
        x, y = np.meshgrid(*self.axes_mm)
        shear = 1e3 * true_shear_map_mpa(self.contact, self.shape, MM_PER_PX)[chosen]
        stuck = (
            resample_skin_field(self.contact, np.asarray(self.contact.stick_mask, np.float32), self.shape, MM_PER_PX)[
                chosen
            ]
            > 0.5
        )
        largest = max(float(np.hypot(*shear.T).max(initial=0)), 1e-6)
        look: dict[str, Any] = {
            "angles": "xy",
            "scale_units": "xy",
            "scale": largest / (2 * every * MM_PER_PX),
            "width": 0.005,
        }
        for part, colour in ((stuck, STICK), (~stuck, SLIP)):
            axes.quiver(x[chosen][part], y[chosen][part], *shear[part].T, color=colour, **look)
        entries = [Line2D([], [], color=c, label=t) for c, t in ((STICK, "sticks"), (SLIP, "slips"))]
        axes.legend(
            handles=entries, loc="upper right", fontsize=8, title=f"longest arrow {largest:.3g} kPa", title_fontsize=8
        )

    def draw_cut(self, axes: "Axes") -> None:
        """Draw skin and object along a line through the object's centre."""
        t = np.arange(-12, 12 + MM_PER_PX, MM_PER_PX)
        pose = self.contact.pose
        x, y = (np.atleast_2d(middle + t * way) for middle, way in zip((pose.x_mm, pose.y_mm), self.along, strict=True))
        skin, under = self.skin_mm(x, y)[0], self.indenter.height_over_skin_mm(pose, x, y)[0]
        axes.axhline(0, color=PALE_INK, linewidth=0.8, linestyle="dotted")
        axes.plot(t, skin, color="#2166ac", linewidth=1.8, label="skin")
        top = float(skin.max()) + ABOVE_MM
        axes.plot(t, np.ma.masked_greater(under, top), color=OBJECT, linewidth=1.4, label=self.indenter.name)
        axes.set(xlabel=f"mm from the object's centre, along {_format_direction(self.along)}", ylabel="height (mm)")
        axes.set_xlim(t[0], t[-1])
        axes.legend(loc="lower right", fontsize=9)
        axes.spines[["top", "right"]].set_visible(False)
        _set_title(axes, "cut through skin and object (heights stretched)")

    def skin_mm(self, x_mm: Float[Array, "1 n"], y_mm: Float[Array, "1 n"]) -> Array:
        """Return the height of the skin at positions of a line."""
        from ninedtact.simulation.pixel_to_skin_map import SightlineGrid

        sight = SightlineGrid(x_mm.astype(np.float32), y_mm.astype(np.float32), 0.0)
        height = np.asarray(self.contact.height_mm, np.float32)
        return sight.sample(self.contact.skin.grid, self.contact.centre_mm, height, height)

    def draw_wrench(self, axes: "Axes") -> None:
        """Draw the six components of the wrench as text."""
        axes.axis("off")
        pose, wrench = self.contact.pose, self.contact.wrench()
        lines = [
            f"{self.indenter.name}",
            f"{pose.depth_mm:.2f} mm deep at ({pose.x_mm:.2f}, {pose.y_mm:.2f}) mm",
            f"twisted {np.degrees(pose.twist_rad):.1f}°, tilted ({np.degrees(pose.tilt_x_rad):.1f}°, "
            f"{np.degrees(pose.tilt_y_rad):.1f}°)",
            "",
            *_format_press_wrench(wrench),
            "",
            f"solved to {1e3 * self.contact.residual_mm:.2g} µm in {self.contact.iterations} iterations",
        ]
        axes.text(0.02, 0.98, "\n".join(lines), va="top", family="monospace", size=11, color=INK, linespacing=1.55)

    def set_labels(self, axes: "Axes", title: str) -> None:
        """Label the axes in mm and set the title."""
        axes.set(xlabel="x (mm)", ylabel="y (mm)")
        _set_title(axes, title)


def _set_title(axes: "Axes", title: str) -> None:
    """Set a title over the left end of the axes, and make the ticks pale."""
    axes.set_title(title, loc="left", fontsize=11, color=INK)
    axes.tick_params(colors=PALE_INK, labelsize=9)


def _add_colour_bar(axes: "Axes", shown: Any, unit: str) -> None:
    figure = axes.get_figure()
    assert figure is not None
    bar = figure.colorbar(shown, ax=axes, shrink=0.8, pad=0.02, label=unit)
    bar.ax.tick_params(colors=PALE_INK, labelsize=9)


def _format_direction(along: tuple[float, float]) -> str:
    named = {(1.0, 0.0): "x", (0.0, 1.0): "y"}
    return named.get(along, f"({along[0]:.2f}, {along[1]:.2f})")


def _format_press_wrench(wrench: Wrench) -> list[str]:
    """Return lines with the six components, their units and the torque's reference point."""
    force, torque = wrench.force_n.tolist(), (1e3 * wrench.torque_nm).tolist()
    place = ", ".join(f"{part:g}" for part in wrench.about_mm.tolist())
    rows = [f"F_{axis} {f:+8.3f} N    T_{axis} {t:+8.3f} N·mm" for axis, f, t in zip("xyz", force, torque, strict=True)]
    return ["object on skin, torque about", f"({place}) mm:", *(row.replace("-", "\N{MINUS SIGN}") for row in rows)]
