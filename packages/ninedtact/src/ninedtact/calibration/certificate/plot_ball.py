"""Plots of the ball press for the certificate: the contact disc, the depth curve through its pixels, and the reconstructed ball;
for the twin, the residual of the fit of mechanics and light, and the radial profile of the press. Each plot is returned as a PNG.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from ninedtact.calibration.ball.ball_press import BallPress
from ninedtact.calibration.certificate.plot_board import (
    INK,
    PALE_INK,
    add_colour_bar,
    add_labelled_axes,
    new_certificate_figure,
    stretch_contrast,
)
from ninedtact.calibration.procedure import Calibration
from ninedtact.calibration.twin.ball_press_fit import TwinFit
from ninedtact.quantities import Rectified
from ninedtact.shape.coloured_height_map import figure_to_png
from ninedtact.shape.depth import BrightnessSignal, DepthCurve

if TYPE_CHECKING:
    from matplotlib.axes import Axes


CIRCLE = "#ffb000"
CURVE = "#c2410c"
AXIS_COLOURS = {"x": "#d62f1f", "y": "#0f8a4c"}
DARKENING: dict[BrightnessSignal, str] = {
    "ratio": "1 \N{MINUS SIGN} I/I₀ (fraction of the reference brightness)",
    "difference": "I₀ \N{MINUS SIGN} I (grey levels)",
}
"""Names of the signals that the two methods use."""
MIN_PIXELS_PER_SPOT = 0.3
"""Number of pixels per spot of the scatter plot that would be drawn white; it is below one, so that a single pixel
remains visible.
"""
MIN_ERROR_SCALE_MM = 0.1
"""Smallest end of the residual map's colours, so that plots of good calibrations are comparable and pale."""


def _image_extent_mm(image: Rectified) -> tuple[float, float, float, float]:
    """Return left, right, bottom and top of a rectified image in mm, y downwards."""
    rows, cols = image.grey.shape
    half_width_mm = cols / 2 * image.mm_per_px
    half_height_mm = rows / 2 * image.mm_per_px
    return -half_width_mm, half_width_mm, half_height_mm, -half_height_mm


def plot_contact_disc(calibration: Calibration) -> bytes:
    """Return a PNG of the rectified ball image with the contact circle and its centre."""
    press = calibration.ball.press
    figure = new_certificate_figure()
    axes = add_labelled_axes(figure, (0.13, 0.135, 0.85, 0.84), "x (mm)", "y (mm)")
    axes.imshow(stretch_contrast(press.after.grey), cmap="gray", vmin=0, vmax=255, extent=_image_extent_mm(press.after))
    _plot_contact_circle(axes, press, CIRCLE)
    axes.plot(*press.centre_mm, "+", color=CIRCLE, markersize=9, markeredgewidth=1.2)
    return figure_to_png(figure)


def _plot_contact_circle(axes: "Axes", press: BallPress, colour: str) -> None:
    from matplotlib.patches import Circle

    axes.add_patch(Circle(press.centre_mm, press.edge_radius_mm, fill=False, edgecolor=colour, linewidth=1.4))


def plot_depth_curve(calibration: Calibration) -> bytes:
    """Return a PNG of the depth curve over all pixels of the disc, with the band of their scatter."""
    from matplotlib.colors import LogNorm

    curve = calibration.ball.curve
    mean_reference_grey = float(calibration.ball.press.before.grey[calibration.ball.disc].mean())
    figure = new_certificate_figure()
    axes = add_labelled_axes(
        figure, (0.13, 0.135, 0.85, 0.725), f"darkening {DARKENING[curve.signal]}", "thinning of the gel (mm)"
    )
    ball = calibration.ball
    loss = ball.loss(ball.press.after.grey, ball.press.before.grey)
    shades: dict[str, Any] = {"cmap": "Blues", "norm": LogNorm(vmin=MIN_PIXELS_PER_SPOT)}
    axes.hexbin(
        ball.press.darkening(curve.signal, ball.disc, loss),
        ball.thinning_mm[ball.disc],
        gridsize=(70, 40),
        mincnt=1,
        **shades,
    )
    _plot_curve_with_band(axes, curve)
    _add_other_signal_axis(axes, curve.signal, mean_reference_grey)
    axes.set(xlim=(0, 1.06 * curve.darkening[-1]), ylim=(0, 1.06 * curve.max_indentation_mm))
    axes.legend(loc="lower right", fontsize=8, frameon=False, labelcolor=INK)
    return figure_to_png(figure)


