"""A calibrated twin for all tests.

A torchvision that was built for CUDA does not load beside a torch for CPUs; LeRobot needs no operator that it misses.
"""

import sys

import pytest
import torch

import ninedtact
from ninedtact.simulation.calibration_images import simulate_calibration_images

try:
    import torchvision  # noqa: F401
except RuntimeError:
    for name in [name for name in sys.modules if name.partition(".")[0] == "torchvision"]:
        del sys.modules[name]
    operators = torch.library.Library("torchvision", "DEF")
    for name in ("nms", "qnms"):
        operators.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")


@pytest.fixture(scope="session")
def sensor_folder(tmp_path_factory: pytest.TempPathFactory) -> str:
    images = ninedtact.CalibrationImages(**vars(simulate_calibration_images(ninedtact.default_twin(), frames=4)))
    folder = tmp_path_factory.mktemp("twin") / "sensor"
    return str(ninedtact.save_sensor(folder, ninedtact.calibrate(images)).path)
