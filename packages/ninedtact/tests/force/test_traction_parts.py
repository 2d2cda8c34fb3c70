"""Laws of the parts: what unknowns do to light, their curvature, the search, the law of light, the base."""

from dataclasses import replace

import numpy as np
import pytest

from ninedtact.design import Gel
from ninedtact.force.traction.brightness_from_traction import DeformedSkin, ForwardModel, InfluenceKernels
from ninedtact.force.traction.linearisation_and_qp import (
    DiscretePrior,
    LinearisedBrightnessProblem,
    NonNegativeQP,
    TractionPrior,
    Whitener,
    solve_nonnegative_qp,
)
from ninedtact.force.traction.observation import BrightnessLaw, CellGrid, LinesOfSight
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import correct_for_finite_strain
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import gel_skin

CELLS = CellGrid(20, 26, 0.5, 0.05)
GEL = Gel(2.5, 1.0, finite_strain=0.0, gel_to_base_modulus_ratio=0.0)
FORWARD = ForwardModel(CELLS, GEL, 0.6)
RNG = np.random.default_rng(0)


def drawn(*shape: int) -> np.ndarray:
    return RNG.standard_normal(shape).astype(np.float32)


@pytest.mark.parametrize("ratio", [0.0, 0.12])
def test_heights_and_thickness_are_those_of_the_contact_mechanics(ratio: float) -> None:
    tractions = np.zeros((3, *CELLS.patch.shape), np.float32)
    tractions[:, 5:9, 6:12] = drawn(3, 4, 6)
    gel = replace(GEL, gel_to_base_modulus_ratio=ratio)
    skin = gel_skin(CELLS.patch, gel)
    true = skin.operators.displacement_mm(tractions[0], tractions[1:])[0]
    found = ForwardModel(CELLS, gel, 0.6).deform(tractions[:, : CELLS.rows, : CELLS.cols])
    np.testing.assert_allclose(found.height_mm, true, atol=1e-4)
    np.testing.assert_allclose(
        found.thickness_change_mm, true - skin.interface_height_mm(tractions[0], tractions[1:]), atol=1e-4
    )


@pytest.mark.parametrize("ratio", [0.0, 0.3])
def test_thinning_is_told_from_the_height_of_skin_under_pressure(ratio: float) -> None:
    tractions = np.zeros((3, CELLS.rows, CELLS.cols), np.float32)
    tractions[0, 5:9, 6:12] = abs(drawn(4, 6))
    forward = ForwardModel(CELLS, replace(GEL, gel_to_base_modulus_ratio=ratio), 0.6)
    pressed = forward.deform(tractions)
    found = forward.thickness_change_mm(pressed.height_mm)
    np.testing.assert_allclose(found, pressed.thickness_change_mm, atol=1e-4)


def test_thickness_at_finite_strain_is_that_of_the_twin() -> None:
    """But for what the skin carries along, which a base that yields does not have."""
    gel = replace(GEL, finite_strain=1.0, gel_to_base_modulus_ratio=0.12)
    row, col = np.mgrid[0 : CELLS.patch.rows, 0 : CELLS.patch.cols]
    tractions = np.zeros((3, *CELLS.patch.shape), np.float32)
    under = (row - 10) ** 2 + (col - 12) ** 2 < 5**2
    tractions[:, under] = np.array([3.0, 1.5, -0.5], np.float32)[:, None]
    found = ForwardModel(CELLS, gel, 0.6).deform(tractions[:, : CELLS.rows, : CELLS.cols])
    skin, (pressure, shear) = gel_skin(CELLS.patch, gel), (tractions[0], tractions[1:])
    height_mm, tangential_mm = skin.operators.displacement_mm(pressure, shear)
    linear = Contact(skin, Pose(), pressure, shear, height_mm, tangential_mm, 1.0)
    true_mm = correct_for_finite_strain(linear).thickness_change_mm
    straight_mm = linear.thickness_change_mm
    off_mm = np.abs(found.thickness_change_mm - true_mm)
    assert off_mm.max() < 0.1 * np.abs(true_mm - straight_mm).max()


