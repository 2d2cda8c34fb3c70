"""Force-scale calibration of a simulated sensor with simulated presses of known loads."""

from collections.abc import Iterator

from ninedtact.force.estimator_interface import ForceEstimator
from ninedtact.force.known_load_scale import (
    ForceScaleImpossible,
    KnownLoadPress,
    ScaledForceEstimator,
    estimated_load_n,
    fit_force_scale,
)
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact_train.population.sensor_population import SampledSensor

_BALL_RADIUS_MM, _START_DEPTH_MM = 5.0, 0.8
"""Radius of the simulated ball, and the depth at which the search for a load begins."""
_SIMULATED_PRESSES = ((0.0, 0.0, 1.0), (2.5, 1.5, 1.0), (0.0, 0.0, 2.5), (-2.5, -1.5, 5.0), (2.0, -1.5, 5.0))
"""Position x and y in mm and load in N of each simulated press; the loads are about 100 to 500 g."""
_PITCH_MM = 0.3
"""Pitch of the grid on which simulated presses are solved; a coarse one is enough, because a ball is smooth."""
_REFERENCE_FRAMES = 8


def calibrate_on_simulated_loads(
    estimator: ForceEstimator, member: SampledSensor, shape: CalibratedShape
) -> ForceEstimator:
    """Return the estimator with the force scale from five simulated presses of a ball with known loads.

    Where the estimator detects no contact in one of the presses, it is returned without a scale.
    """
    presses = []
    try:
        for reading, load_n in _simulate_presses(member, shape):
            estimator.forget()
            reading = reading.with_force(estimator.estimate(reading))
            presses.append(KnownLoadPress(estimated_load_n(reading), load_n))
        return ScaledForceEstimator(estimator, fit_force_scale(presses).adaptation)
    except ForceScaleImpossible:
        return estimator


def _simulate_presses(member: SampledSensor, shape: CalibratedShape) -> Iterator[tuple[Reading, float]]:
    """Yield the sensor's reading of every simulated press, and its load in N."""
    twin = member.twin(_PITCH_MM)
    depth_reader = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(-_REFERENCE_FRAMES, 0)))
    for number, (x, y, load_n) in enumerate(_SIMULATED_PRESSES):
        pose = Pose(x, y, _START_DEPTH_MM)
        ball = Ball(_BALL_RADIUS_MM)
        press = twin.press(None, ball, pose, load_n)
        reading = read_frame(Frame(twin.renderer(press.corrected, number)), shape, depth_reader)
        yield reading, float(press.load_n)
