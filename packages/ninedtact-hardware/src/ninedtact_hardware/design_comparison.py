"""Comparison of the designs of a sweep by their predicted performance, as a text table: the parts of each design are measured, and
its twin is pressed by a ball.

None of it is a measurement. Light and lens are those of the average sensor, scaled to the design; loads are those of a
linear layer, which are too low for deep presses (docs/mechanics.md).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.indenter import Ball
from ninedtact.parallel_jobs import Workers, run_jobs
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import Twin, twin_from_design
from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.design import HardwareDesign, lens_view_radius_mm

MAX_INDENTATION_FRACTION = 0.75
"""Greatest indentation over gel thickness. Deeper, the loads of a linear layer mean nothing, and thin silicone tears
off its substrate."""
LOAD_N = 1.0
BALL_RADIUS_MM = 4.0
"""Radius of the pressing ball for every design: that of the published calibration."""
PREDICTION_SOLVER_SETTINGS = SolverSettings(tolerance=5e-3)


class PerformancePrediction:
    """One row of the comparison: the parts of a design are built, and its twin is pressed; raises `DesignNotBuildable`."""

    def __init__(self, design: HardwareDesign) -> None:
        sensor, twin = BuildableDesign(design), twin_from_design(design.sensor)
        self.depth_range_mm = MAX_INDENTATION_FRACTION * design.sensor.gel.thickness_mm
        """Greatest indentation by the ball."""
        at_load, at_depth = (
            press.simulate(twin, Ball(BALL_RADIUS_MM), PREDICTION_SOLVER_SETTINGS)
            for press in (ScriptedPress(load_n=LOAD_N), ScriptedPress(self.depth_range_mm))
        )
        light, grey = twin.renderer.light, _centre_grey_level(twin)
        self.force_range_n = float(-at_depth.wrench().force_n[2])
        """Load at that indentation; the true load is at least as large, since the layer is linear here."""
        self.depth_at_1n_mm = float(at_load.pose.depth_mm)
        """Indentation under a load of 1 N."""
        self.signal_per_n = float((1 - twin.renderer.brightness_factor(at_load).min()) * grey)
        """Largest darkening under that load, in grey levels."""
        # The noise over the slope of the brightness where indentation begins.
        self.depth_noise_mm = twin.renderer.noise.grey_levels / (grey * light.darkening_per_mm)
        """Depth noise of one pixel of one image, at the skin's surface."""
        self.mm_per_px = _mm_per_px(twin)
        """Resolution of the raw image in the middle."""
        self.blur_mm = light.point_spread_mm
        """Standard deviation of the blur by scattered light."""
        self.view_radius_mm = lens_view_radius_mm(design)
        """Radius on the skin that the lens sees."""
        self.size_mm = sensor.specification.size_mm
        self.ratio_mm = sensor.specification.ratio_mm
        """Volume of the box over the sensing area."""
        self.mass_g = sum(body.mass_g for body in sensor.bodies)
        """Mass by assumed densities."""
        self.cost_usd = sensor.specification.cost_usd
        """Cost by estimated prices."""


def _centre_grey_level(twin: Twin) -> float:
    rows, cols = twin.renderer.pixel_map.raw_shape
    return float(twin.renderer.reference[rows // 2 - 20 : rows // 2 + 20, cols // 2 - 20 : cols // 2 + 20].mean())


def _mm_per_px(twin: Twin) -> float:
    plane = twin.renderer.pixel_map.plane_mm
    rows, cols = twin.renderer.pixel_map.raw_shape
    across = plane[rows // 2, cols // 2 + 5] - plane[rows // 2, cols // 2 - 5]
    return float(np.hypot(*across)) / 10


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
            **(vars(self.prediction) if self.prediction else {}),
        }


def explore_designs(
    candidates: Sequence[tuple[HardwareDesign, float | None]], workers: Workers = 1
) -> Iterator[tuple[int, ExploredDesign]]:
    """Yield the number of every candidate and the design with its predictions, in the order in which they are done.

    workers: number of processes, or a cluster.
    """
    return run_jobs(_explore_design, candidates, workers)


def _explore_design(design: HardwareDesign, shore_a: float | None) -> ExploredDesign:
    try:
        return ExploredDesign(design, shore_a, PerformancePrediction(design))
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
