"""Many images at once are the images drawn one by one, in NumPy and in torch."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ninedtact.mechanics.contact_model import ContactModel, SolverSettings
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.renderer import BatchRenderer
from ninedtact.simulation.twin import Twin, default_twin

POSES = [Pose(-3.0, 2.0, 1.2), Pose(6.0, -4.0, 0.6), Pose(0.0, 0.0, 1.5)]


@pytest.fixture(scope="module", params=["plain", "with glare"])
def twin(request: pytest.FixtureRequest) -> Twin:
    twin = default_twin()
    if request.param == "plain":
        return twin
    ramp = np.linspace(0, 0.5, twin.renderer.reference[..., 0].size, dtype=np.float32)
    return replace(twin, renderer=replace(twin.renderer, glare=ramp.reshape(twin.renderer.reference.shape[:2])))


@pytest.mark.parametrize(
    "like", [np.zeros((), np.float32), torch.zeros((), dtype=torch.float32)], ids=["numpy", "torch"]
)
def test_a_batch_is_drawn_as_each_alone(twin: Twin, like: object) -> None:
    skin = replace(twin.model.skin, like=like)
    model = ContactModel(skin, twin.friction, SolverSettings(tolerance=1e-4))
    batch = model.step(model.initial_contact(), Ball(4.0), Pose.stack(POSES))
    factors = np.asarray(BatchRenderer(twin.renderer, like).brightness_factors(batch))
    alone = ContactModel(twin.model.skin, twin.friction, SolverSettings(tolerance=1e-4))
    for pose, factor in zip(POSES, factors, strict=True):
        single = twin.renderer.brightness_factor(alone.step(alone.initial_contact(), Ball(4.0), pose))
        assert np.abs(factor - single).max() < 4e-3, "half a grey level, at the edge of the contact"
        assert np.abs(factor - single).mean() < 2e-4
