"""Laws of the parts: what unknowns do to light, their curvature, the search, the law of light, the base."""

from dataclasses import replace

import numpy as np
import pytest

from ninedtact.design import Gel
from ninedtact.force.contact_detection import estimate_cell_noise
from ninedtact.force.traction.brightness_from_traction import ForwardModel, InfluenceKernels
from ninedtact.force.traction.linearisation_and_qp import (
    DiscretePrior,
    LinearisedBrightnessProblem,
    NonNegativeQP,
    TractionPrior,
    Whitener,
    solve_nonnegative_qp,
)
from ninedtact.force.traction.observation import (
    BrightnessObservationModel,
    CellGrid,
    brightness_law_of_curve,
    cell_grid_over_image,
)
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import correct_for_finite_strain
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, gel_skin
from ninedtact.quantities import centred_axis_mm
from ninedtact.shape.depth import DepthCurve, GlobalDimmingModel

CELLS = CellGrid(20, 26, 0.5, 0.05)
GEL = Gel(2.5, 1.0, finite_strain=0.0, gel_to_base_modulus_ratio=0.0)
FORWARD = ForwardModel(CELLS, GEL, 0.6)
RNG = np.random.default_rng(0)


RIGID = BrightnessObservationModel(
    DepthCurve("ratio", (0.0, 0.15, 0.3), (0.0, 1.0, 2.0), (0.01,) * 3, (0.0, 0.33), (0.0, 1.0)),
    GlobalDimmingModel(0.5),
    0.6,
)


def drawn(*shape: int) -> np.ndarray:
    return RNG.standard_normal(shape).astype(np.float32)


@pytest.mark.parametrize("shape", [(345, 460), (460, 345), (230, 307), (90, 120)])
@pytest.mark.parametrize("thickness_mm", [1.2, 3.0])
def test_cells_are_squares_of_their_pitch(shape: tuple[int, int], thickness_mm: float) -> None:
    """The mean of the position over a cell is where the cell says that it is."""
    mm_per_px = 24 / max(shape)
    cells = cell_grid_over_image(shape, mm_per_px, thickness_mm)
    position_mm = np.meshgrid(*(centred_axis_mm(side, mm_per_px) for side in shape[::-1]))
    inner = (slice(2, -2), slice(2, -2))
    for axis_mm, cell_mm in zip(position_mm, cells.coordinates_mm, strict=True):
        np.testing.assert_allclose(cells.average(axis_mm)[inner], cell_mm[inner], atol=mm_per_px / 10)
    overhang_mm = np.array(cells.image_shape) * cells.pitch_mm - np.array(shape) * mm_per_px
    assert (overhang_mm > -1e-6).all() and overhang_mm.min() < 1e-6 and overhang_mm.max() < cells.pitch_mm


@pytest.mark.parametrize("ratio", [0.0, 0.12])
def test_heights_and_thickness_are_those_of_the_contact_mechanics(ratio: float) -> None:
    tractions = np.zeros((3, *CELLS.patch.shape), np.float32)
    tractions[:, 5:9, 6:12] = drawn(3, 4, 6)
    gel = replace(GEL, gel_to_base_modulus_ratio=ratio)
    skin, spread = gel_skin(CELLS.patch, gel), spread_over_cells(tractions)
    true = skin.operators.displacement_mm(*spread)[0]
    found = ForwardModel(CELLS, gel, 0.6).deform(tractions[:, : CELLS.rows, : CELLS.cols])
    np.testing.assert_allclose(found.height_mm, true, atol=1e-4)
    np.testing.assert_allclose(found.thickness_change_mm, true - skin.interface_height_mm(*spread), atol=1e-4)


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
    skin, (pressure, shear) = gel_skin(CELLS.patch, gel), spread_over_cells(tractions)
    height_mm, tangential_mm = skin.operators.displacement_mm(pressure, shear)
    linear = Contact(
        skin, Pose(), np.where(under, pressure, 0), np.where(under, shear, 0), height_mm, tangential_mm, 1.0
    )
    true_mm = correct_for_finite_strain(linear).thickness_change_mm
    straight_mm = linear.thickness_change_mm
    off_mm = np.abs(found.thickness_change_mm - true_mm)
    assert off_mm.max() < 0.1 * np.abs(true_mm - straight_mm).max()


