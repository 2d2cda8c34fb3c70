"""Wrenches of many images at once are those of the sensor's own estimator, image by image, with their errors and warnings."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

import ninedtact
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.errors import InputError
from ninedtact.force.estimator_and_scale import ForceScale, NoForceEstimator, ScaledForceEstimator
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.reading import read_frame
from ninedtact.simulation.twin import default_twin
from ninedtact_train.batched.depth_reading import BatchedDepthReader
from ninedtact_train.batched.force_by_physics import BatchedPhysics
from ninedtact_train.batched.linearised_problem import solve_nonnegative_qps

TWIN = replace(default_twin(), pitch_mm=0.4)
PRESSES = (
    ("ball:4", Pose(depth_mm=0.3), Pose(0.3, depth_mm=0.4)),
    ("ball:8", Pose(-2, 1, 0.8), Pose(-2, 0.5, 0.9, 0.1)),
    ("gear_07", Pose(2, -1, 0.5), Pose(2, -1, 0.6, 0.2, 0.02)),
    ("punch:3", Pose(11, 6, 0.5), Pose(11.2, 6, 0.6)),
    ("ball:2", Pose(depth_mm=1.8), Pose(depth_mm=2.3)),
)
"""Objects pressed and dragged: light, wide, of many cells, partly out of view, and deeper than the model holds."""


@pytest.fixture(scope="module")
def images() -> list[np.ndarray]:
    """Raw images: untouched skin, and the presses."""
    shown = [TWIN.renderer(None)]
    for number, (name, *poses) in enumerate(PRESSES):
        press = None
        for pose in poses:
            press = TWIN.press(press, ninedtact.indenter_from_name(name), pose)
        assert press is not None
        shown.append(TWIN.renderer(press.corrected, number))
    return shown


def test_wrenches_are_those_of_each_image_alone(physical_sensor: SensorFolder, images: list[np.ndarray]) -> None:
    shape, physics = physical_sensor.shape, physical_sensor.estimator("physics")
    physics = ScaledForceEstimator(physics.estimator, ForceScale(1.2, 0.1, 5, 0.8, 0.05))
    reader = shape.depth_reader(Frame(images[0]))
    batched = BatchedPhysics(BatchedDepthReader(shape.rectify, reader), physics)
    grey = torch.from_numpy(np.stack([cv2.cvtColor(one, cv2.COLOR_BGR2GRAY) for one in images]))
    found, doubts = batched(grey), []
    for number, image in enumerate(images):
        physics.forget()
        alone = physics.estimate(read_frame(Frame(image), shape, reader))
        load_n = max(-alone.wrench.six[2], 0.1)
        assert np.abs(found.wrenches[number].numpy() - alone.wrench.six).max() < 1e-3 * load_n
        np.testing.assert_allclose(found.covariance[number], alone.covariance, rtol=0.02, atol=1e-4 * load_n**2)
        np.testing.assert_allclose(found.std[number], alone.std, rtol=5e-3)
        assert bool(found.touching[number]) == alone.touching == (number > 0)
        doubts.append(bool(alone.warnings))
    assert found.doubtful.tolist() == doubts and {True, False} <= set(doubts)
    again = batched(grey[[2, 0, 1]])
    assert (again.wrenches - found.wrenches[[2, 0, 1]]).abs().max() < 1e-3
    assert (found.wrenches[0] == 0).all()


def test_a_programme_without_a_minimum_does_not_count_as_converged() -> None:
    curvature = torch.stack([torch.eye(3), torch.diag(torch.tensor([1.0, -1.0, 1.0]))]).double()
    target, free = torch.ones(2, 3, dtype=torch.float64), torch.ones(2, 3, dtype=torch.bool)
    solution = solve_nonnegative_qps(curvature, target, free, bounded=2, stop_early=True)
    assert solution.converged.tolist() == [True, False]
    assert solution.x[0].tolist() == [1.0, 1.0, 1.0]


def test_another_estimator_is_refused(physical_sensor: SensorFolder, images: list[np.ndarray]) -> None:
    reader = BatchedDepthReader(physical_sensor.shape.rectify, physical_sensor.shape.depth_reader(Frame(images[0])))
    with pytest.raises(InputError, match="expected the estimator by physics of a calibrated sensor, got 'no force'"):
        BatchedPhysics(reader, ScaledForceEstimator(NoForceEstimator(), ForceScale()))
