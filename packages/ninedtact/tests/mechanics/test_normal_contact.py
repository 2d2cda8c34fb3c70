"""Pressing without friction: closed forms, laws, and figures from a program written apart from this one."""

from dataclasses import replace

import numpy as np
import pytest
from gels import BALL, DOUBLE, EXACT, GEL, SMALL, Paraboloid, Punch, model, pressed
from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact.design import Gel
from ninedtact.errors import SimulationError
from ninedtact.mechanics.closed_forms import (
    BallContactSolution,
    flat_punch_load_n,
    hertz_contact,
    periodic_half_space_shortfall_mm,
    thin_layer_contact,
)
from ninedtact.mechanics.contact_model import ContactModel, SolverSettings
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import FlatPunch, Indenter
from ninedtact.mechanics.layer_compliance import half_space_compliance
from ninedtact.mechanics.normal_contact import ContactConstraint, PressureSolution, solve_pressure
from ninedtact.mechanics.pose import InvalidPose, Pose
from ninedtact.mechanics.skin import PeriodicGrid, Skin

UNIT = replace(GEL, shear_modulus_mpa=1.0)


def measured(contact: Contact) -> BallContactSolution:
    area = (contact.pressure_mpa > 0).sum() * contact.skin.grid.cell_area_mm2
    return BallContactSolution(
        -contact.wrench().force_n[2], float(np.sqrt(area / np.pi)), float(contact.pressure_mpa.max())
    )


def on_half_space(gel: Gel, indenter: Indenter, depth_mm: float, load_n: float, grid: PeriodicGrid) -> Contact:
    """A contact whose images are allowed for."""
    skin = Skin(grid, gel, DOUBLE, half_space_compliance)
    depth = depth_mm - periodic_half_space_shortfall_mm(gel, load_n, grid.width_mm)
    return pressed(ContactModel(skin, 0.0, SolverSettings(tolerance=1e-5)), Pose(depth_mm=depth), indenter=indenter)


@pytest.mark.parametrize("nu", [0.5, 0.3])
def test_a_ball_on_a_half_space_is_hertz(nu):
    gel = replace(GEL, poisson_ratio=nu)
    wanted = hertz_contact(gel, 4.0, 0.3)
    assert wanted.load_n == pytest.approx(8 / 3 / (1 - nu) * 0.1 * np.sqrt(4.0) * 0.3**1.5)
    found = measured(on_half_space(gel, Paraboloid(4.0), 0.3, wanted.load_n, PeriodicGrid(128, 128, 0.1)))
    assert found.load_n == pytest.approx(wanted.load_n, rel=0.005)
    assert found.radius_mm == pytest.approx(wanted.radius_mm, rel=0.01)
    assert found.peak_mpa == pytest.approx(wanted.peak_mpa, rel=0.005)


def test_a_flat_punch_on_a_half_space_is_boussinesq_and_its_load_goes_with_depth():
    grid, radius = PeriodicGrid(160, 160, 0.1), 1.0
    loads = [flat_punch_load_n(GEL, radius, depth) for depth in (0.1, 0.2)]
    found = [
        measured(on_half_space(GEL, Punch(radius), depth, load, grid)).load_n
        for depth, load in zip((0.1, 0.2), loads, strict=True)
    ]
    assert found[0] == pytest.approx(loads[0], rel=0.03)  # the edge is half a cell wide
    assert found[1] == pytest.approx(2 * found[0], rel=1e-4)


@pytest.mark.parametrize(("nu", "within"), [(0.5, 0.06), (0.3, 0.01)])
def test_a_ball_on_a_thin_layer_squeezes_it(nu, within):
    gel, radius, depth = replace(UNIT, thickness_mm=0.2, poisson_ratio=nu), 100.0, 0.05
    wanted = thin_layer_contact(gel, radius, depth)
    grid = PeriodicGrid(96, 96, wanted.radius_mm / 25)
    found = measured(
        pressed(
            model(gel, grid, 0.0, SolverSettings(tolerance=1e-4)), Pose(depth_mm=depth), indenter=Paraboloid(radius)
        )
    )
    for name, value in vars(wanted).items():
        assert getattr(found, name) == pytest.approx(value, rel=within), name


