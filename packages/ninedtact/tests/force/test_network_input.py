"""A network's input is built in one place: live and in training, of NumPy and of torch, it is the same."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ninedtact.force.network_input import (
    InputChannels,
    NetworkInputBuilder,
    NetworkInputSettings,
    SensorParameterInputs,
    stack_height_channels,
    stack_image_channels,
)
from ninedtact.quantities import Frame, HeightMap, HeightSource, Rectified, centred_axis_mm
from ninedtact.reading import Reading
from ninedtact.shape.orthorectification import orthorectified_heights, orthorectify

MM_PER_PX = 0.0522


def bumpy(camera_mm: float) -> HeightMap:
    """Two dents and a bulge, off the centre."""
    x, y = np.meshgrid(centred_axis_mm(460, MM_PER_PX), centred_axis_mm(345, MM_PER_PX))
    dents = sum(
        a * np.exp(-((x - u) ** 2 + (y - v) ** 2) / 4) for a, u, v in ((-1.5, 6, 3), (-0.8, -7, -2), (0.4, 2, 5))
    )
    z_mm = np.asarray(dents, np.float32)
    return HeightMap(
        z_mm, np.full(z_mm.shape, HeightSource.MEASURED, np.uint8), MM_PER_PX, camera_distance_mm=camera_mm
    )


def test_lines_of_sight_are_undone_as_on_the_full_grid() -> None:
    settings, seen = NetworkInputSettings(), bumpy(14.0)
    exact = orthorectified_heights(orthorectify(seen), settings.grid)
    off_mm = np.abs(orthorectified_heights(seen, settings.grid) - exact)
    assert off_mm.max() < 0.02 and off_mm.mean() < 0.001
    assert np.abs(orthorectified_heights(replace(seen, camera_distance_mm=np.inf), settings.grid) - exact).max() > 0.2


@pytest.mark.parametrize(
    "channels", [InputChannels.HEIGHTS, InputChannels.HEIGHTS_AND_GEL, InputChannels.HEIGHTS_AND_SENSOR]
)
def test_heights_live_and_in_batches_of_torch_are_alike(channels: InputChannels) -> None:
    settings, traits = NetworkInputSettings(channels), SensorParameterInputs(2.2, 0.12, 0.2, 0.6, 0.1)
    live = NetworkInputBuilder(settings, traits).of_height(bumpy(14.0))
    z_mm = orthorectified_heights(bumpy(14.0), settings.grid)
    batch = stack_height_channels(torch.from_numpy(z_mm)[None], torch.from_numpy(traits.row)[None], channels)
    assert live.shape == settings.shape
    np.testing.assert_allclose(batch[0].numpy(), live, atol=1e-6)


@pytest.mark.parametrize("channels", [InputChannels.DEFORMATION, InputChannels.MIXED])
def test_images_live_and_in_batches_of_torch_are_alike(channels: InputChannels) -> None:
    rng = np.random.default_rng(0)
    images = rng.integers(40, 220, (2, 60, 80)).astype(np.uint8)
    rectified, reference = (Rectified(image.astype(np.float32), 0.3) for image in images)
    frame = Frame(np.zeros((4, 4, 3), np.uint8))
    reading = Reading(frame, rectified, bumpy(np.inf), reference=reference)
    live = NetworkInputBuilder(NetworkInputSettings(channels))(reading)
    batch = stack_image_channels(torch.from_numpy(images[:1]), torch.from_numpy(images[1:]), channels)
    np.testing.assert_array_equal(batch[0].numpy(), live)
