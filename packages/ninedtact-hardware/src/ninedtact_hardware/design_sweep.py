"""Design sweep: every combination of a few gels, areas and lenses, each with its predicted performance or the rule that it
breaks; and the comparison of these designs as a text table, as CSV and as a plot.
"""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from io import StringIO
from itertools import product
from math import ceil, prod
from typing import TYPE_CHECKING, Any

from ninedtact.design import SensingArea, SensorDesign, shore_a_to_shear_modulus_mpa
from ninedtact.errors import InputError, NinedtactError
from ninedtact.parallel_jobs import Workers, run_jobs
from ninedtact.shape.coloured_height_map import figure_to_png
from ninedtact_hardware.buildability import count_pins_within
from ninedtact_hardware.design import HardwareDesign, required_camera_distance_mm
from ninedtact_hardware.performance_prediction import (
    CalibrationValidationErrors,
    PerformancePrediction,
    predict_performance,
    validate_simulated_calibration,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes


AreaSize = tuple[float, float]
MAX_DESIGNS = 200
"""Largest number of designs in one sweep; a longer comparison is not readable."""
SPARE_MM = 0.1
"""Camera distance added to what the lens needs to see the corner."""


class SweepTooLarge(InputError):
    """Raised for a sweep over more than `MAX_DESIGNS` designs."""


@dataclass(frozen=True)
class DesignSweep:
    """The values of each choice; an empty tuple keeps the value of the base design."""

    gel_mm: tuple[float, ...] = ()
    """Thicknesses of the translucent gel."""
    shore_a: tuple[float, ...] = ()
    """Hardnesses of the translucent gel, Shore A."""
    area_mm: tuple[AreaSize, ...] = ()
    """Sensing areas, width and height."""
    lens_deg: tuple[float, ...] = ()
    """Angles that the lens sees in air."""

    def designs(self, basis: HardwareDesign) -> "Iterator[ExploredDesign]":
        """Yield every combination as a design that has yet to be explored; raises `SweepTooLarge`, `DesignImpossible`."""
        many = prod(max(len(values), 1) for values in vars(self).values())
        if many > MAX_DESIGNS:
            raise SweepTooLarge(f"expected at most {MAX_DESIGNS} designs, got {many}; give fewer values")
        gels, shores, lenses = self.gel_mm or (None,), self.shore_a or (None,), self.lens_deg or (None,)
        for gel, shore, area, lens in product(gels, shores, self.area_mm or (None,), lenses):
            yield ExploredDesign(change_design(basis, gel, shore, area, lens), shore)


USUAL_SWEEP = DesignSweep(gel_mm=(1.5, 2.5, 4.0), shore_a=(5.0, 15.0))
"""The designs that are compared where no value is given: the gel decides most, and needs no other camera."""


def change_design(
    basis: HardwareDesign,
    gel_mm: float | None = None,
    shore_a: float | None = None,
    area_mm: AreaSize | None = None,
    lens_deg: float | None = None,
) -> HardwareDesign:
    """Return a design with the choices that are given, its pins within the area, and its camera as far away as it must be to see
    the corner.

    Raises `DesignImpossible`.
    """
    sensor = basis.sensor
    gel, area, camera = sensor.gel, sensor.sensing_area, sensor.camera
    if gel_mm is not None:
        gel = replace(gel, thickness_mm=gel_mm)
    if shore_a is not None:
        gel = replace(gel, shear_modulus_mpa=shore_a_to_shear_modulus_mpa(shore_a))
    if area_mm is not None:
        area = replace(area, width_mm=area_mm[0], height_mm=area_mm[1])
    if lens_deg is not None:
        camera = replace(camera, lens_angle_deg=lens_deg)
    sensor = replace(_fit_pin_board(sensor, area), gel=gel, sensing_area=area, camera=camera)
    design = replace(basis, sensor=sensor)
    needed = required_camera_distance_mm(design)
    if needed <= camera.distance_mm:
        return design
    return replace(design, sensor=replace(sensor, camera=replace(camera, distance_mm=round(needed + SPARE_MM, 2))))


def _fit_pin_board(sensor: SensorDesign, area: SensingArea) -> SensorDesign:
    """Return a sensor with as many columns and rows of pins of the same pitch as fit the area, at least three."""
    board = sensor.pin_board
    if area == sensor.sensing_area:
        return sensor
    cols, rows = (max(count_pins_within(board, side), 3) for side in area.size_mm)
    return replace(sensor, pin_board=replace(board, cols=cols, rows=rows))


@dataclass(frozen=True)
class ExploredDesign:
    """One design of a sweep, and once it is explored its prediction or the reason why there is none."""

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
    candidates: Sequence[ExploredDesign], calibrated: bool = False, workers: Workers = 1
) -> Iterator[ExploredDesign]:
    """Yield the designs with their predictions, in the order of the candidates.

    calibrated: whether the twin of each is calibrated and read as well. workers: number of processes, or a cluster.
    """
    early: dict[int, ExploredDesign] = {}
    expected = 0
    for number, found in run_jobs(_explore_design, [(candidate, calibrated) for candidate in candidates], workers):
        early[number] = found
        while expected in early:
            yield early.pop(expected)
            expected += 1


def _explore_design(candidate: ExploredDesign, calibrated: bool) -> ExploredDesign:
    """Return a design with its prediction, and with `calibrated` the errors after a simulated calibration, or why there is none."""
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
    """Return the columns for which any of the designs has a value."""
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
    """Return the values of one design in columns."""
    assert each.prediction is not None
    table = each.to_json_dict()
    values = "".join(f"{_format_number(table[name]) if name in table else '-':>9}" for name in names)
    return values + "  " + " x ".join(f"{side:.1f}" for side in each.prediction.size_mm)


def _format_number(value: float) -> str:
    """Return a number with three digits."""
    return f"{value:.3f}" if value < 1 else f"{value:.2f}" if value < 10 else f"{value:.1f}"


def design_comparison_to_csv(found: Sequence[ExploredDesign]) -> bytes:
    """Return all fields of all designs as CSV."""
    rows = [_flatten_row(each.to_json_dict()) for each in found]
    names = list(dict.fromkeys(name for row in rows for name in row))
    text = StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def _flatten_row(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return one number a column: size_mm of three becomes size_mm_1, size_mm_2, size_mm_3."""
    several = {name: value for name, value in row.items() if isinstance(value, tuple | list)}
    split = {f"{name}_{number}": one for name, value in several.items() for number, one in enumerate(value, 1)}
    return {name: value for name, value in row.items() if name not in several} | split


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
    """Draw the bars of one quantity."""
    drawn = axes.barh(names, values, color="#4477aa", height=0.62)
    labels = [_format_number(value) if value else "not calibrated" for value in values]
    axes.bar_label(drawn, labels, padding=3, fontsize=8, color="#333333")
    axes.set_title(title, fontsize=10, loc="left")
    axes.margins(x=0.2)
    axes.tick_params(labelsize=8)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
