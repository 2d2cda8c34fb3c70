"""A distribution over sensors: the same for one seed, spread as real ones are."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from real_sensor_twins import REAL_FITS

from ninedtact.calibration.certificate.length_evidence import ball_clues, board_clues, probabilities_of_wrong_lengths
from ninedtact.design import PUBLISHED_MM_PER_PX, Gel, SensingArea, SensorDesign, rectified_mm_per_px
from ninedtact.errors import InputError
from ninedtact.mechanics.indenter import Ball, FlatPunch
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.gel_brightness import (
    FITTED_PARAMETERS,
    BrightnessModel,
    GlarePatch,
)
from ninedtact_train.population.mechanics_shares import MechanicsShares
from ninedtact_train.population.sensor_population import (
    CalibrationMisalignment,
    SampledSensor,
    misaligned_pixel_positions_mm,
    raw_pixels_seeing,
    rectified_renderer,
    sample_sensor,
    sampled_sensor_from_json,
)

MANY = 300
ALL_LAYERED, ALL_LINEAR = MechanicsShares(0, 0), MechanicsShares(0, 1)


@pytest.fixture(scope="module")
def members() -> list[SampledSensor]:
    return [sample_sensor(number) for number in range(MANY)]


def test_a_member_does_not_depend_on_who_else_is_asked_for(members: list[SampledSensor]) -> None:
    assert sample_sensor(17) == members[17]
    assert sample_sensor(17, seed=1) != members[17]
    assert len({one.name for one in members}) == MANY


def test_a_member_survives_being_written_down(members: list[SampledSensor]) -> None:
    for one in members[:6]:
        assert sampled_sensor_from_json(json.loads(json.dumps(one.to_json_dict()))) == one


@pytest.mark.parametrize("name", ["darkening_per_mm", "brightening_per_mm", "point_spread_mm"])
def test_light_is_spread_about_the_middle_of_the_real_fits(name: str, members: list[SampledSensor]) -> None:
    logs = np.log([getattr(one.light, name) for one in members])
    real = np.log([getattr(fit.light, name) for fit in REAL_FITS])
    wanted = FITTED_PARAMETERS[name]
    assert logs.mean() == pytest.approx(np.log(wanted.median), abs=0.05)
    assert logs.std() == pytest.approx(wanted.spread, rel=0.15)
    assert abs(real.mean() - np.log(wanted.median)) < wanted.spread
    assert real.std() < wanted.spread * 1.1


@given(st.lists(st.floats(0, 1), min_size=len(REAL_FITS), max_size=len(REAL_FITS)).filter(lambda some: sum(some) > 0.1))
def test_real_sensors_and_every_mixture_of_them_are_usual(weights: list[float]) -> None:
    share = np.array(weights) / sum(weights)
    mixed = {name: float(share @ [getattr(fit.light, name) for fit in REAL_FITS]) for name in vars(BrightnessModel())}
    gel = Gel(float(share @ [fit.thickness_mm for fit in REAL_FITS]))
    assert wrong_probability(BrightnessModel(**mixed), gel, SensorDesign()) < 0.12


def wrong_probability(light: BrightnessModel, gel: Gel, design: SensorDesign) -> float:
    """The probability of a wrong length that is stated of a sensor whose lengths are right."""
    board = board_clues(PUBLISHED_MM_PER_PX, 640, 0.63, 0.48, design)
    return probabilities_of_wrong_lengths(board + ball_clues(light, gel, design), design).wrong_probability


def test_a_base_that_yields_lets_a_ball_sink_deeper() -> None:
    based = sample_sensor(3, kinds=ALL_LAYERED)
    based = replace(based, gel=replace(based.gel, gel_to_base_modulus_ratio=0.1))
    rigid = replace(based, gel=replace(based.gel, gel_to_base_modulus_ratio=0.0))
    depths = []
    for one in (rigid, based):
        twin = one.twin(0.3)
        depths.append(twin.press(None, Ball(), Pose(depth_mm=0.8), 4.0).pose.depth_mm)
    assert 1.03 < depths[1] / depths[0] < 1.3


def test_finite_strain_weighs_more_and_piles_up_higher() -> None:
    bonded = sample_sensor(3, kinds=ALL_LINEAR)
    stiffens = replace(bonded, gel=replace(bonded.gel, finite_strain=1.0))
    linear, stiff = (one.twin(0.3).press(None, FlatPunch(2.0), Pose(depth_mm=1.0)) for one in (bonded, stiffens))
    assert linear.corrected is linear.solved and linear.stiffening == 1
    assert 1.1 < stiff.load_n / linear.load_n < 1.5
    assert stiff.stiffening == pytest.approx(stiff.load_n / stiff.linear_load_n, rel=1e-5)
    assert stiff.corrected.height_mm.max() > 1.03 * linear.corrected.height_mm.max()
    assert stiff.corrected.height_mm.min() == linear.corrected.height_mm.min()
    light = stiffens.twin(0.3).press(None, Ball(), Pose(depth_mm=0.05))
    assert light.wrench.six == pytest.approx(light.solved.wrench().six, rel=2e-3, abs=1e-6)


def test_members_of_another_design_are_those_of_the_published_one_carried_to_it(members: list[SampledSensor]) -> None:
    wide = SensorDesign(gel=Gel(1.25, 0.2), sensing_area=SensingArea(36, 27))
    for number, usual in enumerate(members[:6]):
        ours = sample_sensor(number, design=wide)
        assert ours.gel.thickness_mm == pytest.approx(usual.gel.thickness_mm / 2)
        assert ours.gel.shear_modulus_mpa / wide.gel.shear_modulus_mpa == pytest.approx(
            usual.gel.shear_modulus_mpa / Gel().shear_modulus_mpa
        )
        assert (ours.kind, ours.friction, ours.misalignment) == (usual.kind, usual.friction, usual.misalignment)
        deep = np.array([-0.4])
        assert ours.light.brightness_change(deep)[0] < 1.2 * usual.light.brightness_change(deep)[0] < 0, (
            "thinner gel darkens sooner"
        )
        twin = ours.twin()
        assert (twin.area_mm, twin.gel_mm) == ((36.0, 27.0), wide.sensing_area.gel_mm)
        x_mm = rectified_renderer(ours, (92, 69)).renderer.pixel_map.plane_mm[34, :, 0]
        assert x_mm[-1] - x_mm[0] == pytest.approx(36 * 91 / 92, rel=0.015)


def test_the_rectified_image_is_that_of_the_raw_one_rectified() -> None:
    one = replace(sample_sensor(2, kinds=ALL_LINEAR), misalignment=CalibrationMisalignment(), noise_grey_levels=1e-6)
    twin, eye = one.twin(), rectified_renderer(one, (460, 345))
    contact = twin.press(None, Ball(), Pose(2.0, -1.0, 1.2)).corrected
    seen = eye.render(contact, np.random.default_rng(0)).astype(float)
    raw = cv2.cvtColor(twin.renderer.render_without_noise(contact), cv2.COLOR_BGR2GRAY)
    at = raw_pixels_seeing(
        one.pixel_map,
        misaligned_pixel_positions_mm((460, 345), rectified_mm_per_px((460, 345)), CalibrationMisalignment()),
    )
    rectified = cv2.remap(raw, at[..., 0].copy(), at[..., 1].copy(), cv2.INTER_LINEAR)
    assert np.ptp(seen - eye.reference) > 12
    assert np.abs(seen - rectified).mean() < 0.4
    assert np.abs(seen - rectified).max() < 2.5


def test_light_of_reflections_stays_as_it_is_under_a_contact() -> None:
    glare = (GlarePatch((0.3, -0.2), 0.1, 0.06), GlarePatch((-0.8, 0.7), 0.05, 0.03))
    shiny = replace(sample_sensor(2, kinds=ALL_LINEAR), glare=glare)
    plain, reflecting = replace(shiny, glare=()).twin(), shiny.twin()
    contact = plain.press(None, Ball(), Pose(2.0, -1.0, 1.2)).corrected
    added = [
        (lit.astype(float) - dull).mean(axis=-1)
        for lit, dull in (
            (reflecting.renderer.reference, plain.renderer.reference),
            (reflecting.renderer.render_without_noise(contact), plain.renderer.render_without_noise(contact)),
        )
    ]
    assert added[0].max() == pytest.approx(0.06 * plain.renderer.reference.mean(), rel=0.01)
    np.testing.assert_allclose(added[1], added[0], atol=0.02)
    # The rectified image shows the same reflections.
    of_grid = [rectified_renderer(one, (92, 69)) for one in (shiny, replace(shiny, glare=()))]
    factors = [one.brightness_factor(contact) for one in of_grid]
    assert factors[0] is not None and factors[1] is not None
    added_to_grid = of_grid[0].reference * factors[0] - of_grid[1].reference * factors[1]
    np.testing.assert_allclose(added_to_grid, of_grid[0].reference - of_grid[1].reference, atol=0.1)


def test_noise_is_new_in_every_image_and_as_strong_as_it_is_said_to_be() -> None:
    one = sample_sensor(5)
    eye, rng = rectified_renderer(one, (460, 345)), np.random.default_rng(0)
    first, second = (eye.render(None, rng).astype(float) for _ in range(2))
    rounding = 1 / 6
    assert (first - second).std() == pytest.approx(np.sqrt(2 * one.noise_grey_levels**2 + rounding), rel=0.03)


@pytest.mark.parametrize(
    "wrong",
    [
        lambda: sample_sensor(-1),
        lambda: sample_sensor(0, -1),
        lambda: MechanicsShares(0.7, 0.6),
        lambda: MechanicsShares(-0.1),
    ],
)
def test_members_that_cannot_be_drawn_are_refused(wrong: object) -> None:
    with pytest.raises(InputError, match="expected"):
        wrong()  # type: ignore[operator]
