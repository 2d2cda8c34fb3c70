"""Many twins at once: each contact, wrench and image is that of the twin alone, and a refused environment is refused alone."""

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from ninedtact.design import Gel
from ninedtact.errors import DeviceError, InputError
from ninedtact.mechanics.contact_model import ContactModel, SolverSettings
from ninedtact.mechanics.contact_result import NonPositiveLoad
from ninedtact.mechanics.indenter import Ball, FlatPunch, Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.objects.catalogue import generate_object
from ninedtact.simulation.press import Press
from ninedtact.simulation.twin import Twin, default_twin
from ninedtact.simulation.twin_batch import TwinBatch

MANY, STEPS = 4, 6


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def twin() -> Twin:
    gel = Gel(finite_strain=1.0, gel_to_base_modulus_ratio=0.1)
    return replace(
        default_twin(gel=gel), pitch_mm=0.5, solver_settings=SolverSettings(tolerance=1e-3, must_converge=False)
    )


def poses_at(step: int) -> np.ndarray:
    """Down, and across with twist and tilt."""
    turn = np.arange(MANY) * 1.5
    depth_mm = np.minimum(0.3 + 0.2 * step + 0.1 * np.arange(MANY), 1.0)
    across_mm, tilt = 0.15 * step, 0.02 * step
    return np.stack(
        [
            across_mm * np.cos(turn),
            across_mm * np.sin(turn),
            depth_mm,
            0.04 * step + 0 * turn,
            tilt * np.cos(turn),
            0 * turn,
        ],
        axis=1,
    )


@pytest.mark.parametrize(
    "indenters", [[Ball(4.0)] * MANY, [Ball(3.0), FlatPunch(2.0), generate_object("gear_07"), Ball(3.0)]]
)
def test_each_environment_is_the_twin_alone(twin: Twin, indenters: list[Indenter]) -> None:
    batch, alone = TwinBatch(twin, indenters), list[Press | None]([None] * MANY)
    for step in range(STEPS):
        poses = poses_at(step)
        press = batch.step(torch.from_numpy(poses))
        wrenches, images = press.corrected.wrenches().numpy(), batch.images(press, noise=False).numpy()
        for k, indenter in enumerate(indenters):
            alone[k] = one = twin.press(alone[k], indenter, Pose(*poses[k]))
            load_n = -one.wrench.force_n[2]
            np.testing.assert_allclose(wrenches[k, :3], one.wrench.force_n, atol=0.01 * load_n)
            np.testing.assert_allclose(wrenches[k, 3:], one.wrench.torque_nm, atol=0.01 * load_n * 4e-3)
            shown = cv2.cvtColor(twin.renderer.render_without_noise(one.corrected), cv2.COLOR_BGR2GRAY)
            assert np.sqrt(np.mean((images[k] - np.rint(shown)) ** 2)) < 0.3  # both are rounded
    assert not batch.refused.any()


def test_a_load_finds_its_depth(twin: Twin) -> None:
    batch = TwinBatch(twin, [Ball(4.0)] * MANY)
    loads_n = torch.tensor([0.5, 1.0, 2.0, 4.0])
    press = batch.step(torch.from_numpy(poses_at(2)), loads_n)
    np.testing.assert_allclose(press.linear_load_n, loads_n, rtol=1e-5)
    assert (np.diff(press.pose.depth_mm) > 0).all()


def test_a_refused_environment_is_reset_alone(twin: Twin) -> None:
    batch, kept = TwinBatch(twin, [Ball(4.0)] * MANY), TwinBatch(twin, [Ball(4.0)] * MANY)
    poses = poses_at(3)
    wrong = poses.copy()
    wrong[1, 2], wrong[2, 0] = 9.0, 14.5
    press, wanted = batch.step(torch.from_numpy(wrong)), kept.step(torch.from_numpy(poses))
    assert batch.refused.tolist() == [False, True, True, False]
    found, right = (one.corrected.wrenches().numpy() for one in (press, wanted))
    assert not found[1:3].any()
    np.testing.assert_allclose(found[[0, 3]], right[[0, 3]], rtol=0.01, atol=0.01)
    press = batch.step(torch.from_numpy(poses))
    assert not batch.refused.any() and press.corrected.wrenches()[1, 2] < -0.5
    batch.reset(np.array([0]))
    lifted = batch.step(torch.from_numpy(poses * [1, 1, -1, 1, 1, 1]))
    assert not lifted.touches


def test_poses_may_lie_anyhow(twin: Twin) -> None:
    poses = poses_at(2)[:2]
    kinds = [torch.from_numpy(poses), torch.from_numpy(np.asfortranarray(poses)), poses.tolist(), poses]
    wrenches = [TwinBatch(twin, [Ball(4.0)] * 2).step(one).corrected.wrenches().numpy() for one in kinds]  # type: ignore[arg-type]
    assert all(np.array_equal(one, wrenches[0]) for one in wrenches)


def test_bad_input_is_one_sentence(twin: Twin) -> None:
    with pytest.raises(InputError, match="at least one environment"):
        TwinBatch(twin, [])
    batch = TwinBatch(twin, [Ball(4.0)] * 2)
    with pytest.raises(InputError, match="expected twin of TwinBatch to be Twin, got"):
        TwinBatch([twin, twin], [Ball(4.0)] * 2)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"expected a device of torch .*, got 'gpu' \(.*\); give another"):
        TwinBatch(twin, [Ball(4.0)] * 2, "gpu")
    with pytest.raises(InputError, match=r"finite poses .* of shape \(2, 6\), got shape \(3, 6\); correct them"):
        batch.step(torch.zeros(3, 6))
    poses = torch.zeros(2, 6)
    poses[1, 0] = torch.nan
    with pytest.raises(
        InputError, match=r"got some that are not, of environments \[1\]; correct them; nothing was stepped"
    ):
        batch.step(poses)
    with pytest.raises(InputError, match=r"expected numbers of environments from 0 to 1, got \[2\]; correct them"):
        batch.reset(np.array([2]))
    with pytest.raises(NonPositiveLoad):
        batch.step(torch.zeros(2, 6), torch.tensor([1.0, -1.0]))
    press = batch.step(torch.zeros(2, 6))
    with pytest.raises(InputError, match="expected the presses of 3 environments, got those of 2; give what `step`"):
        TwinBatch(twin, [Ball(4.0)] * 3).images(press)


def test_a_full_card_is_said_and_nothing_is_stepped(twin: Twin, monkeypatch: pytest.MonkeyPatch) -> None:
    def fill(*_: object) -> None:
        raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 9 GiB")

    batch, poses = TwinBatch(twin, [Ball(4.0)] * 2), torch.tensor([[0.0, 0.0, 0.5, 0.0, 0.0, 0.0]] * 2)
    with monkeypatch.context() as patched:
        patched.setattr(ContactModel, "solve", fill)
        with pytest.raises(
            DeviceError, match=r"room for 2 environments in the memory of cpu, got CUDA out of memory; take"
        ):
            batch.step(poses)
    found = batch.step(poses).corrected.wrenches()
    assert torch.equal(found, TwinBatch(twin, [Ball(4.0)] * 2).step(poses).corrected.wrenches())