@pytest.mark.parametrize(("depth", "load", "radius"), [(1.9, 130.5, 3.34), (1.0, 35.4, 2.51)])
def test_the_layer_bears_the_published_load(depth, load, radius):
    single = np.zeros((), np.float32)
    found = measured(
        pressed(model(UNIT, PeriodicGrid(384, 384, 0.1), 0.0, SolverSettings(), single), Pose(depth_mm=depth))
    )
    assert found.load_n == pytest.approx(load, rel=2e-3)
    assert found.radius_mm == pytest.approx(radius, rel=5e-3)


def test_either_there_is_pressure_or_a_gap():
    contact = pressed(model(friction=0.0), Pose(depth_mm=1.2))
    x, y = SMALL.positions_mm
    gap = BALL.height_over_skin_mm(contact.pose, x, y) - contact.height_mm
    assert contact.pressure_mpa.min() == 0
    assert gap.min() > -1e-6
    assert np.abs(gap[contact.pressure_mpa > 0]).max() < 1e-6


def test_skin_that_shear_raises_is_pressed_like_any_other():
    fine = SolverSettings(tolerance=1e-4)
    contact = pressed(model(friction=1.0, settings=fine), Pose(depth_mm=1.0), Pose(x_mm=0.4, depth_mm=1.0))
    x, y = SMALL.positions_mm
    gap = BALL.height_over_skin_mm(Pose(depth_mm=1.0), x, y) - contact.height_mm
    assert gap.min() > -2e-4
    assert np.abs(gap[contact.pressure_mpa > 0]).max() < 2e-4


def test_the_load_is_the_slope_of_the_energy():
    def energy_mj(depth: float) -> float:
        contact = pressed(model(friction=0.0), Pose(depth_mm=depth))
        return -0.5 * (contact.pressure_mpa * contact.height_mm).sum() * SMALL.cell_area_mm2

    load = measured(pressed(model(friction=0.0), Pose(depth_mm=1.0))).load_n
    assert (energy_mj(1.001) - energy_mj(0.999)) / 0.002 == pytest.approx(load, rel=1e-5)


def test_deeper_presses_harder_and_wider():
    poses = [Pose(depth_mm=depth) for depth in np.linspace(0.05, 1.5, 8)]
    contacts = [measured(contact) for contact in model(friction=0.0).follow(BALL, poses)]
    for name in ("load_n", "radius_mm", "peak_mpa"):
        values = [getattr(contact, name) for contact in contacts]
        assert values == sorted(set(values))


@settings(max_examples=8, deadline=None)
@given(st.floats(0.01, 3.0), st.floats(0.3, 1.5))
def test_pressure_goes_with_the_modulus_and_shape_does_not(stiffness, depth):
    soft, stiff = (
        pressed(model(replace(GEL, shear_modulus_mpa=g), friction=0.0), Pose(depth_mm=depth))
        for g in (0.1, 0.1 * stiffness)
    )
    np.testing.assert_allclose(stiff.pressure_mpa, stiffness * soft.pressure_mpa, atol=2e-5 * stiffness)
    np.testing.assert_allclose(stiff.height_mm, soft.height_mm, atol=1e-5)


@pytest.mark.parametrize("shape", [(64, 65), (65, 64), (65, 65), (71, 60)])
def test_odd_and_even_grids_agree(shape):
    # The ball is wide against the pitch, so that it matters little which points lie under it.
    even, other = (
        measured(pressed(model(grid=PeriodicGrid(*s, 0.3)), Pose(depth_mm=1.2, x_mm=0.3))) for s in ((64, 64), shape)
    )
    assert other.load_n == pytest.approx(even.load_n, rel=4e-3)
    assert other.peak_mpa == pytest.approx(even.peak_mpa, rel=1e-2)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6))
