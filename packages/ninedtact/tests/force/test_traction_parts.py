"""Laws of the parts: what unknowns do to light, their curvature, the search, the law of light, the base."""

from dataclasses import replace

import numpy as np
import pytest

from ninedtact.design import Gel
from ninedtact.force.contact_detection import estimate_cell_noise
from ninedtact.force.traction.brightness_from_traction import (
    COMPLIANT_BASE,
    TYPICAL_SLOPE_RATIO,
    ForwardModel,
    InfluenceKernels,
    Substrate,
    bulge_to_dent_slope_ratio,
    identify_substrate,
    influence_window_indices,
    influence_windows,
)
from ninedtact.force.traction.cell_grid import CellGrid, cell_grid_over_image
from ninedtact.force.traction.linearisation import (
    DiscretePrior,
    LinearisedBrightnessProblem,
    TractionPrior,
    Whitener,
    pressure_precision_spectrum,
)
from ninedtact.force.traction.nonnegative_qp import NonNegativeQP, solve_nonnegative_qp
from ninedtact.force.traction.observation import _EXTENSION_FACTOR, BrightnessObservationModel, brightness_law_of_curve
from ninedtact.force.traction.traction_from_brightness import UncertaintyModel
from ninedtact.mechanics.layer_compliance import layered_compliance
from ninedtact.mechanics.skin import PeriodicGrid, Skin, gel_skin
from ninedtact.quantities import Rectified, Traction, centred_axis_mm
from ninedtact.shape.depth import DepthCurve, GlobalDimmingModel

CELLS = CellGrid(20, 26, 0.5, 0.05)
FORWARD = ForwardModel(CELLS, 2.5, 0.5, 0.6)
RNG = np.random.default_rng(0)


def drawn(*shape: int) -> np.ndarray:
    return RNG.standard_normal(shape).astype(np.float32)


@pytest.mark.parametrize("shape", [(345, 460), (460, 345), (230, 307), (90, 120)])
@pytest.mark.parametrize("thickness_mm", [1.2, 1.7, 2.2, 3.0])
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


def test_thin_gel_has_finer_cells_within_limits() -> None:
    pitch_mm = [cell_grid_over_image((345, 460), 0.0522, thickness).pitch_mm for thickness in (1.2, 1.7, 3.0)]
    np.testing.assert_allclose(pitch_mm, [0.5, 0.35 * 1.7, 0.7], rtol=0.03)
    assert cell_grid_over_image((40, 300), 0.1, 3.0).image_shape == (8, 60)


def test_cells_are_means_of_their_pixels() -> None:
    field = np.random.default_rng(3).random((90, 120), np.float32)
    cells = cell_grid_over_image(field.shape, 0.2, 3.0)
    assert cells.average(np.ones_like(field)) == pytest.approx(1, abs=1e-6)
    assert cells.average(field)[1:-1, 1:-1].mean() == pytest.approx(field.mean(), abs=2e-3)


def test_heights_are_those_of_the_contact_mechanics() -> None:
    tractions = np.zeros((3, *CELLS.patch.shape), np.float32)
    tractions[:, 5:9, 6:12] = drawn(3, 4, 6)
    response = gel_skin(CELLS.patch, Gel(2.5, 1.0)).operators
    true = response.displacement_mm(*spread_over_cells(tractions))[0]
    np.testing.assert_allclose(FORWARD.heights(tractions[:, : CELLS.rows, : CELLS.cols]), true, atol=1e-4)


