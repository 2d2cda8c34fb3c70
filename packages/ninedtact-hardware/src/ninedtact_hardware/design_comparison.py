"""Comparison of the designs of a sweep by their predicted performance, as a text table and as a plot."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from math import ceil
from typing import TYPE_CHECKING, Any

from ninedtact.errors import NinedtactError
from ninedtact.parallel_jobs import Workers, run_jobs
from ninedtact.shape.coloured_height_map import figure_to_png
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.performance_prediction import (
    CalibrationValidationErrors,
    PerformancePrediction,
    predict_performance,
    validate_simulated_calibration,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class ExploredDesign:
    """One design of a sweep with its prediction, or the reason why there is none."""

    design: HardwareDesign
    """The design, its camera moved away if the lens would not see the corner."""
    shore_a: float | None = None
    """Hardness of the gel, if it was given as Shore A."""
    prediction: PerformancePrediction | None = None
    refusal: str | None = None
    """Why the design cannot be built, or why its twin cannot be pressed."""
    calibration_errors: CalibrationValidationErrors | None = None
    """Errors of its twin after a simulated calibration, if that was requested."""
    calibration_failure: str | None = None
    """Why the simulated calibration failed."""

    @property
    def name(self) -> str:
        """Gel thickness, hardness, area and lens angle, which distinguish it from the others."""
        sensor = self.design.sensor
        hard = f"A{self.shore_a:g}" if self.shore_a is not None else f"{sensor.gel.shear_modulus_mpa:.3f} MPa"
        area = f"{sensor.sensing_area.width_mm:g}x{sensor.sensing_area.height_mm:g}"
        return f"{sensor.gel.thickness_mm:g} mm, {hard}, {area}, {sensor.camera.lens_angle_deg:g}°"

    def to_json_dict(self) -> dict[str, Any]:
        """Return choices, prediction and errors as a dictionary that JSON can hold."""
        sensor = self.design.sensor
        return {
            "gel_mm": sensor.gel.thickness_mm,
            "shear_modulus_mpa": sensor.gel.shear_modulus_mpa,
            "area_mm": sensor.sensing_area.size_mm,
            "lens_deg": sensor.camera.lens_angle_deg,
            "distance_mm": sensor.camera.distance_mm,
            "shore_a": self.shore_a,
            "pins": (sensor.pin_board.cols, sensor.pin_board.rows),
            "refusal": self.refusal,
            "calibration_failure": self.calibration_failure,
            **(asdict(self.prediction) if self.prediction else {}),
            **(asdict(self.calibration_errors) if self.calibration_errors else {}),
        }


def explore_designs(
    candidates: Sequence[tuple[HardwareDesign, float | None]], calibrated: bool = False, workers: Workers = 1
) -> Iterator[tuple[int, ExploredDesign]]:
    """Yield the number of every candidate and the design with its predictions, in the order in which they are done.

    calibrated: whether the twin of each is calibrated and read as well. workers: number of processes, or a cluster.
    """
    return run_jobs(_explore_design, [(*candidate, calibrated) for candidate in candidates], workers)


def _explore_design(design: HardwareDesign, shore_a: float | None, calibrated: bool) -> ExploredDesign:
    """Return a design with its prediction, and with `calibrated` the errors after a simulated calibration, or why there is none."""
    candidate = ExploredDesign(design, shore_a)
    try:
        found = replace(candidate, prediction=predict_performance(candidate.design))
    except NinedtactError as refusal:
        return replace(candidate, refusal=str(refusal))
    if not calibrated:
        return found
    try:
        return replace(found, calibration_errors=validate_simulated_calibration(found.design.sensor))
    except NinedtactError as refusal:
        return replace(found, calibration_failure=str(refusal))


PREDICTION_COLUMNS = (
    ("depth_range_mm", "deep mm", "depth range, mm"),
    ("force_range_n", "load N", "force range, N"),
    ("signal_per_n", "grey/N", "signal at 1 N, grey levels"),
    ("depth_noise_mm", "noise mm", "depth noise of a pixel, mm"),
    ("mm_per_px", "mm/px", "mm per pixel"),
    ("blur_mm", "blur mm", "blur, mm"),
    ("view_radius_mm", "view mm", "radius of view, mm"),
    ("ratio_mm", "D/A mm", "volume over area, mm"),
    ("cost_usd", "cost $", "cost, $ (estimated)"),
)
"""Field, heading and title of each predicted quantity."""
CALIBRATION_COLUMNS = (
    ("depth_error_mm", "err mm", "error of depth after calibration, mm"),
    ("load_error_fraction", "err load", "error of the load by physics, of the load"),
)
"""Field, heading and title of the errors after a simulated calibration."""
NAME_WIDE = 34


def _columns_of(found: Sequence[ExploredDesign]) -> tuple[tuple[str, str, str], ...]:
    calibrated = any(each.calibration_errors for each in found)
    return PREDICTION_COLUMNS + CALIBRATION_COLUMNS if calibrated else PREDICTION_COLUMNS


def format_design_comparison(found: Sequence[ExploredDesign]) -> Iterator[str]:
    """Yield the comparison as lines of text."""
    shown = _columns_of(found)
    yield f"{'design':{NAME_WIDE}}" + "".join(f"{heading:>9}" for _, heading, _ in shown) + "  size mm"
    for each in found:
        names = [name for name, _, _ in shown]
        yield f"{each.name:{NAME_WIDE}}" + (
            _format_design_values(each, names) if each.prediction else f" refused: {each.refusal}"
        )
        if each.calibration_failure:
            yield f"{'':{NAME_WIDE}} not calibrated: {each.calibration_failure}"


def _format_design_values(each: ExploredDesign, names: Sequence[str]) -> str:
    assert each.prediction is not None
    table = each.to_json_dict()
    values = "".join(f"{_format_number(table[name]) if name in table else '-':>9}" for name in names)
    return values + "  " + " x ".join(f"{side:.1f}" for side in each.prediction.size_mm)


def _format_number(value: float) -> str:
    return f"{value:.3f}" if value < 1 else f"{value:.2f}" if value < 10 else f"{value:.1f}"


def plot_design_comparison(found: Sequence[ExploredDesign]) -> bytes:
    """Return a PNG with one panel of bars for each quantity and one bar for each design."""
    # matplotlib is slow to import, and only this function needs it; its global state is never touched.
    from matplotlib.figure import Figure

    possible, shown = [each for each in found if each.prediction], _columns_of(found)
    tall = 0.55 * ceil(len(shown) / 3) * (1 + 0.55 * max(len(possible), 2))
    drawn = Figure(figsize=(14, tall), dpi=110, facecolor="white", layout="constrained")
    panels = drawn.subplots(ceil(len(shown) / 3), 3, sharey=True, squeeze=False).ravel()
    tables = [each.to_json_dict() for each in possible]
    for axes, (name, _, title) in zip(panels, shown, strict=False):
        _draw_bars(axes, [each.name for each in possible], [table.get(name, 0.0) for table in tables], title)
    panels[0].invert_yaxis()
    for spare in panels[len(shown) :]:
        spare.axis("off")
    return figure_to_png(drawn)


def _draw_bars(axes: "Axes", names: list[str], values: list[float], title: str) -> None:
    drawn = axes.barh(names, values, color="#4477aa", height=0.62)
    labels = [_format_number(value) if value else "not calibrated" for value in values]
    axes.bar_label(drawn, labels, padding=3, fontsize=8, color="#333333")
    axes.set_title(title, fontsize=10, loc="left")
    axes.margins(x=0.2)
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