def test_the_answer_does_not_depend_on_the_first_guess(seed):
    skin, overlap = model().skin, -BALL.height_over_skin_mm(Pose(depth_mm=0.8), *SMALL.positions_mm)
    none, tolerance = np.zeros((1, 1)), np.full((1, 1), 1e-8)
    guess = np.random.default_rng(seed).exponential(0.1, SMALL.shape) * (overlap > -0.5)
    answers = []
    for start in (0 * guess, guess):
        indentation, step_length = (
            skin.operators.indentation_from_pressure_mm(start),
            skin.operators.first_step_lengths(none)[0],
        )
        first = PressureSolution(start, indentation, none, none, none, none, step_length)
        solved = solve_pressure(skin.operators, ContactConstraint(), overlap, first, lambda deeper: tolerance, 300)
        answers.append(solved.pressure_mpa)
    np.testing.assert_allclose(*answers, atol=1e-6)


@pytest.mark.parametrize("friction", [0.0, 0.7])
@pytest.mark.parametrize("guess", [1.2, 0.4, -0.5, 1.8])
def test_pressing_to_a_load_finds_the_depth_that_has_it(friction, guess):
    pressing = model(friction=friction)
    held = pressed(pressing, Pose(depth_mm=1.1))
    loaded = pressing.step_to_load(pressing.initial_contact(), BALL, Pose(depth_mm=guess), measured(held).load_n)
    assert loaded.pose.depth_mm == pytest.approx(1.1, abs=1e-5)
    assert measured(loaded).load_n == pytest.approx(measured(held).load_n, rel=1e-12)
    np.testing.assert_allclose(loaded.pressure_mpa, held.pressure_mpa, atol=2e-5)


def test_a_wrong_guess_of_the_depth_does_not_loosen_what_counts_as_solved():
    coarse = model(settings=SolverSettings(tolerance=1e-2))
    held = coarse.step_to_load(coarse.initial_contact(), BALL, Pose(depth_mm=0.5), 4.0)
    finer = replace(coarse, settings=SolverSettings(tolerance=0.95 * held.residual_mm / held.pose.depth_mm))
    found = finer.step_to_load(held, BALL, replace(held.pose, depth_mm=1.2 * held.pose.depth_mm), 4.0)
    assert 0 < found.residual_mm <= finer.settings.tolerance_mm(found.pose.depth_mm)


def test_a_load_can_be_dragged_and_lifted_like_a_depth():
    pressing = model()
    first = pressing.step_to_load(pressing.initial_contact(), BALL, Pose(depth_mm=0.5), 4.0)
    dragged = pressing.step_to_load(first, BALL, Pose(x_mm=0.4, depth_mm=first.pose.depth_mm), 4.0)
    assert dragged.wrench().force_n[2] == pytest.approx(-4.0, rel=1e-12)
    assert dragged.wrench().force_n[0] > 0.3
    lifted = pressing.step(dragged, BALL, Pose(depth_mm=-0.1))
    assert not lifted.touches
    assert not lifted.height_mm.any()


def test_a_load_that_would_tilt_the_object_through_the_base_is_refused_though_its_middle_is_above():
    pressing, punch = model(settings=SolverSettings(tolerance=1e-2)), FlatPunch(5.0)
    tilted = Pose(depth_mm=1.0, tilt_y_rad=0.25)
    held = pressing.step_to_load(pressing.initial_contact(), punch, tilted, 20.0)
    assert held.pose.depth_mm < 1 and held.height_mm.min() < -1.4, "the edge is far deeper than the middle"
    with pytest.raises(InvalidPose, match=r"expected the object less deep .* allows, 2\.5 mm, got 2\.[5-9]\d* mm"):
        pressing.step_to_load(held, punch, tilted, 70.0)


def test_what_has_not_converged_is_refused_unless_asked_for():
    hasty = SolverSettings(tolerance=1e-6, max_rounds=1, max_iterations=2)
    with pytest.raises(
        SimulationError, match=r"expected the contact solved to .* mm, got .* mm after \d+ iterations; take"
    ):
        pressed(model(settings=hasty), Pose(depth_mm=1.0))
    found = pressed(
        model(settings=SolverSettings(tolerance=1e-6, max_rounds=1, max_iterations=2, must_converge=False)),
        Pose(depth_mm=1.0),
    )
    assert found.residual_mm > 1e-6
    exact = pressed(model(settings=EXACT), Pose(depth_mm=1.0))
    assert exact.residual_mm <= 1.001e-7
    assert exact.iterations > found.iterations
