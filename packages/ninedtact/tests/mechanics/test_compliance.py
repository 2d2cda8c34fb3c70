"""Gel on a rigid base, in closed form; on a base that yields, by solving; what must be true of both."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact.design import Gel
from ninedtact.mechanics.layer_compliance import (
    Compliance,
    bonded_layer_compliance,
    gel_compliance,
    half_space_compliance,
)

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
@given(gels, st.floats(0.1, 20))
def test_gel_on_a_base_of_the_same_gel_is_one_layer(gel, base_mm):
    """Also the closed form against the four-by-four solution, which finds the same layer cut at any depth."""
    both = replace(gel, base_thickness_mm=base_mm, gel_to_base_modulus_ratio=1.0)
    whole = replace(gel, thickness_mm=gel.thickness_mm + base_mm)
    k = np.array([0.0, 0.05, 0.2, 1.0, 4.0, 30.0]) / whole.thickness_mm
    found, one = gel_compliance(k, both), bonded_layer_compliance(k, whole)
    for name in ("normal", "along", "across", "coupling"):
        np.testing.assert_allclose(getattr(found, name), getattr(one, name), atol=1e-8 * float(one.along[0]))


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


def test_a_base_becomes_rigid_as_it_stiffens_and_only_then():
    gel, softest = Gel(2.5, 0.1, 0.5, base_thickness_mm=4.0, gel_to_base_modulus_ratio=0.0), []
    for ratio in (1, 0.1, 1e-3, 1e-6):
        found = gel_compliance(WAVES, replace(gel, gel_to_base_modulus_ratio=ratio))
        assert np.all(found.normal >= bonded_layer_compliance(WAVES, gel).normal * (1 - 1e-9))
        softest.append(found.normal[2])
    assert softest == sorted(softest, reverse=True)
    assert_same(found, gel_compliance(WAVES, gel), 1e-5)
