"""Networks: places are arithmetic in the small one, and all give what they are asked for."""

from typing import get_args

import pytest
import torch

from ninedtact.errors import InputError
from ninedtact.force.network_input import InputChannels, NetworkInputSettings
from ninedtact_train.training.networks import CellWrenchSum, LabelScale, MomentsNetwork, WrenchNetwork
from ninedtact_train.training.settings import NetworkName, TrainingSettings

UNIT = (0.5, 0.5, 2.0, 0.01, 0.01, 0.003)
CELL_PX = 4


def test_the_same_touch_elsewhere_is_the_same_force_with_another_arm() -> None:
    settings = NetworkInputSettings(InputChannels.HEIGHTS, 120, 140, 0.3)
    torch.manual_seed(0)
    net = MomentsNetwork(settings, 6, UNIT, blocks=1).double().eval()
    for weights in net.cells.parameters():
        torch.nn.init.normal_(weights, std=0.1)
    images = torch.zeros(3, 1, 120, 140, dtype=torch.float64)
    touch = torch.randn(20, 24, dtype=torch.float64)
    images[1, 0, 40:60, 40:64] = touch
    down, right = 3 * CELL_PX, 7 * CELL_PX
    images[2, 0, 40 + down : 60 + down, 40 + right : 64 + right] = touch
    with torch.no_grad():
        empty, here, there = net(images).double() * torch.tensor(UNIT)
    force, torque = (here - empty)[:3], (here - empty)[3:]
    arm_m = torch.tensor([0.3 * right, 0.3 * down, 0.0], dtype=torch.float64) / 1e3
    moved = there - empty
    assert torch.allclose(moved[:3], force, atol=1e-5)
    assert torch.allclose(moved[3:], torque + torch.linalg.cross(arm_m, force), atol=1e-6)
    assert (moved[3:] - torque).abs().max() > 1e-4


def test_cells_lie_symmetric_about_the_centre_of_the_skin() -> None:
    moments = CellWrenchSum(NetworkInputSettings(), UNIT)
    everywhere = torch.zeros(1, 6, 15, 20)
    everywhere[:, 2] = 1.0
    found = moments(everywhere)[0]
    assert found[2] == pytest.approx(300) and found[3:].abs().max() < 1e-4
    assert float(moments.x_m[0, 0]) == pytest.approx(-19 / 2 * 1.2e-3)


@pytest.mark.parametrize("name", get_args(NetworkName))
def test_every_network_gives_a_wrench_and_a_scale_above_zero(name: NetworkName) -> None:
    settings = NetworkInputSettings(InputChannels.DEFORMATION, 40, 40, 0.6)
    net = WrenchNetwork(name, settings, LabelScale(UNIT, (0.0,) * 6)).eval()
    with torch.no_grad():
        wrench, scale = net(255 * torch.rand(2, 3, 40, 40))
    assert wrench.shape == scale.shape == (2, 6)
    assert torch.isfinite(wrench).all() and (scale > 0).all()


def test_labels_turn_numbers_into_newtons() -> None:
    settings = NetworkInputSettings(InputChannels.HEIGHTS, 8, 8, 3.0)
    net = WrenchNetwork("moments", settings, LabelScale((2.0,) * 6, (-1.0,) * 6), with_scale=False).eval()
    with torch.no_grad():
        (wrench,) = net(torch.rand(3, 1, 8, 8))
    assert torch.equal(wrench, torch.full((3, 6), -1.0))


@pytest.mark.usefixtures("without_type_checks")
def test_what_no_network_takes_is_refused() -> None:
    with pytest.raises(InputError, match="one of 'moments', 'densenet121', 'densenet169', got 'alexnet'"):
        TrainingSettings("alexnet")
    with pytest.raises(InputError, match="multiples of 4"):
        TrainingSettings(input=NetworkInputSettings(rows=61))
    with pytest.raises(InputError, match="32 x 32"):
        TrainingSettings("densenet121", NetworkInputSettings(rows=20))
