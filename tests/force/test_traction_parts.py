"""Laws of the parts: adjoints, the coarse problem, the descent, the law of light."""

import numpy as np
import pytest

from ninedtact.design import Gel
from ninedtact.force.traction.brightness import BEYOND, law_of
from ninedtact.force.traction.cells import Cells, cells_over
from ninedtact.force.traction.descent import Quadratic, Unknown, descended
from ninedtact.force.traction.forward import Forward
from ninedtact.force.traction.observation import roughness
from ninedtact.force.traction.prior import Prior, ShearModes
from ninedtact.force.traction.weigh import Weigh
from ninedtact.mechanics.skin import gel_skin
from ninedtact.quantities import Traction
from ninedtact.shape.depth import DepthCurve

CELLS = Cells(20, 26, 0.5)
FORWARD = Forward(CELLS, 2.5, 0.5, 0.6)
RNG = np.random.default_rng(0)


def drawn(*shape: int) -> np.ndarray:
    return RNG.standard_normal(shape).astype(np.float32)


def test_the_view_and_its_cells() -> None:
    cells = cells_over((345, 460), 0.0522)
    assert cells.rows % 2 == cells.cols % 2 == 0
    assert cells.picture_shape[1] * cells.pitch_mm == pytest.approx(24.0, rel=0.01)
    assert cells.picture_shape[0] * cells.pitch_mm == pytest.approx(18.0, rel=0.01)


def test_heights_are_those_of_the_contact_mechanics() -> None:
    tractions = np.zeros((3, *CELLS.patch.shape), np.float32)
    tractions[:, 5:9, 6:12] = drawn(3, 4, 6)
    response = gel_skin(CELLS.patch, Gel(2.5, 1.0)).response
    true = response.displaced_mm(tractions[0], tractions[1:])[0]
    np.testing.assert_allclose(FORWARD.heights(tractions[:, : CELLS.rows, : CELLS.cols]), true, atol=1e-4)


def test_pulling_back_is_the_adjoint_of_raising_and_gathering_that_of_scattering() -> None:
    tractions, skin, view = drawn(3, *CELLS.shape), drawn(*CELLS.patch.shape), drawn(*CELLS.shape)
    forth = np.vdot(FORWARD.heights(tractions), skin)
    assert forth == pytest.approx(np.vdot(tractions, FORWARD.of_view(FORWARD.pulled_back(skin))), rel=1e-3, abs=1e-2)
    assert np.vdot(FORWARD.scattered(skin), view) == pytest.approx(np.vdot(skin, FORWARD.gathered(view)), rel=1e-3)


def test_scattering_keeps_an_even_light() -> None:
    lit = FORWARD.scattered(np.ones(CELLS.patch.shape, np.float32))
    np.testing.assert_allclose(lit, 1, atol=1e-3)


def test_modes_of_shear_and_their_adjoint() -> None:
    modes = ShearModes(CELLS, Prior())
    weights, field = drawn(2, modes.count), drawn(2, *CELLS.shape)
    assert np.vdot(modes.ratio(weights), field) == pytest.approx(np.vdot(weights, modes.weighed(field)), rel=1e-3)


def test_modes_have_the_variance_of_the_prior() -> None:
    modes = ShearModes(CELLS, Prior())
    drawn_ratios = np.stack([modes.ratio(drawn(2, modes.count)) for _ in range(400)])
    assert drawn_ratios.std() == pytest.approx(np.hypot(Prior().pull, Prior().spread), rel=0.1)


def test_the_law_of_light_goes_through_the_knots_and_on_beyond() -> None:
    curve = DepthCurve("ratio", (0.0, 0.1, 0.3), (0.0, 1.0, 2.0), (0.0,) * 3, (0.0, 0.4), (0.0, 1.0))
    law = law_of(curve)
    seen = law(np.float32([-2 * BEYOND, -2, -1, 0, 0.5, 1]))
    np.testing.assert_allclose(seen, [-0.7, -0.3, -0.1, 0, 0.2, 0.4], atol=1e-6)
    np.testing.assert_allclose(law.slope_per_mm(np.float32([-1.5, -0.5, 0.5])), [0.2, 0.1, 0.4], atol=1e-6)


def test_descent_finds_the_lowest_point_that_is_not_negative() -> None:
    root, wanted = drawn(20, 12), np.abs(drawn(12))
    wanted[::3] = 0
    hessian = root.T @ root / 20 + 0.1 * np.eye(12, dtype=np.float32)
    push = np.where(wanted > 0, 0, -1).astype(np.float32)
    down = hessian @ wanted + push
    weights = np.zeros((2, 1), np.float32)

    def times(at: Unknown) -> Unknown:
        return Unknown((hessian @ at.pressure.ravel()).reshape(3, 4), at.weights)

    begin = Unknown(np.zeros((3, 4), np.float32), weights)
    problem = Quadratic(times, Unknown(down.reshape(3, 4), weights), lambda slope: slope, np.ones((3, 4), np.float32))
    found = descended(problem, begin, 200, 1e-5)
    np.testing.assert_allclose(found.at.pressure.ravel(), wanted, atol=1e-3)


def test_a_common_level_weighs_little() -> None:
    weigh = Weigh(np.full((8, 8), 10, np.float32), 100.0)
    assert np.abs(weigh(np.ones((8, 8), np.float32))).max() < 1e-2


def test_roughness_is_the_noise_whatever_is_smooth_below() -> None:
    x = np.linspace(0, 3, 60)
    field = (np.sin(x) + drawn(50, 60) * 0.01).astype(np.float32)
    assert roughness(field) == pytest.approx(0.01, rel=0.15)


def test_shear_on_pressed_skin_has_an_arm() -> None:
    push = np.zeros((2, 8, 8), np.float32)
    push[0] = 1e-2
    flat = Traction(np.zeros((8, 8), np.float32), push, 0.5)
    sunk = Traction(np.zeros((8, 8), np.float32), push, 0.5, height_mm=np.full((8, 8), -1, np.float32))
    assert flat.wrench().torque_nm[1] == 0
    assert sunk.wrench().torque_nm[1] == pytest.approx(-flat.wrench().force_n[0] / 1e3)
