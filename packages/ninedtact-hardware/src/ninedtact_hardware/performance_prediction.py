"""Predicted performance of a design: its parts are measured, and its twin is pressed by a ball.

None of it is a measurement. Light and lens are those of the average sensor, scaled to the design; loads are those of a
linear layer, which are too low for deep presses (docs/mechanics.md).
"""

from dataclasses import dataclass

import numpy as np

from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.indenter import Ball
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import Twin, twin_from_design
from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.lens_view import lens_view_radius_mm

MAX_INDENTATION_FRACTION = 0.75
"""Greatest indentation over gel thickness. Deeper, the loads of a linear layer mean nothing, and thin silicone tears
off its substrate."""
LOAD_N = 1.0
BALL_RADIUS_MM = 4.0
"""Radius of the pressing ball for every design: that of the published calibration."""
PREDICTION_SOLVER_SETTINGS = SolverSettings(tolerance=5e-3)


@dataclass(frozen=True)
class PerformancePrediction:
    """One row of the comparison."""

    depth_range_mm: float
    """Greatest indentation by the ball."""
    force_range_n: float
    """Load at that indentation; the true load is at least as large, since the layer is linear here."""
    depth_at_1n_mm: float
    """Indentation under a load of 1 N."""
    signal_per_n: float
    """Largest darkening under that load, in grey levels."""
    depth_noise_mm: float
    """Depth noise of one pixel of one image, at the skin's surface."""
    mm_per_px: float
    """Resolution of the raw image in the middle."""
    blur_mm: float
    """Standard deviation of the blur by scattered light."""
    view_radius_mm: float
    """Radius on the skin that the lens sees."""
    size_mm: tuple[float, float, float]
    ratio_mm: float
    """Volume of the box over the sensing area."""
    mass_g: float
    """Mass by assumed densities."""
    cost_usd: float
    """Cost by estimated prices."""


def predict_performance(design: HardwareDesign) -> PerformancePrediction:
    """Build the parts of a design and press its twin; raises `DesignNotBuildable`."""
    sensor, twin = BuildableDesign(design), twin_from_design(design.sensor)
    deepest = MAX_INDENTATION_FRACTION * design.sensor.gel.thickness_mm
    at_load = ScriptedPress(load_n=LOAD_N).simulate(twin, Ball(BALL_RADIUS_MM), PREDICTION_SOLVER_SETTINGS)
    at_depth = ScriptedPress(deepest).simulate(twin, Ball(BALL_RADIUS_MM), PREDICTION_SOLVER_SETTINGS)
    factor, grey = twin.renderer.brightness_factor(at_load), _centre_grey_level(twin)
    return PerformancePrediction(
        depth_range_mm=deepest,
        force_range_n=float(-at_depth.wrench().force_n[2]),
        depth_at_1n_mm=float(at_load.pose.depth_mm),
        signal_per_n=float((1 - factor.min()) * grey),
        # The noise over the slope of the brightness where indentation begins.
        depth_noise_mm=twin.renderer.noise.grey_levels / (grey * twin.renderer.light.darkening_per_mm),
        mm_per_px=_mm_per_px(twin),
        blur_mm=twin.renderer.light.point_spread_mm,
        view_radius_mm=lens_view_radius_mm(design),
        size_mm=sensor.specification.size_mm,
        ratio_mm=sensor.specification.ratio_mm,
        mass_g=sum(body.mass_g for body in sensor.bodies),
        cost_usd=sensor.specification.cost_usd,
    )


def _centre_grey_level(twin: Twin) -> float:
    rows, cols = twin.renderer.pixel_map.raw_shape
    return float(twin.renderer.reference[rows // 2 - 20 : rows // 2 + 20, cols // 2 - 20 : cols // 2 + 20].mean())


def _mm_per_px(twin: Twin) -> float:
    plane = twin.renderer.pixel_map.plane_mm
    rows, cols = twin.renderer.pixel_map.raw_shape
    across = plane[rows // 2, cols // 2 + 5] - plane[rows // 2, cols // 2 - 5]
    return float(np.hypot(*across)) / 10