def spread_over_cells(tractions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Tractions at points of the grid that have the spectrum of tractions that are uniform over each cell."""
    kx, ky = CELLS.patch.wave_vectors
    uniform = np.sinc(kx * CELLS.pitch_mm / 2 / np.pi) * np.sinc(ky * CELLS.pitch_mm / 2 / np.pi)
    spread = np.fft.irfft2(np.fft.rfft2(tractions) * uniform, s=CELLS.patch.shape).astype(np.float32)
    return spread[0], spread[1:]


def test_a_uniform_traction_on_cells_deforms_the_skin_as_on_a_finer_grid() -> None:
    finer = 4
    fine = PeriodicGrid(CELLS.patch.rows * finer, CELLS.patch.cols * finer, CELLS.pitch_mm / finer)
    row, col = np.mgrid[0 : CELLS.patch.rows, 0 : CELLS.patch.cols]
    bump = np.exp(-((row - 8.0) ** 2 + (col - 10.0) ** 2) / 2 / 1.6**2) * (row < CELLS.rows) * (col < CELLS.cols)
    tractions = (bump * np.array([1.0, 0.3, -0.2])[:, None, None]).astype(np.float32)
    blocks = np.repeat(np.repeat(tractions, finer, axis=1), finer, axis=2)
    fine_height = gel_skin(fine, GEL).operators.displacement_mm(blocks[0], blocks[1:])[0]
    # The centre of a cell lies between the middle points of its blocks.
    middle = [fine_height[finer // 2 - a :: finer, finer // 2 - b :: finer] for a in (0, 1) for b in (0, 1)]
    found = FORWARD.deform(tractions[:, : CELLS.rows, : CELLS.cols]).height_mm
    scale = float(np.abs(found).max())
    np.testing.assert_allclose(found, np.mean(middle, axis=0), atol=0.01 * scale)


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
        touched * 0.5,
        slope,
        weigh,
        strain=0.3,
    )


def test_modes_have_the_variance_of_the_prior() -> None:
    modes = DiscretePrior(CELLS, TractionPrior()).shear_modes
    deviations = np.sqrt((modes**2).sum(axis=1).mean())
    assert deviations == pytest.approx(np.hypot(TractionPrior().pull, TractionPrior().spread), rel=0.1)


def test_the_law_of_light_goes_through_the_knots() -> None:
    law = brightness_law_of_curve(RIGID.curve)
    np.testing.assert_allclose(law(np.float32([-2, -1, 0, 0.5, 1])), [-0.3, -0.15, 0, 0.165, 0.33], atol=1e-6)
    np.testing.assert_allclose(law.slope_per_mm(np.float32([-1.5, -0.5, 0.5])), [0.15, 0.15, 0.33], atol=1e-6)


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


def test_a_common_level_weighs_little() -> None:
    weigh = Whitener(np.full((8, 8), 10, np.float32), 100.0)
    assert np.abs(weigh(np.ones((8, 8), np.float32))).max() < 1e-2


def test_roughness_is_the_noise_whatever_is_smooth_below() -> None:
    x = np.linspace(0, 3, 60)
    field = (np.sin(x) + drawn(50, 60) * 0.01).astype(np.float32)
    assert estimate_cell_noise(field) == pytest.approx(0.01, rel=0.15)


def test_light_scatters_into_the_cells_with_the_variance_of_the_point_spread_and_a_cell() -> None:
    down, across = FORWARD.point_spread
    for axis, weights in ((0, down), (1, across.T)):
        middle = CELLS.shape[axis] // 2
        place_mm = (CELLS.offsets(axis) - middle) * CELLS.pitch_mm
        assert weights[middle].sum() == pytest.approx(1, abs=1e-4)
        assert weights[middle] @ place_mm == pytest.approx(0, abs=1e-3)
        assert weights[middle] @ place_mm**2 == pytest.approx(0.6**2 + CELLS.pitch_mm**2 / 12, rel=0.03)
