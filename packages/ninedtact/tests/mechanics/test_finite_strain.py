"""The corrections for finite strain against the finite elements that they came from (`benchmarks/finite_strain.py`)."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from ninedtact.design import Gel
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.finite_strain import (
    MAX_FITTED_DEPTH_OVER_THICKNESS,
    correct_for_finite_strain,
    finite_strain_ball_change_mm,
    finite_strain_height_mm,
    finite_strain_load_factor,
    finite_strain_traction_mpa,
)
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, gel_skin

THICKNESS_MM = 2.5
DEPTHS_MM = (0.5, 1.0, 1.5, 1.9)
LOADS_MM2 = {3.0: (6.80, 29.26, 76.64, 145.81), 4.0: (9.29, 43.40, 120.43, 236.00), 5.0: (12.02, 59.93, 173.16, 346.48)}
"""Of a neo-Hookean layer under balls that stick, shear modulus 1."""
SKIN_MM = {
    3.0: (0.1669, 0.1680, 0.1404, 0.1071, 0.0786, 0.0575, 0.0429, 0.0331, 0.0264),
    4.0: (0.1389, 0.2115, 0.2071, 0.1717, 0.1309, 0.0966, 0.0713, 0.0538, 0.0419),
    5.0: (-0.0704, 0.1902, 0.2516, 0.2379, 0.1945, 0.1477, 0.1093, 0.0814, 0.0622),
}
"""Height of its skin 1.5 mm deep at these distances from the axis."""
BESIDE_MM = np.arange(3.5, 7.6, 0.5)


@pytest.fixture(scope="module", params=sorted(LOADS_MM2))
def ball_mm(request):
    """The radius of a ball."""
    return request.param


@pytest.fixture(scope="module")
def presses(ball_mm):
    """The ball pressed into the linear gel, with the loads of the other one."""
    model = ContactModel(gel_skin(PeriodicGrid(128, 128, 0.2), Gel(THICKNESS_MM, 1.0, 0.5), np.zeros(())), friction=1.0)
    steps = np.arange(0.1, 1.95, 0.1).round(2)
    contacts = model.follow(Ball(ball_mm), [Pose(depth_mm=depth) for depth in steps])
    chosen = [contact for contact in contacts if contact.pose.depth_mm in DEPTHS_MM]
    return list(zip(chosen, LOADS_MM2[ball_mm], strict=True))


def linear_load(contact, pressure_mpa) -> float:
    return float(pressure_mpa.sum()) * contact.skin.grid.cell_area_mm2


def test_the_factor_makes_the_linear_load_that_of_finite_strain(presses):
    for contact, load in presses:
        factor = finite_strain_load_factor(np.float64(contact.pose.depth_mm / THICKNESS_MM))
        assert factor * linear_load(contact, contact.pressure_mpa) == pytest.approx(load, rel=0.03)


def test_the_stiffened_pressure_adds_up_to_the_load_of_finite_strain(presses):
    for contact, load in presses:
        pressure = finite_strain_traction_mpa(contact.pressure_mpa, contact.height_mm, THICKNESS_MM)
        assert linear_load(contact, pressure) == pytest.approx(load, rel=0.04)


def test_heights_beside_a_ball_are_those_of_finite_strain(presses, ball_mm):
    contact, _ = presses[DEPTHS_MM.index(1.5)]
    row = contact.skin.grid.rows // 2
    x, corrected = contact.skin.grid.positions_mm[0][row], finite_strain_height_mm(contact, THICKNESS_MM)
    linear, any_shape = (np.interp(BESIDE_MM, x, field[row]) for field in (contact.height_mm, corrected))
    tabled = linear + finite_strain_ball_change_mm(BESIDE_MM, ball_mm, 1.5, THICKNESS_MM)
    rms = [np.sqrt(np.mean((heights - SKIN_MM[ball_mm]) ** 2)) for heights in (linear, any_shape, tabled)]
    assert rms[0] > 0.008
    assert rms[1] < 0.65 * rms[0]
    assert rms[2] < 0.25 * rms[0]


def test_under_the_object_heights_are_the_linear_ones_and_around_it_the_volume_hardly_changes(presses):
    contact, _ = presses[-1]
    height, corrected = contact.height_mm, finite_strain_height_mm(contact, THICKNESS_MM)
    under = contact.pressure_mpa > 0
    assert np.array_equal(corrected[under], height[under])
    assert abs((corrected - height).sum()) < 0.1 * np.maximum(height, 0).sum()


def test_small_strain_needs_no_correction(presses):
    assert finite_strain_load_factor(np.float64(0)) == 1
    nearly_flat = np.array([[-1e-4, 0.0, 1e-4]])
    assert finite_strain_traction_mpa(np.ones((1, 3)), nearly_flat, THICKNESS_MM) == pytest.approx(1, abs=1e-6)
    contact, shallow = presses[0][0], 1e-3
    flat = replace(
        contact, height_mm=shallow * contact.height_mm, tangential_mm=shallow * np.asarray(contact.tangential_mm)
    )
    assert finite_strain_height_mm(flat, THICKNESS_MM) == pytest.approx(flat.height_mm, abs=1e-3 * shallow)
    assert np.abs(finite_strain_ball_change_mm(BESIDE_MM, 4.0, 0.0, THICKNESS_MM)).max() == 0


def test_the_table_goes_on_beyond_its_depths_and_radii():
    depths = np.linspace(1.5, 2.4, 10)
    most = [finite_strain_ball_change_mm(np.linspace(0, 10, 500), 4.0, depth, THICKNESS_MM).max() for depth in depths]
    assert (np.diff(most) > 0).all()
    for radius_mm in (1.0, 20.0):
        assert np.isfinite(finite_strain_ball_change_mm(BESIDE_MM, radius_mm, 1.0, THICKNESS_MM)).all()


def test_a_ball_above_the_skin_leaves_it_flat():
    flat = ContactModel(gel_skin(PeriodicGrid(64, 64, 0.4), Gel(THICKNESS_MM))).follow(Ball(4.0), [Pose(depth_mm=-3.0)])
    corrected = correct_for_finite_strain(next(flat), THICKNESS_MM, Ball(4.0))
    assert not corrected.height_mm.any()


def test_deeper_is_stiffer():
    assert (np.diff(finite_strain_load_factor(np.linspace(0, MAX_FITTED_DEPTH_OVER_THICKNESS, 50))) > 0).all()
    heights = np.linspace(-0.9, 0.4, 50)[None] * THICKNESS_MM
    assert (np.diff(finite_strain_traction_mpa(np.ones_like(heights), heights, THICKNESS_MM)) <= 0).all()
    assert finite_strain_traction_mpa(np.ones((1, 2)), np.array([[-1.0, 0.5]]), THICKNESS_MM)[0, 1] == 1


def test_torch_and_a_batch_get_the_same_answer(presses):
    heights, pressure = np.array([[-1.0, 0.5]]), np.array([[2.0, 0.0]])
    theirs = torch.from_numpy(heights)
    assert finite_strain_load_factor(theirs).numpy() == pytest.approx(finite_strain_load_factor(heights))
    stiffened = finite_strain_traction_mpa(torch.from_numpy(pressure), theirs, THICKNESS_MM)
    assert stiffened.numpy() == pytest.approx(finite_strain_traction_mpa(pressure, heights, THICKNESS_MM))
    two = [contact for contact, _ in presses[-2:]]
    batch = replace(
        two[0],
        **{
            name: torch.stack([torch.from_numpy(np.asarray(getattr(one, name), float)) for one in two])
            for name in ("pressure_mpa", "shear_mpa", "height_mm", "tangential_mm")
        },
    )
    for found, one in zip(finite_strain_height_mm(batch, THICKNESS_MM).numpy(), two, strict=True):
        assert found == pytest.approx(finite_strain_height_mm(one, THICKNESS_MM), abs=1e-6)
