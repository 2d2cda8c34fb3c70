"""A force scale for a simulated sensor from simulated presses of known loads, a factor for any estimator."""

from collections.abc import Iterator

from ninedtact.calibration.force_calibration import estimated_load_n
from ninedtact.calibration.known_load_fit import ForceScaleImpossible, KnownLoadPress, fit_known_loads
from ninedtact.force.estimator_and_scale import ForceEstimator, ForceScale, ScaledForceEstimator
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
_PRESS_STD = 0.08
"""Relative error of one estimate."""
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
            presses.append(KnownLoadPress("a ball", load_n, (estimated_load_n(reading),), _PRESS_STD))
        fit = fit_known_loads(presses)
        return ScaledForceEstimator(estimator, ForceScale(fit.factor, fit.error, len(presses)))
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