def _plot_curve_with_band(axes: "Axes", curve: DepthCurve) -> None:
    """Draw the curve, the band of its scatter, and the end of its range."""
    at, depth_mm, error_mm = (np.array(values) for values in (curve.darkening, curve.indentation_mm, curve.error_mm))
    band: dict[str, Any] = {
        "color": CURVE,
        "alpha": 0.22,
        "linewidth": 0,
        "label": "scatter of the pixels (± standard deviation)",
    }
    axes.fill_between(at, depth_mm - error_mm, depth_mm + error_mm, **band)
    axes.plot(at, depth_mm, color=CURVE, linewidth=1.6, label="the sensor's curve")
    axes.axhline(
        curve.max_indentation_mm, color=PALE_INK, linewidth=0.8, linestyle=(0, (4, 3)), label="end of the range"
    )


def _add_other_signal_axis(axes: "Axes", signal: BrightnessSignal, mean_grey: float) -> None:
    """Add an axis at the top for the other method's signal, where the reference image has the disc's mean brightness."""
    other: BrightnessSignal = "ratio" if signal == "difference" else "difference"
    factor = mean_grey if signal == "ratio" else 1 / mean_grey
    top = axes.secondary_xaxis("top", functions=(lambda at: np.multiply(at, factor), lambda at: np.divide(at, factor)))
    top.set_xlabel(f"{DARKENING[other]} where I₀ = {mean_grey:.0f}", color=PALE_INK, fontsize=8)
    top.tick_params(colors=PALE_INK, labelsize=8, width=0.6, length=3)


def plot_ball_residual(calibration: Calibration) -> bytes:
    """Return a PNG of the reconstructed ball minus the true one, in mm: too deep is positive."""
    ball = calibration.ball
    error_mm = np.where(ball.disc, _reconstruct_ball_mm(calibration) + ball.height_mm, np.nan)
    scale_mm = max(MIN_ERROR_SCALE_MM, float(np.nanpercentile(np.abs(error_mm), 99)))
    figure = new_certificate_figure()
    axes = add_labelled_axes(figure, (0.13, 0.135, 0.665, 0.84), "x (mm)", "y (mm)")
    extent_mm = _image_extent_mm(ball.press.before)
    image = axes.imshow(error_mm, cmap="RdBu_r", vmin=-scale_mm, vmax=scale_mm, extent=extent_mm)
    _plot_contact_circle(axes, ball.press, INK)
    x, y = ball.press.centre_mm
    reach_mm = 1.25 * ball.press.edge_radius_mm
    axes.set(xlim=(x - reach_mm, x + reach_mm), ylim=(y + reach_mm, y - reach_mm))
    add_colour_bar(figure, image, (0.82, 0.135, 0.025, 0.84), "too shallow < 0 < too deep (mm)")
    return figure_to_png(figure)


def _reconstruct_ball_mm(calibration: Calibration) -> Float32[Array, "rows cols"]:
    """Return the depth of the ball as reconstructed by the calibrated sensor, filters included."""
    fit = calibration.ball
    return fit.reader(fit.press.before, calibration.rectify.height_source)(fit.press.after).indentation_mm


