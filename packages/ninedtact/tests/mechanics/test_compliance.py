"""One layer on a rigid base, in closed form; any stack, by solving; what must be true of both."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact.design import Gel
from ninedtact.mechanics.layer_compliance import (
    Compliance,
    _layer_amplitudes,
    _layer_states,
    bonded_layer_compliance,
    half_space_compliance,
    layered_compliance,
)
from ninedtact.mechanics.skin import PeriodicGrid

# From a program written apart from this one, h = 2.5, G = 1: k, ν, N, L, M, each to its last printed digit.
TABLE = [
    (0.01, 0.50, 0.00052025, 2.49739882, 0.0312109822),
    (0.1, 0.50, 0.04682381, 2.26645551, 0.277453962),
    (0.3, 0.50, 0.23424238, 1.35095951, 0.418768922),
    (1, 0.50, 0.39450035, 0.45150642, 0.0712575951),
    (2, 0.50, 0.24862168, 0.24907359, 0.00112976653),
    (5, 0.50, 0.10000000, 0.10000000, 8.6799e-10),
    (0.3, 0.45, 0.37431413, None, 0.31047828),
    (5, 0.45, 0.11, None, -0.01),
]
WAVES = np.array([0.0, 0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0])

gels = st.builds(Gel, st.floats(0.3, 10), st.floats(0.01, 10), st.floats(0, 0.5))


def assert_same(found: Compliance, wanted: Compliance, tolerance: float) -> None:
    """Each part to the tolerance, as a part of the softest answer to that wave."""
    for name, field in vars(found).items():
        assert np.all(np.abs(field - getattr(wanted, name)) <= tolerance * wanted.across), name


@pytest.mark.parametrize(("k", "nu", "normal", "along", "coupling"), TABLE)
def test_the_layer_has_the_published_values(k, nu, normal, along, coupling):
    found = bonded_layer_compliance(np.array([float(k)]), Gel(2.5, 1.0, nu))
    assert found.normal[0] == pytest.approx(normal, abs=5.1e-9)
    assert along is None or found.along[0] == pytest.approx(along, abs=5.1e-9)
    assert found.coupling[0] == pytest.approx(coupling, rel=5e-6, abs=1e-13)
    assert found.across[0] == pytest.approx(np.tanh(2.5 * k) / k, rel=1e-12)


@settings(max_examples=40, deadline=None)
@given(gels)
def test_the_closed_form_is_the_four_by_four_solution(gel):
    k = np.array([0.0, 0.05, 0.2, 1.0, 4.0, 30.0]) / gel.thickness_mm
    assert_same(layered_compliance((gel,))(k), bonded_layer_compliance(k, gel), 1e-9)


@settings(max_examples=20, deadline=None)
@given(gels, gels)
def test_shear_raises_as_much_as_pressure_spreads(upper, lower):
    """Reciprocity, which the four-by-four solution does not assume: W under unit shear is U under unit pressure."""
    k = np.array([0.1, 1.0, 5.0])
    skin = _layer_states(k, upper, upper.thickness_mm)[:, :2] @ _layer_amplitudes(k, (upper, lower))[:, :4]
    assert np.all(np.abs(skin[:, 0, 0] - skin[:, 1, 1]) <= 1e-9 * skin[:, 0, 1])


def test_incompressible_is_the_limit_of_nearly_so_and_a_mean_pressure_does_not_move_it():
    nearly, exactly = (bonded_layer_compliance(WAVES, Gel(2.5, 0.1, nu)) for nu in (0.5 - 1e-9, 0.5))
    assert_same(nearly, exactly, 1e-7)
    assert exactly.normal[0] == exactly.coupling[0] == 0
    assert exactly.along[0] == exactly.across[0] == pytest.approx(25)


def test_long_waves_squeeze_an_incompressible_layer_like_a_film():
    k, gel = np.geomspace(1e-6, 1e-2, 30), Gel(2.5, 0.1, 0.5)
    film = gel.thickness_mm**3 * k**2 / (3 * gel.shear_modulus_mpa)
    np.testing.assert_allclose(bonded_layer_compliance(k, gel).normal, film, rtol=2e-3)
    assert np.all(
        np.diff(bonded_layer_compliance(np.linspace(0.001, 0.02, 500), gel).normal) > 0
    )  # no step between the two forms


def test_a_deep_layer_is_a_half_space():
    gel = Gel(1000.0, 0.1, 0.45)
    assert_same(bonded_layer_compliance(WAVES[2:], gel), half_space_compliance(WAVES[2:], gel), 1e-12)


def test_a_stack_of_one_gel_is_one_layer():
    found = layered_compliance((Gel(1.0, 0.1, 0.5), Gel(0.7, 0.1, 0.5), Gel(0.8, 0.1, 0.5)))(WAVES)
    assert_same(found, bonded_layer_compliance(WAVES, Gel(2.5, 0.1, 0.5)), 1e-9)


def test_a_stack_becomes_a_rigid_base_as_the_lower_layer_stiffens_and_only_then():
    gel, softest = Gel(2.5, 0.1, 0.5), []
    for stiffer in (1, 10, 1e3, 1e6):
        found = layered_compliance((gel, Gel(4.0, 0.1 * stiffer, 0.5)))(WAVES)
        assert np.all(found.normal >= bonded_layer_compliance(WAVES, gel).normal * (1 - 1e-9))
        softest.append(found.normal[2])
    assert softest == sorted(softest, reverse=True)
    assert_same(found, bonded_layer_compliance(WAVES, gel), 1e-5)


def test_the_base_bears_what_the_skin_bears():
    """Force and torque of what reaches the base, by another part of the solution, are those put on the skin."""
    # Compressible: in a gel that keeps its volume pressure from shear falls off as slowly as 1/r, too far for any grid.
    grid, random, gel = PeriodicGrid(96, 80, 0.4), np.random.default_rng(0), Gel(1.2, 0.1, 0.3)
    tractions = np.zeros((3, *grid.shape))
    tractions[:, 40:52, 36:50] = random.normal(size=(3, 12, 14))
    (x, y), base = grid.positions_mm, base_tractions(grid, gel, tractions)
    np.testing.assert_allclose(wrench(x, y, 0, tractions), wrench(x, y, -gel.thickness_mm, base), atol=1e-2)


def base_tractions(grid: PeriodicGrid, gel: Gel, tractions: np.ndarray) -> np.ndarray:
    """(σ_xz, σ_yz, σ_zz) on the base under (q_x, q_y, −p) on the skin."""
    (e_x, e_y), k = grid.wave_directions, np.hypot(*grid.wave_vectors)
    k[0, 0] = 1e-3  # a long wave in place of the mean, which is set below
    loads = _layer_amplitudes(k.ravel(), (gel,))
    through = (_layer_states(k.ravel(), gel, 0.0)[:, 2:] @ loads).reshape(*k.shape, 2, 2) * k[..., None, None]
    q_x, q_y, s_zz = waves = np.fft.rfft2(tractions)
    along, across = e_x * q_x + e_y * q_y, (e_x * q_y - e_y * q_x) / np.cosh(k * gel.thickness_mm)
    down = through[..., 0, 0] * s_zz - 1j * through[..., 0, 1] * along
    drawn = 1j * (through[..., 1, 0] * s_zz - 1j * through[..., 1, 1] * along)
    base = np.stack([e_x * drawn - e_y * across, e_y * drawn + e_x * across, down])
    base[:, 0, 0] = waves[:, 0, 0]
    return np.fft.irfft2(base, s=grid.shape)


def wrench(x: np.ndarray, y: np.ndarray, z: float, tractions: np.ndarray) -> np.ndarray:
    """Sums of tractions and of their torques about the middle of the skin."""
    t_x, t_y, t_z = tractions
    torque = (y * t_z - z * t_y).sum(), (z * t_x - x * t_z).sum(), (x * t_y - y * t_x).sum()
    return np.array([t_x.sum(), t_y.sum(), t_z.sum(), *torque])


def test_a_grid_of_waves_of_any_shape_is_answered():
    k = WAVES.reshape(2, 4)
    for compliance in (
        bonded_layer_compliance(k, Gel()),
        layered_compliance((Gel(), Gel()))(k),
        half_space_compliance(k, Gel()),
    ):
        assert {field.shape for field in vars(compliance).values()} == {(2, 4)}
        assert all(np.isfinite(field).all() for field in vars(compliance).values())
