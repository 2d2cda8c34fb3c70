"""The corrections for finite strain against the finite elements that they came from (`benchmarks/finite_strain.py`)."""

import numpy as np
import pytest
import torch

from ninedtact.design import Gel
from ninedtact.mechanics.contact_model import (
    MAX_FITTED_DEPTH_OVER_THICKNESS,
    ContactModel,
    finite_strain_height_mm,
    finite_strain_load_factor,
    finite_strain_traction_mpa,
)
from ninedtact.mechanics.indenter_primitives import Ball
from ninedtact.mechanics.periodic_grid import PeriodicGrid
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.surface_displacement import gel_skin

THICKNESS_MM = 2.5
DEPTHS_MM = (0.5, 1.0, 1.5, 1.9)
LOADS_MM2 = {3.0: (6.80, 29.26, 76.64, 145.81), 4.0: (9.29, 43.40, 120.43, 236.00), 5.0: (12.02, 59.93, 173.16, 346.48)}
"""Of a neo-Hookean layer under balls that stick, shear modulus 1."""
BULGES_MM = {
    3.0: (0.0253, 0.0868, 0.1732, 0.2529),
    4.0: (0.0318, 0.1088, 0.2158, 0.3146),
    5.0: (0.0379, 0.1287, 0.2531, 0.3668),
}


@pytest.fixture(scope="module", params=sorted(LOADS_MM2))
def presses(request):
    """A ball pressed into the linear gel, with loads and bulges of the other one."""
    model = ContactModel(gel_skin(PeriodicGrid(128, 128, 0.2), Gel(THICKNESS_MM, 1.0, 0.5), np.zeros(())), friction=1.0)
    steps = np.arange(0.1, 1.95, 0.1).round(2)
    contacts = model.follow(Ball(request.param), [Pose(depth_mm=depth) for depth in steps])
    chosen = [contact for contact in contacts if contact.pose.depth_mm in DEPTHS_MM]
    return list(zip(chosen, LOADS_MM2[request.param], BULGES_MM[request.param], strict=True))


def linear_load(contact, pressure_mpa) -> float:
    return float(pressure_mpa.sum()) * contact.skin.grid.cell_area_mm2


def test_the_factor_makes_the_linear_load_that_of_finite_strain(presses):
    for contact, load, _ in presses:
        factor = finite_strain_load_factor(np.float64(contact.pose.depth_mm / THICKNESS_MM))
        assert factor * linear_load(contact, contact.pressure_mpa) == pytest.approx(load, rel=0.03)


def test_the_stiffened_pressure_adds_up_to_the_load_of_finite_strain(presses):
    for contact, load, _ in presses:
        pressure = finite_strain_traction_mpa(contact.pressure_mpa, contact.height_mm, THICKNESS_MM)
        assert linear_load(contact, pressure) == pytest.approx(load, rel=0.04)


def test_raised_bulges_are_nearer_to_those_of_finite_strain(presses):
    linear = [contact.height_mm.max() / bulge - 1 for contact, _, bulge in presses]
    raised = [
        finite_strain_height_mm(contact.height_mm, THICKNESS_MM).max() / bulge - 1 for contact, _, bulge in presses
    ]
    assert np.abs(raised).max() < 0.09
    assert np.abs(raised).mean() < 0.7 * np.abs(linear).mean()


def test_small_strain_needs_no_correction():
    assert finite_strain_load_factor(np.float64(0)) == 1
    nearly_flat = np.array([[-1e-4, 0.0, 1e-4]])
    assert finite_strain_traction_mpa(np.ones((1, 3)), nearly_flat, THICKNESS_MM) == pytest.approx(1, abs=1e-6)
    assert finite_strain_height_mm(nearly_flat, THICKNESS_MM) == pytest.approx(nearly_flat, rel=1e-4)


def test_deeper_is_stiffer_and_higher_stays_higher():
    assert (np.diff(finite_strain_load_factor(np.linspace(0, MAX_FITTED_DEPTH_OVER_THICKNESS, 50))) > 0).all()
    heights = np.linspace(-0.9, 0.4, 50)[None] * THICKNESS_MM
    assert (np.diff(finite_strain_traction_mpa(np.ones_like(heights), heights, THICKNESS_MM)) <= 0).all()
    assert (np.diff(finite_strain_height_mm(heights, THICKNESS_MM)) > 0).all()


def test_bulges_carry_no_more_pressure_and_hollows_keep_their_depth():
    heights = np.array([[-1.0, 0.5]])
    assert finite_strain_traction_mpa(np.ones((1, 2)), heights, THICKNESS_MM)[0, 1] == 1
    assert finite_strain_height_mm(heights, THICKNESS_MM)[0, 0] == -1


def test_torch_gets_the_same_answer():
    heights, pressure = np.array([[-1.0, 0.5]]), np.array([[2.0, 0.0]])
    theirs = torch.from_numpy(heights)
    assert finite_strain_load_factor(theirs).numpy() == pytest.approx(finite_strain_load_factor(heights))
    assert finite_strain_height_mm(theirs, THICKNESS_MM).numpy() == pytest.approx(
        finite_strain_height_mm(heights, THICKNESS_MM)
    )
    stiffened = finite_strain_traction_mpa(torch.from_numpy(pressure), theirs, THICKNESS_MM)
    assert stiffened.numpy() == pytest.approx(finite_strain_traction_mpa(pressure, heights, THICKNESS_MM))
