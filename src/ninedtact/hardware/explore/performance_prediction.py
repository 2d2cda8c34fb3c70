"""What a sensor of one design would do: its twin pressed by a ball, its parts measured.

None of it is a measurement: light and lens are the average sensor's, carried over to the design as `simulation.designed` says;
loads are those of a linear layer, too low for deep presses (docs/mechanics.md).

The twin of a design put through what a sensor goes through: calibrated by its board and ball, then pressed by another ball.
"""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.design import SensorDesign
from ninedtact.force.traction.estimator import traction_force
from ninedtact.hardware.built_sensor import BuiltSensor
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.lens_coverage import lens_reach_mm
from ninedtact.mechanics.alternating_solver import SolverSettings
from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.indenter_primitives import Ball
from ninedtact.quantities import Frame
from ninedtact.reading import Reading
from ninedtact.shape.calibrated import CalibratedShape
from ninedtact.simulation.calibration_images import GUIDED_BOARD_MM, GUIDED_FRAMES, simulate_calibration_images
from ninedtact.simulation.ground_truth import mean_height_error_mm, true_height_map_like
from ninedtact.simulation.scripted_press import ScriptedPress
from ninedtact.simulation.twin import Twin, twin_from_design

MAX_INDENTATION_FRACTION = 0.75
"""Of the gel's thickness: deeper, the linear layer's loads mean nothing, and thin silicone tears off its ground."""
LOAD_N = 1.0
BALL_RADIUS_MM = 4.0
"""Of what presses, at every design; the published calibration's ball."""
PREDICTION_SOLVER_SETTINGS = SolverSettings(tolerance=5e-3)


@dataclass(frozen=True)
class PerformancePrediction:
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

    def to_json_dict(self) -> dict[str, Any]:
        """Plain numbers."""
        return asdict(self)


def predict_performance(design: HardwareDesign) -> PerformancePrediction:
    """Build its parts, press its twin; raises `RulesBroken`, `BoardImpossible`."""
    sensor, twin = BuiltSensor(design), twin_from_design(design.sensor)
    deepest = MAX_INDENTATION_FRACTION * design.sensor.gel.thickness_mm
    at_load = ScriptedPress(load_n=LOAD_N).on(twin, Ball(BALL_RADIUS_MM), PREDICTION_SOLVER_SETTINGS)
    at_depth = ScriptedPress(deepest).on(twin, Ball(BALL_RADIUS_MM), PREDICTION_SOLVER_SETTINGS)
    factor = twin.renderer.factor(at_load)
    return PerformancePrediction(
        depth_range_mm=deepest,
        force_range_n=float(-at_depth.wrench().force_n[2]),
        depth_at_1n_mm=float(at_load.pose.depth_mm),
        signal_per_n=float((1 - factor.min()) * _centre_grey_level(twin)),
        depth_noise_mm=_depth_noise_mm(twin),
        mm_per_px=_mm_per_px(twin),
        blur_mm=twin.renderer.light.point_spread_mm,
        view_radius_mm=lens_reach_mm(design),
        size_mm=sensor.specification.size_mm,
        ratio_mm=sensor.specification.ratio_mm,
        mass_g=sensor.specification.mass_g,
        cost_usd=sensor.specification.cost_usd,
    )


def _centre_grey_level(twin: Twin) -> float:
    """Brightness of the untouched skin in the middle."""
    rows, cols = twin.renderer.view.raw_shape
    return float(twin.renderer.untouched[rows // 2 - 20 : rows // 2 + 20, cols // 2 - 20 : cols // 2 + 20].mean())


def _depth_noise_mm(twin: Twin) -> float:
    """Noise over the slope of brightness where indentation begins."""
    return twin.renderer.noise.grey_levels / (_centre_grey_level(twin) * twin.renderer.light.darkening_per_mm)


def _mm_per_px(twin: Twin) -> float:
    """Between neighbouring pixels in the middle."""
    plane = twin.renderer.view.plane_mm
    rows, cols = twin.renderer.view.raw_shape
    across = plane[rows // 2, cols // 2 + 5] - plane[rows // 2, cols // 2 - 5]
    return float(np.hypot(*across)) / 10


VALIDATION_BALL = Ball(5.0)
DEPTH_PART, PLACE_PART = 0.5, 0.125
"""Of the gel's thickness and of the sensing area: how deep and how far off the middle the other ball is pressed."""


@dataclass(frozen=True)
class SimulatedCalibrationErrors:
    """What the calibrated twin reads of a press that it was not calibrated with."""

    depth_error_mm: float
    """Mean absolute error of the height where the skin is pressed in."""
    load_error_fraction: float
    """Error of the load by physics, of the load; the modulus is taken as designed."""


def simulate_calibration_errors(design: SensorDesign) -> SimulatedCalibrationErrors:
    """Some ten seconds; raises `BoardNotFound`, `BallRefused` where the design cannot be calibrated, and what pressing raises."""
    twin = twin_from_design(design)
    images = simulate_calibration_images(twin, design, board_depth_mm=GUIDED_BOARD_MM, frames=GUIDED_FRAMES)
    made = calibrate(CalibrationImages(**vars(images)), design)
    shape, gel = SensorFolder(Path(), made.record).shape, made.record.twin.gel if made.record.twin else design.gel
    contact = _validation_press(design).on(twin, VALIDATION_BALL)
    reading = _read_contact(shape, twin, contact)
    true = true_height_map_like(contact, reading.height, twin.renderer.light.inverse_distance_per_mm)
    load_n, read_n = (
        -wrench.force_n[2] for wrench in (contact.wrench(), traction_force(shape, gel).estimate(reading).wrench)
    )
    return SimulatedCalibrationErrors(mean_height_error_mm(true, reading.height), float(abs(read_n - load_n) / load_n))


def _validation_press(design: SensorDesign) -> ScriptedPress:
    """Off the middle, less deep than the gel bears."""
    x, y = (PLACE_PART * side for side in design.sensing_area.size_mm)
    return ScriptedPress(DEPTH_PART * design.gel.thickness_mm, at_mm=(x, -y))


def _read_contact(shape: CalibratedShape, twin: Twin, contact: Contact) -> Reading:
    """What the sensor makes of one image of this contact."""
    depth = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(-GUIDED_FRAMES, 0)))
    frame = Frame(twin.renderer(contact, 1))
    rectified = shape.rectify(frame)
    return Reading(frame, rectified, depth(rectified), reference=depth.reference)
