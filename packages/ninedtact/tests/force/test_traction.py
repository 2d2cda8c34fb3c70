"""Laws of force without training, on heights and on light that the contact mechanics made."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from height_observation import HeightObservationModel
from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact.design import Gel
from ninedtact.errors import ForceEstimationError
from ninedtact.force.traction.estimator import TractionForce
from ninedtact.force.traction.observation import (
    BrightnessLaw,
    BrightnessObservationModel,
    cell_grid_over_image,
)
from ninedtact.force.traction.traction_from_brightness import SolverSettings
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import correct_for_finite_strain
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import gel_skin, padded_grid
from ninedtact.quantities import (
    EstimateWarning,
    Frame,
    HeightMap,
    HeightSource,
    Rectified,
    WrenchEstimate,
    centred_axis_mm,
)
from ninedtact.reading import Reading
from ninedtact.shape.depth import DepthCurve, GlobalDimmingModel
from ninedtact.simulation.ground_truth import true_height_map

GEL = Gel(finite_strain=0.0, gel_to_base_modulus_ratio=0.0)
PX_MM = 0.2
WIDE, SQUARE = (90, 120), (90, 90)
THOROUGH = SolverSettings(max_iterations=20, target_decrement=0.02)
FRAME = Frame(np.zeros((1, 1, 3), np.uint8))
DEPTH = np.linspace(0, 2, 21)
CURVE = DepthCurve("ratio", tuple((0.15 * DEPTH).tolist()), tuple(DEPTH.tolist()), (0.01,) * 21, (0.0, 0.4), (0.0, 1.0))


@lru_cache
def dragged(x_mm: float = 1.0, y_mm: float = -0.6, drag_mm: float = 0.5) -> Contact:
    model = ContactModel(gel_skin(padded_grid(24, 18, PX_MM, 4.0), GEL))
    down = [Pose(x_mm, y_mm, depth) for depth in (0.4, 0.8, 1.0)]
    *_, last = model.follow(Ball(4.0), [*down, Pose(x_mm + drag_mm, y_mm + drag_mm / 2, 1.0)])
    return last


def reading(z_mm: np.ndarray) -> Reading:
    seen = np.full(z_mm.shape, HeightSource.MEASURED, np.uint8)
    grey = Rectified(np.full(z_mm.shape, 150, np.float32), PX_MM)
    return Reading(FRAME, grey, HeightMap(z_mm.astype(np.float32), seen, PX_MM), grey)


def noisy(shape: tuple[int, int] = WIDE, seed: int = 0, contact: Contact | None = None) -> np.ndarray:
    z_mm = true_height_map(contact or dragged(), shape, PX_MM).z_mm
    return z_mm + np.random.default_rng(seed).normal(0, 0.005, shape)


def by_height(gel: Gel = GEL, solver: SolverSettings = THOROUGH) -> TractionForce:
    return TractionForce(HeightObservationModel(), gel, solver=solver)


@pytest.mark.parametrize(("x", "y", "drag"), [(1.0, -0.6, 0.5), (-3.0, 2.0, -0.7), (0.0, 0.0, 0.0)])
def test_the_wrench_of_a_dragged_ball_is_found(x: float, y: float, drag: float) -> None:
    contact = dragged(x, y, drag)
    found, true = by_height().estimate(reading(noisy(contact=contact))), contact.wrench()
    load = -true.force_n[2]
    assert found.touching and not found.warnings
    np.testing.assert_allclose(found.wrench.force_n, true.force_n, atol=0.06 * load)
    np.testing.assert_allclose(found.wrench.torque_nm, true.torque_nm, atol=0.5e-3 * load)


def test_untouched_skin_has_no_wrench_at_all() -> None:
    for seed in range(5):
        flat = np.random.default_rng(seed).normal(0, 0.01, WIDE)
        found = by_height().estimate(reading(flat))
        assert not found.touching and not found.warnings
        assert not found.wrench.six.any()
        assert found.std == pytest.approx([0.01, 0.01, 0.03, 2e-4, 2e-4, 5e-5])


def test_pressure_is_nowhere_negative_and_nothing_acts_outside_the_contact() -> None:
    traction = by_height().estimate(reading(noisy())).traction
    assert traction is not None and (traction.pressure_mpa >= 0).all()
    rows, cols = traction.pressure_mpa.shape
    x, y = (centred_axis_mm(side, traction.mm_per_px) for side in (cols, rows))
    far = np.hypot(x[None] - 1.5, y[:, None] + 0.4) > 6
    assert not traction.pressure_mpa[far].any() and not traction.shear_mpa[:, far].any()


def test_forces_scale_with_the_modulus() -> None:
    stiff = replace(GEL, shear_modulus_mpa=3 * GEL.shear_modulus_mpa)
    soft_n, stiff_n = (by_height(gel).estimate(reading(noisy())) for gel in (GEL, stiff))
    np.testing.assert_allclose(stiff_n.wrench.six, 3 * soft_n.wrench.six, rtol=1e-5)
    np.testing.assert_allclose(stiff_n.std, 3 * soft_n.std, rtol=1e-4)


def test_a_mirrored_touch_has_the_mirrored_wrench() -> None:
    z_mm = noisy()
    one, other = (by_height().estimate(reading(each)).wrench.six for each in (z_mm, z_mm[:, ::-1]))
    np.testing.assert_allclose(other, one * [-1, 1, 1, 1, -1, -1], atol=0.01 * abs(one[2]))


def test_a_turned_touch_has_the_turned_wrench() -> None:
    z_mm = noisy(SQUARE)
    one, other = (by_height().estimate(reading(each)).wrench.six for each in (z_mm, np.rot90(z_mm, -1)))
    turned = [-one[1], one[0], one[2], -one[4], one[3], one[5]]
    np.testing.assert_allclose(other, turned, atol=0.01 * abs(one[2]))


def test_a_moved_touch_has_the_same_force() -> None:
    z_mm = noisy()
    one, other = (by_height().estimate(reading(np.roll(z_mm, by, axis=1))).wrench for by in (0, -10))
    np.testing.assert_allclose(other.force_n, one.force_n, atol=0.015 * abs(one.force_n[2]))
    arm_nm = one.torque_nm[1] - other.torque_nm[1]
    assert arm_nm == pytest.approx(-one.force_n[2] * 10 * PX_MM / 1e3, rel=0.03)


PLACES = ((1.0, -0.6, 0.5), (-3.0, 2.0, -0.7), (0.0, 0.0, 0.0), (1.6, -0.4, -0.6))
"""Contacts that overlap, and one that does not."""


@lru_cache
def image(number: int) -> Reading:
    return reading(noisy(seed=number, contact=dragged(*PLACES[number])))


@lru_cache
def alone(number: int) -> WrenchEstimate:
    return TractionForce(HeightObservationModel(), GEL).estimate(image(number))


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(0, len(PLACES) - 1), min_size=2, max_size=5))
def test_separate_images_have_the_same_wrench_in_any_order(order: list[int]) -> None:
    shared = TractionForce(HeightObservationModel(), GEL)
    for number in order:
        shared.forget()
        np.testing.assert_array_equal(shared.estimate(image(number)).wrench.six, alone(number).wrench.six)


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(0, len(PLACES) - 1), min_size=2, max_size=5))
def test_a_stream_that_jumps_between_contacts_reads_each_as_if_it_were_alone(order: list[int]) -> None:
    stream = TractionForce(HeightObservationModel(), GEL)
    for number in order:
        found = stream.estimate(image(number))
        assert found.warnings == alone(number).warnings
        hundredth_n = 0.01 * -alone(number).wrench.force_n[2]
        np.testing.assert_allclose(found.wrench.force_n, alone(number).wrench.force_n, atol=hundredth_n)
        np.testing.assert_allclose(found.wrench.torque_nm, alone(number).wrench.torque_nm, atol=2e-3 * hundredth_n)


def test_a_second_contact_in_a_stream_is_found_as_in_a_single_image() -> None:
    """The first one does not move, so that its own problem still explains it."""
    stream, one, other = (
        TractionForce(HeightObservationModel(), GEL),
        noisy(contact=dragged(-4.0, 2.0, 0.0)),
        dragged(5.0, -2.0, 0.0),
    )
    stream.estimate(reading(one))
    both = reading(one + true_height_map(other, WIDE, PX_MM).z_mm * 0.2)
    found, expected = stream.estimate(both), TractionForce(HeightObservationModel(), GEL).estimate(both)
    np.testing.assert_allclose(found.wrench.six, expected.wrench.six, atol=0.01 * -expected.wrench.force_n[2])


def test_error_bars_cover() -> None:
    true, estimates = dragged().wrench().six, []
    for seed in range(8):
        estimates.append(by_height().estimate(reading(noisy(seed=seed))))
    off = np.array([np.abs(each.wrench.six - true) / each.std for each in estimates])
    assert (off < 2).mean() > 0.9
    assert all((each.std < [0.5, 0.5, 1.0, 5e-3, 5e-3, 5e-3]).all() for each in estimates)


@pytest.mark.parametrize("twist_deg", [0.0, 10.0, -20.0])
def test_a_twist_that_a_round_contact_hides_is_in_the_error(twist_deg: float) -> None:
    model = ContactModel(gel_skin(padded_grid(24, 18, PX_MM, 4.0), GEL))
    down = [Pose(1.0, -0.6, depth) for depth in (0.4, 0.8)]
    *_, contact = model.follow(Ball(4.0), [*down, Pose(1.0, -0.6, 0.8, np.radians(twist_deg))])
    found, true_nm = by_height().estimate(reading(noisy(contact=contact))), contact.wrench().torque_nm[2]
    assert abs(found.wrench.torque_nm[2] - true_nm) < 2.5 * found.std[5]
    radius_mm = np.sqrt(0.8 * 4.0)
    assert 0.1 < found.std[5] * 1e3 / abs(found.wrench.force_n[2]) / radius_mm < 0.3


def test_light_tells_the_same_as_heights() -> None:
    found = TractionForce(BrightnessObservationModel(CURVE, GlobalDimmingModel(), 0.5), GEL, solver=THOROUGH).estimate(
        lit(dragged())
    )
    true = dragged().wrench().force_n
    np.testing.assert_allclose(found.wrench.force_n, true, atol=0.08 * abs(true[2]))


def lit(contact: Contact) -> Reading:
    """Scattered light of this contact, and the heights that a reader who undoes nothing would have."""
    from scipy.ndimage import gaussian_filter

    true = true_height_map(contact, WIDE, PX_MM)
    change = np.where(true.z_mm < 0, 0.15 * true.z_mm, 0.4 * true.z_mm)
    seen = gaussian_filter(change, 0.5 / PX_MM) + np.random.default_rng(0).normal(0, 0.003, WIDE)
    read_mm = CURVE.height_mm(seen).astype(np.float32)
    before = Rectified(np.full(WIDE, 150, np.float32), PX_MM)
    after = Rectified((150 * (1 + seen)).astype(np.float32), PX_MM)
    return Reading(FRAME, after, replace(true, z_mm=read_mm), reference=before)


class OverlappedLoss(GlobalDimmingModel):
    """Lets another thread work on another reading in the middle of an observation."""

    def __call__(self, grey: np.ndarray, reference: np.ndarray) -> float:
        if OTHER_WORK:
            with ThreadPoolExecutor(1) as other:
                other.submit(OTHER_WORK.pop()).result()
        return 0.0


class OverlappedForce(TractionForce):
    """Lets another thread work on another reading as soon as the result of an inversion is remembered."""

    def __setattr__(self, name: str, value: object) -> None:
        super().__setattr__(name, value)
        if name == "last" and value is not None and OTHER_WORK:
            with ThreadPoolExecutor(1) as other:
                other.submit(OTHER_WORK.pop()).result()


OTHER_WORK: list[Callable[[], object]] = []


def test_two_threads_that_share_an_estimator_get_the_answers_of_their_own_images() -> None:
    one = lit(dragged())
    dim = replace(one, reference=replace(one.reference, grey=one.reference.grey * np.float32(0.7)))
    model = BrightnessObservationModel(CURVE, OverlappedLoss(), 0.5)
    cells = cell_grid_over_image(WIDE, PX_MM, GEL.thickness_mm)
    alone = model.observe(one, cells).change
    OTHER_WORK.append(lambda: model.observe(dim, cells))
    np.testing.assert_array_equal(model.observe(one, cells).change, alone)
    force, expected = OverlappedForce(HeightObservationModel(), GEL), by_height(solver=SolverSettings())
    OTHER_WORK.append(lambda: force.estimate(reading(noisy(contact=dragged(-3.0, 2.0, -0.7)))))
    six = force.estimate(reading(noisy())).wrench.six
    np.testing.assert_array_equal(six, expected.estimate(reading(noisy())).wrench.six)
    assert not OTHER_WORK


def test_the_inversion_of_light_that_saturates_with_depth_converges() -> None:
    """With whole steps of the point of linearisation it would oscillate between two answers."""
    from scipy.ndimage import gaussian_filter

    darkening = 0.25 * (1 - np.exp(-DEPTH / 0.5))
    curve = replace(CURVE, darkening=tuple(darkening.tolist()))
    model = ContactModel(gel_skin(padded_grid(24, 18, PX_MM, 4.0), GEL))
    *_, deep = model.follow(
        Ball(4.0), [*(Pose(depth_mm=float(mm)) for mm in np.linspace(0.3, 1.6, 6)), Pose(0.4, 0, 1.6)]
    )
    true = true_height_map(deep, WIDE, PX_MM)
    change = np.where(true.z_mm < 0, -0.25 * (1 - np.exp(true.z_mm / 0.5)), 0.4 * true.z_mm)
    seen = gaussian_filter(change, 0.5 / PX_MM) + np.random.default_rng(0).normal(0, 0.002, WIDE)
    image, reference = (Rectified((150 * (1 + light)).astype(np.float32), PX_MM) for light in (seen, 0 * seen))
    reading = Reading(FRAME, image, replace(true, z_mm=curve.height_mm(seen).astype(np.float32)), reference=reference)
    estimator = TractionForce(
        BrightnessObservationModel(curve, GlobalDimmingModel(0.0), 0.5), GEL, solver=SolverSettings(max_iterations=8)
    )
    found = estimator.estimate(reading)
    assert estimator.last is not None and estimator.last.newton_decrement < 1
    assert found.wrench.six[2] == pytest.approx(deep.wrench().six[2], rel=0.05)
    # A stream that shows the same image again needs no more than one iteration.
    estimator.estimate(reading)
    assert estimator.last.iterations == 1


def test_a_touch_at_the_border_is_doubted() -> None:
    z_mm = np.roll(noisy(), 50, axis=1)
    z_mm[:, :50] = np.random.default_rng(0).normal(0, 0.005, (90, 50))
    assert EstimateWarning.PART_UNSEEN in by_height().estimate(reading(z_mm)).warnings


def test_a_touch_deeper_than_calibrated_is_doubted() -> None:
    z_mm = noisy()
    for known_mm, warnings in ((0.9 * z_mm.min(), (EstimateWarning.OUT_OF_RANGE,)), (1.2 * z_mm.min(), ())):
        knots_mm = np.array([2 * known_mm, known_mm, 1.0])
        estimator = TractionForce(HeightObservationModel(law=BrightnessLaw(knots_mm, knots_mm)), GEL, solver=THOROUGH)
        assert estimator.estimate(reading(z_mm)).warnings == warnings


@pytest.mark.parametrize(("ratio", "share"), [(0.1, 0.0), (0.1, 1.0), (0.3, 1.0), (0.02, 1.0)])
def test_gel_on_a_base_that_yields_shows_its_thickness(ratio: float, share: float) -> None:
    """The wrench follows from the thickness, and with it the height of the skin, which no image shows."""
    gel = replace(GEL, gel_to_base_modulus_ratio=ratio, finite_strain=share)
    model = ContactModel(gel_skin(padded_grid(24, 18, PX_MM, 8.0), gel))
    *_, linear = model.follow(Ball(4.0), [Pose(0, 0, 0.6), Pose(0, 0, 1.0), Pose(0.5, 0.2, 1.0)])
    contact = correct_for_finite_strain(linear)
    true, thickness = contact.wrench().force_n, replace(contact, height_mm=contact.thickness_change_mm)
    found = by_height(gel).estimate(reading(noisy(contact=thickness)))
    np.testing.assert_allclose(found.wrench.force_n, true, atol=0.07 * abs(true[2]))
    assert found.traction.height_mm.min() == pytest.approx(contact.height_mm.min(), rel=0.06)


def test_a_search_that_was_cut_short_is_doubted() -> None:
    hasty = by_height(solver=SolverSettings(max_iterations=1, max_qp_solves=1))
    assert EstimateWarning.NOT_CONVERGED in hasty.estimate(reading(noisy())).warnings


def test_a_curve_without_bulges_is_refused() -> None:
    blind = replace(CURVE, brightening=(0.0,), bulge_mm=(0.0,))
    with pytest.raises(ForceEstimationError, match="expected a depth curve that knows bulges"):
        BrightnessObservationModel(blind, GlobalDimmingModel(), 0.5)
