"""What a sensor of one design would do: its twin pressed by a ball, its parts measured.

None of it is a measurement: light and lens are the average sensor's, carried over to the design as `simulation.designed` says;
loads are those of a linear layer, too low for deep presses (docs/mechanics.md).
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.optics import reach_mm
from ninedtact.hardware.report import BuiltSensor
from ninedtact.mechanics.alternating_solver import SolverSettings
from ninedtact.mechanics.indenter_primitives import Ball
from ninedtact.simulation.designed import designed_twin
from ninedtact.simulation.press import Press
from ninedtact.simulation.twin import Twin

DEEPEST_PART = 0.75
"""Of the gel's thickness: deeper, the linear layer's loads mean nothing, and thin silicone tears off its ground."""
LOAD_N = 1.0
BALL_RADIUS_MM = 4.0
"""Of what presses, at every design; the published calibration's ball."""
ENOUGH = SolverSettings(tolerance=5e-3)


@dataclass(frozen=True)
class Prediction:
    """One row of the table."""

    depth_range_mm: float
    """How deep a ball may press."""
    force_range_n: float
    """Its load there: at least that, the layer being linear here."""
    depth_at_1n_mm: float
    """How deep a load of 1 N presses it."""
    signal_per_n: float
    """Largest darkening under that load, grey levels."""
    depth_noise_mm: float
    """Of one pixel of one image, at the skin's surface."""
    mm_per_px: float
    """Of the raw image, in the middle."""
    blur_mm: float
    """Standard deviation to which scattered light rounds edges."""
    view_radius_mm: float
    """On the skin, from the middle to where the lens ends."""
    size_mm: tuple[float, float, float]
    ratio_mm: float
    """Volume of the box over the sensing area."""
    mass_g: float
    """By assumed densities."""
    cost_usd: float
    """By estimated prices."""

    def as_table(self) -> dict[str, Any]:
        """Plain numbers."""
        return asdict(self)


def predict(design: HardwareDesign) -> Prediction:
    """Build its parts, press its twin; raises `RulesBroken`, `BoardImpossible`."""
    sensor, twin = BuiltSensor(design), designed_twin(design.sensor)
    deepest = DEEPEST_PART * design.sensor.gel.thickness_mm
    at_load = Press(load_n=LOAD_N).on(twin, Ball(BALL_RADIUS_MM), ENOUGH)
    at_depth = Press(deepest).on(twin, Ball(BALL_RADIUS_MM), ENOUGH)
    factor = twin.renderer.factor(at_load)
    return Prediction(
        depth_range_mm=deepest,
        force_range_n=float(-at_depth.wrench().force_n[2]),
        depth_at_1n_mm=float(at_load.pose.depth_mm),
        signal_per_n=float((1 - factor.min()) * middle_grey(twin)),
        depth_noise_mm=depth_noise_mm(twin),
        mm_per_px=mm_per_px(twin),
        blur_mm=twin.renderer.light.point_spread_mm,
        view_radius_mm=reach_mm(design),
        size_mm=sensor.figures.size_mm,
        ratio_mm=sensor.figures.ratio_mm,
        mass_g=sensor.figures.mass_g,
        cost_usd=sensor.figures.cost_usd,
    )


def middle_grey(twin: Twin) -> float:
    """Brightness of the untouched skin in the middle."""
    rows, cols = twin.renderer.view.raw_shape
    return float(twin.renderer.untouched[rows // 2 - 20 : rows // 2 + 20, cols // 2 - 20 : cols // 2 + 20].mean())


def depth_noise_mm(twin: Twin) -> float:
    """Noise over the slope of brightness where indentation begins."""
    return twin.renderer.noise.grey_levels / (middle_grey(twin) * twin.renderer.light.darkening_per_mm)


def mm_per_px(twin: Twin) -> float:
    """Between neighbouring pixels in the middle."""
    plane = twin.renderer.view.plane_mm
    rows, cols = twin.renderer.view.raw_shape
    across = plane[rows // 2, cols // 2 + 5] - plane[rows // 2, cols // 2 - 5]
    return float(np.hypot(*across)) / 10
