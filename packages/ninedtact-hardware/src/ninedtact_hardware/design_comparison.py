"""Comparison of the designs of a sweep by their predicted performance, as a text table."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from ninedtact.errors import NinedtactError
from ninedtact.parallel_jobs import Workers, run_jobs
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.performance_prediction import PerformancePrediction, predict_performance


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

    @property
    def name(self) -> str:
        """Gel thickness, hardness, area and lens angle, which distinguish it from the others."""
        sensor = self.design.sensor
        hard = f"A{self.shore_a:g}" if self.shore_a is not None else f"{sensor.gel.shear_modulus_mpa:.3f} MPa"
        area = f"{sensor.sensing_area.width_mm:g}x{sensor.sensing_area.height_mm:g}"
        return f"{sensor.gel.thickness_mm:g} mm, {hard}, {area}, {sensor.camera.lens_angle_deg:g}°"

    def to_json_dict(self) -> dict[str, Any]:
        """Return choices and prediction as a dictionary that JSON can hold."""
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
            **(asdict(self.prediction) if self.prediction else {}),
        }


def explore_designs(
    candidates: Sequence[tuple[HardwareDesign, float | None]], workers: Workers = 1
) -> Iterator[tuple[int, ExploredDesign]]:
    """Yield the number of every candidate and the design with its predictions, in the order in which they are done.

    workers: number of processes, or a cluster.
    """
    return run_jobs(_explore_design, candidates, workers)


def _explore_design(design: HardwareDesign, shore_a: float | None) -> ExploredDesign:
    """Return a design with its prediction, or with why there is none."""
    try:
        return ExploredDesign(design, shore_a, predict_performance(design))
    except NinedtactError as refusal:
        return ExploredDesign(design, shore_a, refusal=str(refusal))


PREDICTION_COLUMNS = (
    ("depth_range_mm", "deep mm"),
    ("force_range_n", "load N"),
    ("signal_per_n", "grey/N"),
    ("depth_noise_mm", "noise mm"),
    ("mm_per_px", "mm/px"),
    ("blur_mm", "blur mm"),
    ("view_radius_mm", "view mm"),
    ("ratio_mm", "D/A mm"),
    ("cost_usd", "cost $"),
)
"""Field and heading of each predicted quantity."""
NAME_WIDE = 34


def format_design_comparison(found: Sequence[ExploredDesign]) -> Iterator[str]:
    """Yield the comparison as lines of text."""
    yield f"{'design':{NAME_WIDE}}" + "".join(f"{heading:>9}" for _, heading in PREDICTION_COLUMNS) + "  size mm"
    for each in found:
        shown = f" refused: {each.refusal}" if each.prediction is None else _format_prediction(each.prediction)
        yield f"{each.name:{NAME_WIDE}}{shown}"


def _format_prediction(prediction: PerformancePrediction) -> str:
    values = "".join(f"{_format_number(getattr(prediction, name)):>9}" for name, _ in PREDICTION_COLUMNS)
    return values + "  " + " x ".join(f"{side:.1f}" for side in prediction.size_mm)


def _format_number(value: float) -> str:
    return f"{value:.3f}" if value < 1 else f"{value:.2f}" if value < 10 else f"{value:.1f}"
