"""The same answer alone, in any batch, in NumPy and in torch."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from gels import BALL, DOUBLE, GEL, model

from ninedtact.mechanics import numpy_or_torch_arrays
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Cone, LyingCylinder
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, gel_skin

BEGUN = [Pose(depth_mm=0.8), Pose(3.0, -2.0, 0.4, 0.3), Pose(depth_mm=-0.2), Pose(1.0, 2.0, 1.2, 0.0, 0.1, -0.05)]
MOVED = [Pose(0.3, 0.1, 0.8), Pose(3.0, -1.8, 0.5, 0.5), Pose(depth_mm=0.3), Pose(1.2, 2.0, 1.2, 0.1, 0.05, 0.0)]
TORCH = torch.zeros((), dtype=torch.float64)
TIGHT = SolverSettings(tolerance=1e-6, min_tolerance_mm=1e-8)
GRID = PeriodicGrid(40, 45, 0.45)


def alone(like: Any) -> list[Contact]:
    pressing = model(like=like, grid=GRID, settings=TIGHT)
    return [list(pressing.follow(BALL, poses))[-1] for poses in zip(BEGUN, MOVED, strict=True)]


def together(like: Any, settings: SolverSettings = TIGHT) -> list[Contact]:
    pressing = model(like=like, grid=GRID, settings=settings)
    return list(pressing.follow(BALL, [Pose.stack(BEGUN), Pose.stack(MOVED)]))[-1].unstack()


def assert_same(found: list[Contact], wanted: list[Contact], tolerance: float) -> None:
    for one, other in zip(found, wanted, strict=True):
        assert one.pose == other.pose
        np.testing.assert_allclose(one.wrench().six, other.wrench().six, atol=10 * tolerance)
        np.testing.assert_allclose(np.asarray(one.height_mm), np.asarray(other.height_mm), atol=tolerance)
        np.testing.assert_allclose(np.asarray(one.shear_mpa), np.asarray(other.shear_mpa), atol=tolerance)


@pytest.fixture(scope="module", autouse=True)
def one_thread() -> Iterator[None]:
    """So small arrays are not shared out."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def reference() -> list[Contact]:
    return alone(DOUBLE)


@pytest.mark.parametrize("found", [lambda: together(DOUBLE), lambda: alone(TORCH), lambda: together(TORCH)])
def test_alone_or_together_in_numpy_or_torch(reference, found):
    assert_same(found(), reference, 5e-6)


def test_single_precision_is_as_good_as_its_tolerance(reference):
    for like in (np.zeros((), np.float32), torch.zeros((), dtype=torch.float32)):
        rough = together(like, SolverSettings(tolerance=1e-3))
        for one, other in zip(rough, reference, strict=True):
            assert one.pressure_mpa.dtype == like.dtype
            np.testing.assert_allclose(one.wrench().force_n, other.wrench().force_n, atol=0.02)


def test_who_lifts_off_in_a_batch_leaves_the_skin_untouched():
    pressing = model(grid=GRID, settings=SolverSettings(tolerance=1e-4))
    down = pressing.step(pressing.initial_contact(), BALL, Pose(depth_mm=np.array([0.6, 0.8])))
    lifted, pressed = pressing.step(down, BALL, Pose(x_mm=0.2, depth_mm=np.array([-0.3, 0.8]))).unstack()
    assert pressed.touches
    assert not lifted.touches
    assert not lifted.shear_mpa.any()
    np.testing.assert_allclose(lifted.height_mm, 0, atol=1e-12)


def test_who_is_done_waits_for_nobody_and_is_not_changed_by_it(monkeypatch: pytest.MonkeyPatch) -> None:
    depths, pressing = np.geomspace(1e-4, 1.5, 12), model(grid=GRID, settings=TIGHT)
    poses = Pose(np.linspace(0, 1, 12), 0.0, depths, np.linspace(0, 0.5, 12)), Pose(np.linspace(0, 1, 12), 0.2, depths)
    found = []
    for fewest in (100, 1):
        monkeypatch.setattr(numpy_or_torch_arrays, "MIN_CONTACTS_TO_SPLIT", fewest)
        found.append(list(pressing.follow(BALL, poses))[-1])
    waited, halved = found
    assert waited.iterations.tolist() == halved.iterations.tolist()
    assert waited.iterations.max() > 4 * np.median(waited.iterations), "some work long after others are done"
    assert_same(halved.unstack(), waited.unstack(), 1e-9)


def test_windows_of_their_own_in_one_batch_answer_as_each_alone() -> None:
    skin, random = gel_skin(GRID, GEL, DOUBLE), np.random.default_rng(0)
    windows = [(slice(2, 18), slice(5, 21)), (slice(10, 34), slice(20, 28))]
    inside, tractions = np.zeros((2, *GRID.shape)), np.zeros((2, 2, *GRID.shape))
    for k, window in enumerate(windows):
        inside[k][window] = 1
        tractions[k][(..., *window)] = random.normal(size=tractions[k][(..., *window)].shape)
    whole = replace(skin.operators, inside=inside)
    slid, sunk = whole.tangential_from_shear_mm(tractions), whole.indentation_from_pressure_mm(tractions[:, 0])
    for k, window in enumerate(windows):
        part, cut = skin.cropped_operators(*inside[k][window].shape), (..., *window)
        np.testing.assert_allclose(slid[k][cut], part.tangential_from_shear_mm(tractions[k][cut]), atol=1e-12)
        np.testing.assert_allclose(sunk[k][cut], part.indentation_from_pressure_mm(tractions[k, 0][cut]), atol=1e-12)
        assert not slid[k][:, inside[k] == 0].any()


def test_tilted_undersides_do_not_depend_on_how_far_others_are_tilted() -> None:
    x, y = GRID.positions_mm
    poses = [Pose(twist_rad=0.3, tilt_x_rad=0.02), Pose(depth_mm=0.4, tilt_y_rad=-0.5), Pose(1.0, tilt_x_rad=0.2)]
    for indenter in (Cone(), LyingCylinder()):
        together = indenter.height_over_skin_mm(Pose.stack(poses), x, y)
        np.testing.assert_array_equal(together, [indenter.height_over_skin_mm(pose, x, y) for pose in poses])
