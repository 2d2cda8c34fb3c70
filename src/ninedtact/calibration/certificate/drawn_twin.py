"""The fit of mechanics and light, drawn for a person: what it leaves unexplained, and the press from the middle outwards."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.calibration.certificate.drawing import INK, PALE_INK, colour_bar, plain_axes, png, sheet
from ninedtact.calibration.record import ImprintFigures, TwinTable
from ninedtact.calibration.twin.fit import TwinFit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEAST_SCALE_GREY = 3.0
"""End of the colours at least, so that good fits look calm."""
OBSERVED, PREDICTED = "#2563eb", "#c2410c"
RING_MM = 0.1


def rest_image(fit: TwinFit) -> bytes:
    """PNG of observed minus predicted brightness in grey levels, around the contact."""
    observed, named = fit.forward.observed, fit.named
    rest = observed.image(fit.rest_grey)
    (rows, cols), mm_per_px = observed.before.grey.shape, observed.before.mm_per_px
    box = (-cols / 2 * mm_per_px, cols / 2 * mm_per_px, rows / 2 * mm_per_px, -rows / 2 * mm_per_px)
    figure, end = sheet(), max(LEAST_SCALE_GREY, float(np.nanpercentile(np.abs(rest), 99)))
    axes = plain_axes(figure, (0.13, 0.135, 0.665, 0.84), "x (mm)", "y (mm)")
    shown = axes.imshow(rest, cmap="RdBu_r", vmin=-end, vmax=end, extent=box)
    draw_drag(axes, (named["x_mm"], named["y_mm"]), fit.drag_mm)
    colour_bar(figure, shown, (0.82, 0.135, 0.025, 0.84), "darker < 0 < brighter than predicted (grey levels)")
    return png(figure)


def draw_drag(axes: "Axes", middle_mm: tuple[float, float], drag_mm: tuple[float, float]) -> None:
    """An arrow from where the ball touched to where it was dragged."""
    end, start = middle_mm, (middle_mm[0] - drag_mm[0], middle_mm[1] - drag_mm[1])
    style: dict[str, Any] = {"arrowstyle": "-|>", "color": INK, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", end, start, arrowprops=style)


def profile_image(fit: TwinFit) -> bytes:
    """PNG of the radial profile, as seen and as predicted, over the height of the fitted skin."""
    figure = sheet()
    upper = plain_axes(figure, (0.13, 0.5, 0.85, 0.475), "", "brightness (grey levels)")
    lower = plain_axes(figure, (0.13, 0.135, 0.85, 0.3), "distance from the contact's middle (mm)", "height (mm)")
    seen = (fit.forward.observed.seen - 1) * fit.forward.observed.mean_grey
    for values, colour, label in ((seen, OBSERVED, "seen"), (seen - fit.rest_grey, PREDICTED, "predicted")):
        upper.plot(*radial(fit, values), color=colour, linewidth=1.4, label=label)
    upper.legend(loc="lower right", fontsize=8, frameon=False, labelcolor=INK)
    lower.plot(*skin_cut(fit), color=INK, linewidth=1.2)
    for axes in (upper, lower):
        axes.axhline(0, color=PALE_INK, linewidth=0.6)
        axes.set_xlim(0, 8)
    return png(figure)


def radial(fit: TwinFit, values: Float[Array, " n"]) -> tuple[Float[Array, " rings"], Float[Array, " rings"]]:
    """Mean of values at the observed points by their distance from the contact's middle."""
    x, y = fit.forward.observed.points_mm
    ring = (np.hypot(x - fit.named["x_mm"], y - fit.named["y_mm"]).ravel() / RING_MM).astype(int)
    count = np.bincount(ring)
    known = np.flatnonzero(count)
    return (known + 0.5) * RING_MM, np.bincount(ring, values)[known] / count[known]


def skin_cut(fit: TwinFit) -> tuple[Float[Array, " n"], Float[Array, " n"]]:
    """Height of the fitted skin along x, from the contact's middle."""
    contact = fit.contact
    row = contact.skin.patch.rows // 2
    along, height = contact.skin.patch.place_mm[0][row], np.asarray(contact.height_mm[row], float)
    return along[along > 0], height[along > 0]


def twin_rows(twin: TwinTable) -> list[tuple[str, str]]:
    """Every parameter with its standard deviation, and what it is hardest to tell from."""
    fit = twin.fit
    rows = [
        ("unexplained, whole image", f"{fit.rmse_grey_image:.2f} grey levels"),
        ("unexplained, radial profile", f"{fit.rmse_grey_radial:.2f} grey levels"),
        ("worth independent observations", f"{fit.independent_points:.0f}"),
    ]
    if twin.imprints is not None:
        rows += imprint_rows(twin.imprints)
    for name, found in fit.parameters.items():
        sure = "" if found.deviation is None else f" ± {found.deviation:.3f}"
        beside = "" if found.closest is None else f", {found.correlation:+.2f} with {found.closest.replace('_', ' ')}"
        rows.append((name.replace("_", " "), f"{found.value:.3f}{sure}{beside}"))
    return rows


def imprint_rows(told: ImprintFigures) -> list[tuple[str, str]]:
    """What the board's image told, and whether it was taken."""
    taken = "taken into the lens" if told.believed else "not taken: the board is not as drawn"
    return [
        ("board: imprints' depth", f"{told.depth_mm:.2f} mm ± {told.depth_error_mm:.2f}, {taken}"),
        ("board: nearness per mm", f"{told.nearness_per_mm:.3f} ± {told.nearness_error_per_mm:.3f}"),
        ("board: unexplained", f"{told.unexplained_grey:.2f} of {told.contrast_grey:.1f} grey levels"),
    ]
