"""Sensors side by side as one HTML page: their figures, depth curves, lenses and reference images."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.certificate.html_page import render_page_with_images
from ninedtact.calibration.certificate.plot_board import INK, add_labelled_axes, new_certificate_figure
from ninedtact.calibration.sensor_comparison import SensorComparison
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.shape.coloured_height_map import figure_to_png

_BOX = (0.13, 0.135, 0.85, 0.84)
_RING_MM = 0.5
"""Width of the rings about the middle of the skin over which the scale of the lens is averaged."""


def render_comparison_html(comparison: SensorComparison) -> str:
    """Return the page as one self-contained HTML document: images are embedded, and nothing is loaded or executed."""
    from matplotlib import rc_context

    with rc_context({"text.parse_math": False}):  # a name such as a$b$ is no formula
        images = {
            "curves": _plot_depth_curves(comparison),
            "lens": _plot_lens_scales(comparison),
            "light": _plot_reference_images(comparison),
        }
    return render_page_with_images(
        "comparison.html.jinja",
        {name: content for name, content in images.items() if content is not None},
        comparison=comparison,
    )


def _plot_depth_curves(comparison: SensorComparison) -> bytes | None:
    """Return a PNG of the depth curves with their errors, against the fraction of brightness that is lost; None without any."""
    shown = [
        (name, sensor.depth.curve)
        for name, sensor in zip(comparison.names, comparison.sensors, strict=True)
        if sensor.record.depth is not None and sensor.depth.curve.signal == "ratio"
    ]
    if not shown:
        return None
    figure = new_certificate_figure()
    axes = add_labelled_axes(figure, _BOX, "darkening (% of the reference brightness)", "thinning of the gel (mm)")
    for name, curve in shown:
        depth_mm, error_mm = np.array(curve.indentation_mm), np.array(curve.error_mm)
        (line,) = axes.plot(100 * np.array(curve.darkening), depth_mm, linewidth=1.6, label=name)
        axes.fill_between(
            100 * np.array(curve.darkening),
            depth_mm - error_mm,
            depth_mm + error_mm,
            color=line.get_color(),
            alpha=0.18,
            linewidth=0,
        )
    axes.set(xlim=(0, None), ylim=(0, None))
    axes.legend(loc="lower right", fontsize=8, frameon=False, labelcolor=INK)
    return figure_to_png(figure)


def _plot_lens_scales(comparison: SensorComparison) -> bytes:
    """Return a PNG of the raw pixels per millimetre of skin, from the middle outwards."""
    figure = new_certificate_figure()
    axes = add_labelled_axes(figure, _BOX, "distance from the middle of the skin (mm)", "raw pixels per mm of skin")
    for name, sensor in zip(comparison.names, comparison.sensors, strict=True):
        axes.plot(*_lens_scale(sensor), linewidth=1.6, label=name)
    axes.legend(loc="lower left", fontsize=8, frameon=False, labelcolor=INK)
    return figure_to_png(figure)


def _lens_scale(sensor: SensorFolder) -> tuple[Float[Array, " rings"], Float[Array, " rings"]]:
    """Return the distance from the middle in mm and the mean number of raw pixels per mm there."""
    rectification = sensor.rectification
    down, right = (
        np.linalg.norm(part, axis=-1) for part in np.gradient(rectification.source_px.astype(float), axis=(0, 1))
    )
    rows, cols = down.shape
    y, x = np.mgrid[:rows, :cols]
    distance_mm = np.hypot(y - (rows - 1) / 2, x - (cols - 1) / 2) * rectification.mm_per_px
    ring = (distance_mm / _RING_MM).astype(int)
    count = np.bincount(ring.ravel())
    scale = np.bincount(ring.ravel(), ((down + right) / 2).ravel()) / np.maximum(count, 1)
    seen = count > 0
    return ((np.arange(len(count)) + 0.5) * _RING_MM)[seen], (scale / rectification.mm_per_px)[seen]


def _plot_reference_images(comparison: SensorComparison) -> bytes | None:
    """Return a PNG of the rectified reference images on one scale of grey; None where no sensor has one."""
    found = [(name, sensor.reference_grey) for name, sensor in zip(comparison.names, comparison.sensors, strict=True)]
    shown: Sequence[tuple[str, Float[Array, "rows cols"]]] = [(name, grey) for name, grey in found if grey is not None]
    if not shown:
        return None
    columns = min(len(shown), 3)
    lines = -(-len(shown) // columns)
    figure = new_certificate_figure(0.85 * lines / columns)
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.01, top=1 - 0.16 / lines, wspace=0.05, hspace=0.15)
    for number, (name, grey) in enumerate(shown, 1):
        axes = figure.add_subplot(lines, columns, number)
        axes.imshow(grey, cmap="gray", vmin=0, vmax=255)
        axes.set_title(name, fontsize=8, color=INK)
        axes.set_axis_off()
    return figure_to_png(figure)
