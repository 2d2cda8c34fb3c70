"""Predicted performance of a design: its parts are measured, and its twin is pressed by a ball, calibrated, and read.

None of it is a measurement. Light and lens are those of the average sensor, scaled to the design; loads are those of a
linear layer, which are too low for deep presses (docs/mechanics.md).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.design import SensorDesign
from ninedtact.force.traction.estimator import build_traction_force
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.indenter import Ball
from ninedtact.quantities import Frame
from ninedtact.reading import read_frame
from ninedtact.simulation.calibration_images import GUIDED_FRAMES, GUIDED_PRESSES, simulate_calibration_images
from ninedtact.simulation.ground_truth import mean_height_error_mm, true_height_map_like
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


VALIDATION_BALL = Ball(5.0)
"""Ball of the press that is read after the calibration."""
DEPTH_PART, PLACE_PART = 0.5, 0.125
"""Depth of the validation press as a fraction of the gel's thickness, and its offset as a fraction of the sensing area."""


@dataclass(frozen=True)
class CalibrationValidationErrors:
    """Errors of a calibrated twin for a press with which it was not calibrated."""

    depth_error_mm: float
    """Mean absolute error of the height where the skin is pressed in."""
    load_error_fraction: float
    """Error of the load estimated by physics, over the load; the shear modulus is taken as designed."""


def validate_simulated_calibration(design: SensorDesign) -> CalibrationValidationErrors:
    """Calibrate the twin of a design by its board and ball and read a press of another ball; takes some ten seconds.

    Raises `BoardNotFound`, `BallPressUnusable` where the design cannot be calibrated, and what pressing raises.
    """
    twin = twin_from_design(design)
    images = simulate_calibration_images(twin, design, presses=GUIDED_PRESSES, frames=GUIDED_FRAMES)
    made = calibrate(CalibrationImages(**vars(images)), design)
    shape, gel = SensorFolder(Path(), made.record).shape, made.record.twin.gel if made.record.twin else design.gel
    x, y = (PLACE_PART * side for side in design.sensing_area.size_mm)
    contact = ScriptedPress(DEPTH_PART * design.gel.thickness_mm, at_mm=(x, -y)).simulate(twin, VALIDATION_BALL)
    depth = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(-GUIDED_FRAMES, 0)))
    reading = read_frame(Frame(twin.renderer(contact, 1)), shape, depth)
    true = true_height_map_like(contact, reading.height, twin.renderer.light.inverse_distance_per_mm)
    load_n, read_n = (
        -wrench.force_n[2] for wrench in (contact.wrench(), build_traction_force(shape, gel).estimate(reading).wrench)
    )
    return CalibrationValidationErrors(mean_height_error_mm(true, reading.height), float(abs(read_n - load_n) / load_n))