def test_a_window_of_the_influence_is_the_response_to_one_cell_with_the_skin_around_the_view() -> None:
    around = 3, 5
    windows = influence_windows(CELLS, FORWARD.compliance[0], around)
    row, col = np.array([0, 7, 19]), np.array([25, 4, 0])
    at = influence_window_indices(CELLS, row, col)
    for window, one_row, one_col in zip(windows[at], row, col, strict=True):
        pressure = np.zeros((3, *CELLS.shape), np.float32)
        pressure[0, one_row, one_col] = 1
        seen = np.roll(FORWARD.heights(pressure), around, axis=(0, 1))[: CELLS.rows + 6, : CELLS.cols + 10]
        np.testing.assert_allclose(window, seen, atol=1e-5)


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
    fine_height = gel_skin(fine, Gel(2.5, 1.0)).operators.displacement_mm(blocks[0], blocks[1:])[0]
    # The centre of a cell lies between the middle points of its blocks.
    middle = [fine_height[finer // 2 - a :: finer, finer // 2 - b :: finer] for a in (0, 1) for b in (0, 1)]
    found = FORWARD.heights(tractions[:, : CELLS.rows, : CELLS.cols])
    scale = float(np.abs(found).max())
    np.testing.assert_allclose(found, np.mean(middle, axis=0), atol=0.01 * scale)


def test_the_columns_are_what_the_unknowns_do_to_the_light() -> None:
    line = linearised()
    unknowns = drawn(len(line.jacobian))
    seen = FORWARD.scatter(FORWARD.heights(line.tractions(unknowns)) * line.slope) * line.whitener.per_error
    scale = float(np.abs(seen).max())
    np.testing.assert_allclose((unknowns @ line.jacobian).reshape(seen.shape), seen, atol=5e-3 * scale)


def test_the_curvature_is_that_of_the_misfit_and_the_prior() -> None:
    line = linearised()
    unknowns, count = drawn(len(line.jacobian)), int(line.region.sum())
    errors = line.whitener.per_error
    seen = (unknowns @ line.jacobian).reshape(errors.shape) / errors
    pressed = np.zeros(CELLS.patch.shape, np.float32)
    pressed[line.contact_cells] = unknowns[:count]
    power = np.abs(np.fft.fft2(pressed)) ** 2 * pressure_precision_spectrum(
        np.hypot(*full_waves()), TractionPrior(), CELLS.pitch_mm
    )
    known = power.mean() / line.strain**2 + np.sum(unknowns[count:] ** 2)
    misfit = np.vdot(seen, line.whitener(seen))
    assert unknowns @ line.curvature @ unknowns == pytest.approx(misfit + known, rel=1e-3)


def full_waves() -> list[np.ndarray]:
    """Of both halves of the transform."""
    return list(np.meshgrid(*(2 * np.pi * np.fft.fftfreq(side, CELLS.pitch_mm) for side in CELLS.patch.shape[::-1])))


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


def test_scattering_keeps_an_even_light() -> None:
    lit = FORWARD.scatter(np.ones(CELLS.patch.shape, np.float32))
    np.testing.assert_allclose(lit, 1, atol=1e-3)


def test_modes_have_the_variance_of_the_prior() -> None:
    modes = DiscretePrior(CELLS, TractionPrior()).shear_modes
    deviations = np.sqrt((modes**2).sum(axis=1).mean())
    assert deviations == pytest.approx(np.hypot(TractionPrior().pull, TractionPrior().spread), rel=0.1)


def test_the_law_of_light_goes_through_the_knots_and_on_beyond() -> None:
    curve = DepthCurve("ratio", (0.0, 0.1, 0.3), (0.0, 1.0, 2.0), (0.0,) * 3, (0.0, 0.4), (0.0, 1.0))
    law = brightness_law_of_curve(curve)
    seen = law(np.float32([-2 * _EXTENSION_FACTOR, -2, -1, 0, 0.5, 1]))
    np.testing.assert_allclose(seen, [-0.7, -0.3, -0.1, 0, 0.2, 0.4], atol=1e-6)
    np.testing.assert_allclose(law.slope_per_mm(np.float32([-1.5, -0.5, 0.5])), [0.2, 0.1, 0.4], atol=1e-6)
    bent = brightness_law_of_curve(replace(curve, brightening=(0.0, 0.4, 0.6), bulge_mm=(0.0, 1.0, 2.0)))
    beyond_mm = 2 * _EXTENSION_FACTOR
    np.testing.assert_allclose(bent(np.float32([2, beyond_mm])), [0.6, 0.6 + 0.2 * (beyond_mm - 2)], atol=1e-6)


@pytest.mark.parametrize("seed", range(6))
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


def test_a_search_that_is_cut_short_says_so_and_is_nowhere_negative() -> None:
    rng = np.random.default_rng(0)
    root = rng.normal(size=(60, 40))
    found = solve_nonnegative_qp(NonNegativeQP(root.T @ root, root.T @ rng.normal(size=60), 40), np.ones(40, bool), 1)
    assert not found.converged and (found.x >= 0).all()


def test_a_common_level_weighs_little() -> None:
    weigh = Whitener(np.full((8, 8), 10, np.float32), 100.0)
    assert np.abs(weigh(np.ones((8, 8), np.float32))).max() < 1e-2


def test_roughness_is_the_noise_whatever_is_smooth_below() -> None:
    x = np.linspace(0, 3, 60)
    field = (np.sin(x) + drawn(50, 60) * 0.01).astype(np.float32)
    assert estimate_cell_noise(field) == pytest.approx(0.01, rel=0.15)


def test_shear_on_pressed_skin_has_an_arm() -> None:
    push = np.zeros((2, 8, 8), np.float32)
    push[0] = 1e-2
    flat = Traction(np.zeros((8, 8), np.float32), push, 0.5)
    sunk = Traction(np.zeros((8, 8), np.float32), push, 0.5, height_mm=np.full((8, 8), -1, np.float32))
    assert flat.wrench().torque_nm[1] == 0
    assert sunk.wrench().torque_nm[1] == pytest.approx(-flat.wrench().force_n[0] / 1e3)


RIGID = BrightnessObservationModel(
    DepthCurve("ratio", (0.0, 0.15, 0.3), (0.0, 1.0, 2.0), (0.01,) * 3, (0.0, 0.33), (0.0, 1.0)),
    GlobalDimmingModel(0.5),
    0.6,
)


def gaussian_peaks(rows: int, width: float = 3.0, apart: int = 24) -> np.ndarray:
    y, x = np.mgrid[0 : (rows + 1) * apart, 0 : 2 * apart]
    return np.asarray(sum(np.exp(-((x - apart) ** 2 + (y - (i + 1) * apart) ** 2) / 2 / width**2) for i in range(rows)))


def test_thin_gel_blurred_light_and_fine_structure_widen_the_stated_error() -> None:
    cells, model = cell_grid_over_image((69, 92), 0.26, 3.0), UncertaintyModel()

    def unresolved(thickness_mm: float, point_spread_mm: float, peaks: int = 1) -> float:
        return model._unresolved(gaussian_peaks(peaks), ForwardModel(cells, thickness_mm, 0.499, point_spread_mm))

    assert 0 < unresolved(3.0, 0.0) < unresolved(3.0, 0.4)  # heights are resolved no better than the cells
    assert unresolved(3.0, 0.4) < unresolved(3.0, 0.6) < unresolved(1.5, 0.4)
    assert unresolved(3.0, 0.4, 4) == pytest.approx(16 * unresolved(3.0, 0.4), rel=0.1)
    assert unresolved(1.5, 0.6, 40) == 1


def test_a_calibration_on_a_rigid_base_is_left_as_it_is() -> None:
    assert identify_substrate(RIGID) == Substrate(RIGID, None)


def test_bulges_too_faint_for_their_dents_tell_a_base_that_yields() -> None:
    faint = replace(RIGID, curve=replace(RIGID.curve, brightening=(0.0, 0.15)))
    ground = identify_substrate(faint)
    assert ground.base == COMPLIANT_BASE
    assert bulge_to_dent_slope_ratio(ground.observation_model.curve) == pytest.approx(TYPICAL_SLOPE_RATIO)
    assert ground.observation_model.curve.darkening == faint.curve.darkening


def test_heights_on_a_base_that_yields_are_those_of_the_contact_mechanics() -> None:
    tractions = np.zeros((3, *CELLS.patch.shape), np.float32)
    tractions[:, 5:9, 6:12] = drawn(3, 4, 6)
    skin = Skin(CELLS.patch, layered_compliance((Gel(2.5, 1.0), COMPLIANT_BASE)))
    true = skin.operators.displacement_mm(*spread_over_cells(tractions))[0]
    found = ForwardModel(CELLS, 2.5, 0.5, 0.6, COMPLIANT_BASE).heights(tractions[:, : CELLS.rows, : CELLS.cols])
    np.testing.assert_allclose(found, true, atol=1e-4)


def test_the_light_that_a_press_takes_from_the_whole_image_is_added_back() -> None:
    cells, reference = cell_grid_over_image((90, 120), 0.2, 3.0), np.full((90, 120), 160, np.float32)
    pressed = np.ones_like(reference)
    pressed[30:60, 40:80] = 0.7
    share = 1 - pressed.mean(dtype=float)
    lost = -0.5 * share  # of the light, by a global dimming of one half
    seen = RIGID._relative_change(
        Rectified(reference * pressed * np.float32(1 + lost), 0.2), Rectified(reference, 0.2), cells
    )
    row, col = (side // 2 for side in cells.shape)
    assert lost == pytest.approx(-0.0167, abs=1e-3)
    assert seen[row, col] == pytest.approx(-0.3, abs=1e-3)
    assert seen[2, 2] == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize(("ratio", "base"), [(1.41, None), (1.39, COMPLIANT_BASE)])
def test_the_slopes_of_bulges_and_dents_decide_the_base(ratio: float, base: Gel | None) -> None:
    steep = 0.15 * ratio
    bulges = replace(RIGID.curve, brightening=(0.0, 0.1 * steep, 0.5 * steep), bulge_mm=(0.0, 0.2, 0.5))
    assert bulge_to_dent_slope_ratio(bulges) == pytest.approx(ratio)
    substrate = identify_substrate(replace(RIGID, curve=bulges))
    assert substrate.base == base
    raised = ratio if base is None else TYPICAL_SLOPE_RATIO
    assert bulge_to_dent_slope_ratio(substrate.observation_model.curve) == pytest.approx(raised)


def test_every_image_is_compared_with_its_own_reference() -> None:
    cells, model = cell_grid_over_image((90, 120), 0.2, 3.0), replace(RIGID, loss=GlobalDimmingModel())
    one, two = (Rectified(np.full((90, 120), grey, np.float32), 0.2) for grey in (100, 150))
    for reference, expected in ((one, 0.2), (two, -0.2), (two, -0.2), (one, 0.2)):
        image = Rectified(np.full((90, 120), 120, np.float32), 0.2)
        np.testing.assert_allclose(model._relative_change(image, reference, cells), expected, atol=1e-5)
    coarser = cell_grid_over_image((90, 120), 0.1, 3.0)
    assert model._relative_change(image, one, coarser).shape == coarser.shape != cells.shape


def test_shear_varies_over_the_contact_by_its_spread_and_is_pulled_alike_everywhere() -> None:
    prior = TractionPrior(pull=0.2, spread=0.05, spread_mm=1.5)
    modes = DiscretePrior(CELLS, prior).shear_modes
    np.testing.assert_allclose(modes[:, 0], 0.2)
    covariance = modes[:, 1:] @ modes[:, 1:].T
    assert np.sqrt(np.diag(covariance).mean()) == pytest.approx(0.05, rel=1e-3)
    rows, cols = np.indices(CELLS.shape).reshape(2, -1)
    middle = int(np.flatnonzero((rows == CELLS.rows // 2) & (cols == CELLS.cols // 2))[0])
    correlation = (covariance[middle] / covariance[middle, middle]).reshape(CELLS.shape)
    # Bumps of 0.8 steps: two points a distance r apart have the correlation exp(-r²/(4 · 0.8² · 1.5²)).
    aside = np.arange(-4, 5)
    expected = np.exp(-((aside * CELLS.pitch_mm) ** 2) / (4 * (0.8 * 1.5) ** 2))
    np.testing.assert_allclose(correlation[CELLS.rows // 2, CELLS.cols // 2 + aside], expected, atol=0.05)
    np.testing.assert_allclose(correlation[CELLS.rows // 2 + aside, CELLS.cols // 2], expected, atol=0.05)


def test_the_skin_around_the_view_is_wide_enough_and_wraps_around() -> None:
    rows, cols = CELLS.patch.shape
    assert rows >= CELLS.rows + 2 * 7 and cols >= CELLS.cols + 2 * 7  # 3.3 mm on each side, in cells of 0.5 mm
    down = CELLS.offsets(0)
    np.testing.assert_array_equal(down[: CELLS.rows], np.arange(CELLS.rows))
    np.testing.assert_array_equal(np.sort(down), np.arange(down.min(), down.min() + rows))
    assert down[-1] == -1 and -down.min() == pytest.approx((rows - CELLS.rows) / 2, abs=0.5)


def test_light_scatters_into_the_cells_with_the_variance_of_the_point_spread_and_a_cell() -> None:
    down, across = ForwardModel(CELLS, 2.5, 0.5, 0.6).point_spread
    for axis, weights in ((0, down), (1, across.T)):
        middle = CELLS.shape[axis] // 2
        place_mm = (CELLS.offsets(axis) - middle) * CELLS.pitch_mm
        assert weights[middle].sum() == pytest.approx(1, abs=1e-4)
        assert weights[middle] @ place_mm == pytest.approx(0, abs=1e-3)
        assert weights[middle] @ place_mm**2 == pytest.approx(0.6**2 + CELLS.pitch_mm**2 / 12, rel=0.03)


def test_pressure_is_free_at_first_where_it_was_and_shear_everywhere() -> None:
    line = linearised()
    pressure = np.zeros(CELLS.shape, np.float32)
    pressure[7, 9:12] = 0.3
    free = line.initially_free(pressure)
    cells = len(line.contact_cells[0])
    assert free[cells:].all() and len(free) == len(line.curvature)
    assert {(row, col) for row, col in zip(*(each[free[:cells]] for each in line.contact_cells), strict=True)} == {
        (7, 9), (7, 10), (7, 11),
    }  # fmt: skip