def dent_mm(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A dent with a bulge around it, off the middle."""
    square = ((x - 2) ** 2 + (y + 1) ** 2) / 1.2**2
    return -1.2 * (1 - square / 2) * np.exp(-square / 2)


def test_skin_is_seen_where_lines_of_sight_meet_it_and_kinks_of_the_law_are_not_smoothed_by_cells() -> None:
    from scipy.ndimage import gaussian_filter, uniform_filter

    law = BrightnessLaw(np.array([-2.0, 0.0, 2.0]), np.array([-0.24, 0.0, 0.9]))
    y, x = np.meshgrid(*((CELLS.offsets(axis) - (CELLS.shape[axis] - 1) / 2) * 0.5 for axis in (0, 1)), indexing="ij")
    height_mm = dent_mm(x, y).astype(np.float32)
    skin = DeformedSkin(height_mm, height_mm, np.ones_like(height_mm), height_mm)
    sight = LinesOfSight(0.06, np.stack(np.meshgrid(*map(np.arange, (26, 20)))).astype(np.float32))
    found = FORWARD.observed_change(law, skin, sight)
    # Brute force: parts of 0.05 mm, of which ten make a cell.
    down, across = np.meshgrid(np.arange(-8.975, 9, 0.05), np.arange(-10.475, 10.5, 0.05), indexing="ij")
    seen_mm = 0 * down
    for _ in range(30):
        seen_mm = dent_mm(across * (1 + 0.06 * seen_mm), down * (1 + 0.06 * seen_mm))
    fine = uniform_filter(gaussian_filter(law(seen_mm.astype(np.float32)), 0.6 / 0.05), 10)
    middles = [
        np.arange(side) * 10 + (long - side * 10) // 2 + 5 for side, long in zip((20, 26), fine.shape, strict=True)
    ]
    true = fine[np.ix_(*middles)]
    assert np.abs(found - true).max() < 0.02 * np.abs(true).max()
    straight = FORWARD.observed_change(law, skin, None)
    assert np.abs(straight - true).max() > 0.05 * np.abs(true).max()


def test_the_slope_of_a_law_with_a_kink_is_that_of_the_light_that_is_seen() -> None:
    law = BrightnessLaw(np.array([-2.0, 0.0, 2.0]), np.array([-0.24, 0.0, 0.9]))
    y, x = np.meshgrid(*((CELLS.offsets(axis) - (CELLS.shape[axis] - 1) / 2) * 0.5 for axis in (0, 1)), indexing="ij")

    def raised(mm: float) -> DeformedSkin:
        height_mm = (dent_mm(x, y) + mm).astype(np.float32)
        return DeformedSkin(height_mm, height_mm, np.ones_like(height_mm), height_mm)

    above, below = (FORWARD.observed_change(law, raised(0.05 + step_mm), None) for step_mm in (0.005, -0.005))
    true, skin = (above - below) / 0.01, raised(0.05)
    by_parts = FORWARD.scatter(FORWARD.slope_per_mm(law.slope_per_mm, skin))
    by_cells = FORWARD.scatter(law.slope_per_mm(skin.height_mm))
    off, off_by_cells = (np.abs(each - true)[2:-2, 2:-2].max() / true.max() for each in (by_parts, by_cells))
    assert off < 0.005 < 0.02 < off_by_cells


def sideways_mm(tractions: np.ndarray, touched: np.ndarray) -> float:
    """Root mean square of the displacement of touched skin along the surface."""
    moved = FORWARD.tangential_compliance * np.fft.rfft2(tractions, s=CELLS.patch.shape)
    fields = np.fft.irfft2(moved.sum(axis=1), s=CELLS.patch.shape)[:, : CELLS.rows, : CELLS.cols]
    return float(np.sqrt((fields[:, touched > 0] ** 2).mean()))


def test_pressure_brings_the_shear_that_holds_a_flat_contact_and_less_where_the_contact_grew() -> None:
    line = linearised()
    row, col = line.contact_cells
    held = line.tractions(np.concatenate([np.ones(len(row)), line.sticking_weights.sum(axis=0)]))
    free = held * np.array([1, 0, 0])[:, None, None]
    assert sideways_mm(held, line.region) < 0.4 * sideways_mm(free, line.region)
    cone = np.maximum(1 - np.hypot(row - 9, col - 12) / 6, 0.01)
    carries = line.carries.copy()
    carries[row, col] = cone
    grown = replace(line, carries=carries)
    at_once = replace(grown, growth_steps=1)
    shear, more = (
        np.abs(each.tractions(np.concatenate([cone, cone @ each.sticking_weights]))[1:]).sum()
        for each in (grown, at_once)
    )
    assert 0.5 * more < shear < 0.95 * more


def test_the_columns_are_what_the_unknowns_do_to_the_light() -> None:
    line = linearised()
    unknowns = drawn(len(line.jacobian))
    seen = FORWARD.scatter(FORWARD.deform(line.tractions(unknowns)).height_mm * line.slope) * line.whitener.per_error
    scale = float(np.abs(seen).max())
    np.testing.assert_allclose((unknowns @ line.jacobian).reshape(seen.shape), seen, atol=5e-3 * scale)


def linearised() -> LinearisedBrightnessProblem:
    """A touch on a sloping law, its errors uneven."""
    touched = np.zeros(CELLS.shape, np.float32)
    touched[6:13, 8:17] = 1
    slope, weigh = np.abs(drawn(*CELLS.patch.shape)), Whitener(1 + np.abs(drawn(*CELLS.shape)), 0.3)
    return LinearisedBrightnessProblem(
        InfluenceKernels(FORWARD),
        DiscretePrior(CELLS, TractionPrior()),
        touched,
        np.stack([touched, 0 * touched, 0 * touched]),
        touched * 0.5,
        slope,
        weigh,
        strain=0.3,
    )


@pytest.mark.parametrize("seed", range(3))
def test_the_lowest_point_that_is_not_negative_is_found(seed: int) -> None:
    from scipy.optimize import lsq_linear

    rng = np.random.default_rng(seed)
    root, seen = rng.normal(size=(60, 40)), rng.normal(size=60)
    below = np.where(np.arange(40) < 30, 0, -np.inf)
    true = lsq_linear(root, seen, (below, np.inf), tol=1e-12).x
    problem = NonNegativeQP(root.T @ root, root.T @ seen, 30)
    for begin in (np.ones(40, bool), np.arange(40) >= 30):
        found = solve_nonnegative_qp(problem, begin, 60)
        assert found.converged and (found.x[:30] >= 0).all()
        np.testing.assert_allclose(found.x, true, atol=0.03)
    hasty = solve_nonnegative_qp(problem, np.ones(40, bool), 1)
    assert not hasty.converged and (hasty.x[:30] >= 0).all()