def plot_ball_cross_sections(calibration: Calibration) -> bytes:
    """Return a PNG of two sections through the centre of the ball, as pressed and as reconstructed."""
    press = calibration.ball.press
    reconstructed_mm = _reconstruct_ball_mm(calibration)
    column, row = np.rint(press.circle.centre_px).astype(int)
    figure = new_certificate_figure()
    axes = add_labelled_axes(figure, (0.13, 0.135, 0.85, 0.84), "distance from the ball's centre (mm)", "depth (mm)")
    for name, centre, section in (("x", column, np.s_[row, :]), ("y", row, np.s_[:, column])):
        depth_mm = reconstructed_mm[section]
        distance_mm = (np.arange(depth_mm.size) - centre) * press.before.mm_per_px
        axes.plot(distance_mm, depth_mm, color=AXIS_COLOURS[name], linewidth=1.3, label=f"reconstructed along {name}")
        axes.plot(distance_mm, -calibration.ball.height_mm[section], color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
    axes.plot([], [], color=INK, linewidth=0.9, linestyle=(0, (4, 3)), label="the ball")
    reach_mm = 1.6 * press.edge_radius_mm
    axes.set(
        xlim=(-reach_mm, reach_mm),
        ylim=(1.1 * calibration.ball.max_indentation_mm, -0.08 * calibration.ball.max_indentation_mm),
    )
    axes.legend(loc="upper center", fontsize=8, frameon=False, labelcolor=INK)
    return figure_to_png(figure)


MIN_SCALE_GREY_LEVELS = 3.0
"""Smallest end of the colours, so that plots of good fits are pale."""
OBSERVED = "#2563eb"
PREDICTED = "#c2410c"
RING_WIDTH_MM = 0.1


def plot_twin_residual(fit: TwinFit) -> bytes:
    """Return a PNG of observed minus predicted brightness in grey levels, around the contact."""
    observed = fit.problem.observed
    residual = observed.image(fit.residual_grey_levels)
    scale = max(MIN_SCALE_GREY_LEVELS, float(np.nanpercentile(np.abs(residual), 99)))
    figure = new_certificate_figure()
    axes = add_labelled_axes(figure, (0.13, 0.135, 0.665, 0.84), "x (mm)", "y (mm)")
    extent_mm = _image_extent_mm(observed.before)
    image = axes.imshow(residual, cmap="RdBu_r", vmin=-scale, vmax=scale, extent=extent_mm)
    _plot_drag_arrow(axes, fit.press.centre_mm, fit.press.drag_mm)
    add_colour_bar(figure, image, (0.82, 0.135, 0.025, 0.84), "darker < 0 < brighter than predicted (grey levels)")
    return figure_to_png(figure)


def _plot_drag_arrow(axes: "Axes", end_mm: tuple[float, float], drag_mm: tuple[float, float]) -> None:
    """Draw an arrow from where the ball touched to where it was dragged."""
    start_mm = end_mm[0] - drag_mm[0], end_mm[1] - drag_mm[1]
    style: dict[str, Any] = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end_mm, start_mm, arrowprops=style)


def plot_radial_profile(fit: TwinFit) -> bytes:
    """Return a PNG of the radial profile, observed and predicted, above the height of the fitted skin."""
    figure = new_certificate_figure()
    upper = add_labelled_axes(figure, (0.13, 0.5, 0.85, 0.475), "", "brightness (grey levels)")
    lower = add_labelled_axes(
        figure, (0.13, 0.135, 0.85, 0.3), "distance from the contact's centre (mm)", "height (mm)"
    )
    observed = (fit.problem.observed.relative_brightness - 1) * fit.problem.observed.mean_grey
    predicted = observed - fit.residual_grey_levels
    for values, colour, label in ((observed, OBSERVED, "observed"), (predicted, PREDICTED, "predicted")):
        upper.plot(*fit.radial_profile(values, RING_WIDTH_MM), color=colour, linewidth=1.4, label=label)
    upper.legend(loc="lower right", fontsize=8, frameon=False, labelcolor=INK)
    lower.plot(*_skin_cross_section(fit), color=INK, linewidth=1.2)
    for axes in (upper, lower):
        axes.axhline(0, color=PALE_INK, linewidth=0.6)
        axes.set_xlim(0, 8)
    return figure_to_png(figure)


def _skin_cross_section(fit: TwinFit) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Return the height of the fitted skin along x, from the contact's centre."""
    contact = fit.contact
    row = contact.skin.grid.rows // 2
    x_mm = contact.skin.grid.positions_mm[0][row]
    height_mm = np.asarray(contact.height_mm[row], float)
    return x_mm[x_mm > 0], height_mm[x_mm > 0]
