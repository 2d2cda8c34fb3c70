"""Heights of many images at once are those of the sensor, image by image."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

import ninedtact
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.design import Gel
from ninedtact.errors import InputError
from ninedtact.mechanics.base_deflection import BaseDeflection
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.reading import read_frame
from ninedtact.simulation.twin import default_twin
from ninedtact_train.batched.depth_reading import BatchedDepthReader

TWIN = replace(default_twin(), pitch_mm=0.4)
POSES = (Pose(depth_mm=0.3), Pose(1.0, 0.5, 0.9), Pose(-2.0, 1.0, 0.6, 0.3, 0.05))


@pytest.fixture(scope="module")
def images() -> np.ndarray:
    """Grey raw images: untouched skin, a ball pressed and dragged, and a gear."""
    ball, gear = (ninedtact.indenter_from_name(name) for name in ("ball:4", "gear_07"))
    last, shown = None, [TWIN.renderer(None)]
    for number, pose in enumerate(POSES):
        last = TWIN.press(last if number == 1 else None, gear if number == 2 else ball, pose)
        shown.append(TWIN.renderer(last.corrected, number))
    return np.stack([cv2.cvtColor(one, cv2.COLOR_BGR2GRAY) for one in shown])


@pytest.mark.parametrize("base", ["rigid", "yields"])
def test_heights_are_those_of_each_image_alone(physical_sensor: SensorFolder, images: np.ndarray, base: str) -> None:
    shape = physical_sensor.shape
    deflection = BaseDeflection(Gel(finite_strain=1.0, gel_to_base_modulus_ratio=0.1)) if base == "yields" else None
    reader = replace(shape.depth_reader(Frame(TWIN.renderer(None))), base_deflection=deflection)
    frames = [Frame(cv2.cvtColor(one, cv2.COLOR_GRAY2BGR)) for one in images]
    alone = np.stack([read_frame(one, shape, reader).height.z_mm for one in frames])
    batched = BatchedDepthReader(shape.rectify, reader)
    found = batched(torch.from_numpy(images)).numpy()
    assert np.abs(found - alone).max() < 2e-3
    assert np.sqrt(np.mean((found - alone) ** 2)) < 2e-4
    assert alone[2].min() < -0.7 and np.abs(alone[0]).max() < 0.1
    np.testing.assert_allclose(batched(torch.from_numpy(images[2:])).numpy(), found[2:], atol=1e-5)


def test_images_of_another_kind_are_refused(physical_sensor: SensorFolder) -> None:
    shape = physical_sensor.shape
    reader = shape.depth_reader(Frame(TWIN.renderer(None)))
    wanted = r"expected one or more grey images \(batch, 480, 640\) of type uint8 on cpu, got"
    with pytest.raises(InputError, match=rf"{wanted} \(1, 48, 64\)"):
        BatchedDepthReader(shape.rectify, reader)(torch.zeros(1, 48, 64))
    with pytest.raises(InputError, match=rf"{wanted} \(0, 480, 640\)"):
        BatchedDepthReader(shape.rectify, reader)(torch.zeros(0, 480, 640, dtype=torch.uint8))
    with pytest.raises(
        InputError, match="expected a calibration that knows how light scatters, got one without; calibrate"
    ):
        BatchedDepthReader(shape.rectify, replace(reader, deblurring=None))
