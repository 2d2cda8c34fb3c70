"""The torque of a twist by closed forms, its memory, and what it adds to the estimate of an image that hides it."""

from dataclasses import replace

import numpy as np
import pytest

from ninedtact.design import Gel
from ninedtact.mechanics.closed_forms import hertz_contact, mindlin_shear_force_n
from ninedtact.quantities import Traction, Wrench, WrenchEstimate, diagonal_covariance
from ninedtact.tracking.carried_shear import CarriedShear, CarriedSkin
from ninedtact.tracking.object_tracker import ObjectMotion, TrackState
from ninedtact.tracking.rigid_motion import RigidMotion

RADIUS_MM, PRESSURE_MPA, PITCH_MM = 4.0, 0.1, 0.25
LOAD_N = np.pi * RADIUS_MM**2 * PRESSURE_MPA
NO_LOAD_N = np.zeros(2)
"""Load along the skin of a turn about the middle."""
THICK = Gel(thickness_mm=20.0, gel_to_base_modulus_ratio=0.0)
THIN = Gel(thickness_mm=0.5, gel_to_base_modulus_ratio=0.0)


def disc_at(motion: RigidMotion, gel: Gel) -> Traction:
    """The pressure of a flat disc whose middle was at (1, -0.5)."""
    rows, cols = 80, 90
    x, y = ((np.arange(side) - (side - 1) / 2) * PITCH_MM for side in (cols, rows))
    middle = motion(np.array([1.0, -0.5, 0.0]))
    away_mm = np.hypot(x[None, :] - middle[0], y[:, None] - middle[1])
    pressed = np.clip((RADIUS_MM - away_mm) / PITCH_MM + 0.5, 0, 1)
    return Traction(np.float32(PRESSURE_MPA * pressed), np.zeros((2, rows, cols), np.float32), PITCH_MM, gel=gel)


def turned(angle_rad: float, path: int = 1, std_rad: float = 1e-4) -> ObjectMotion:
    """A turn about the middle of the disc."""
    middle, cos, sin = np.array([1.0, -0.5, 0.0]), np.cos(angle_rad), np.sin(angle_rad)
    rotation = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    motion = RigidMotion(rotation, middle - rotation @ middle)
    return ObjectMotion(TrackState.TRACKED, path=path, motion=motion, covariance=std_rad**2 * np.eye(6))


def follow(angles_rad: list[float], gel: Gel, friction: float = 0.5, times: float = 1.0) -> list[CarriedShear]:
    """times: how many times the pressure is."""
    skin, found = CarriedSkin(), []
    for angle in angles_rad:
        motion = turned(angle)
        traction = disc_at(motion.motion, gel)
        traction = replace(traction, pressure_mpa=np.float32(times) * traction.pressure_mpa)
        one = skin.update(motion, traction, NO_LOAD_N, friction)
        assert one is not None
        found.append(one)
    return found


@pytest.mark.parametrize("gel", [THICK, THIN], ids=["thick", "thin"])
def test_a_disc_that_sticks_twists_the_gel_by_the_closed_forms(gel: Gel) -> None:
    """Reissner and Sagoci's 16/3 G a³ θ on a half-space, and beside it the torsion of a bonded layer, G θ π a⁴/(2 h)."""
    angle_rad, rim_mm = 0.1, RADIUS_MM + PITCH_MM / 2  # cells that are partly covered stick, too
    expected_nmm = gel.shear_modulus_mpa * angle_rad * (16 / 3 * rim_mm**3 + np.pi / 2 * rim_mm**4 / gel.thickness_mm)
    found = follow([0.0, angle_rad], gel, times=100.0)[-1]
    assert 1e3 * found.torque_nm == pytest.approx(expected_nmm, rel=0.1)
    assert found.sticking_share > 0.99 and found.p_incipient < 0.05
    assert found.centre_mm == pytest.approx([1.0, -0.5], abs=0.02)


def test_it_slides_from_the_rim_inwards_until_friction_bears_all_and_turning_back_undoes_it() -> None:
    angles = list(np.linspace(0, 0.6, 13))
    found = follow([*angles, *angles[-2::-1]], Gel())
    torques, shares = ([getattr(one, name) for one in found] for name in ("torque_nm", "sticking_share"))
    limit_nm = 0.5 * LOAD_N * 2 / 3 * RADIUS_MM / 1e3
    assert np.diff(torques[:13]).min() > -1e-3 * limit_nm and torques[12] == pytest.approx(limit_nm, rel=0.1)
    assert np.diff(shares[:13]).max() < 0 and shares[12] < 0.2 < 0.75 < shares[13]
    assert found[12].p_incipient > 0.9 and found[12].is_turn_under(0.1) and not found[12].is_turn_under(3.0)
    assert torques[-1] < -0.5 * limit_nm, "skin that slid one way is left twisted the other way"


def test_what_slid_does_not_stick_again_where_the_pressure_is_noisy() -> None:
    skin, rng, pressed = CarriedSkin(), np.random.default_rng(0), disc_at(RigidMotion(), Gel())
    for angle in (*np.linspace(0, 0.5, 6), *[0.5] * 6):
        noisy = pressed.pressure_mpa * rng.normal(1, 0.02, pressed.pressure_mpa.shape)
        found = skin.update(turned(angle), replace(pressed, pressure_mpa=noisy.astype(np.float32)), NO_LOAD_N, 0.5)
    assert found is not None and found.sticking_share < 0.3 and found.p_incipient > 0.9


def test_friction_that_is_not_known_is_part_of_the_error() -> None:
    known, unknown = (follow([0.0, 0.15, 0.3], Gel(), friction)[-1] for friction in (0.5, float("nan")))
    assert unknown.torque_nm == pytest.approx(known.torque_nm, rel=0.15)
    assert unknown.torque_std_nm > 1.5 * known.torque_std_nm
    assert 0.5 < unknown.p_incipient < known.p_incipient


@pytest.mark.parametrize("friction", [0.2, 1.2])
def test_the_load_along_the_skin_tells_friction_and_so_what_sticks(friction: float) -> None:
    """Under the load of Cattaneo and Mindlin, the part of a dragged ball sticks that they say."""
    ball, pixels_mm = hertz_contact(THICK, 8.0, 0.6), (np.arange(90) - 44.5) * PITCH_MM
    drag_mm = 0.3
    drag_n = mindlin_shear_force_n(THICK, ball, friction, drag_mm)
    skin, none = CarriedSkin(), np.zeros((2, 90, 90), np.float32)
    for along_mm, along_n in ((0.0, 0.0), (drag_mm, drag_n)):
        squared = (pixels_mm[:, None] ** 2 + (pixels_mm - along_mm) ** 2) / ball.radius_mm**2
        pressure_mpa = np.float32(ball.peak_mpa * np.sqrt(np.maximum(1 - squared, 0)))
        moved = replace(turned(0.0), motion=RigidMotion(translation_mm=np.array([along_mm, 0.0, 0.0])))
        traction = Traction(pressure_mpa, none, PITCH_MM, gel=THICK)
        found = skin.update(moved, traction, np.array([along_n, 0.0]), float("nan"))
    area = max(1 - drag_n / (friction * ball.load_n), 0) ** (2 / 3)
    sticking = 1 - (1 - area) ** 1.5
    assert found is not None and found.sticking_share == pytest.approx(sticking, abs=0.12)


def test_a_turn_that_is_not_seen_tells_nothing_and_the_skin_outlasts_a_path() -> None:
    skin = CarriedSkin()
    pressed = disc_at(RigidMotion(), Gel())
    assert skin.update(turned(0.0), pressed, NO_LOAD_N, 0.5) is not None
    assert skin.update(turned(0.3, std_rad=0.3), pressed, NO_LOAD_N, 0.5) is None
    seen_again = skin.update(turned(0.1), pressed, NO_LOAD_N, 0.5)
    assert seen_again is not None and seen_again.torque_nm > 0, "what it turned meanwhile counts"
    on_another_path = skin.update(turned(0.4, path=2), pressed, NO_LOAD_N, 0.5)
    assert on_another_path is not None
    assert on_another_path.torque_nm == pytest.approx(seen_again.torque_nm, rel=0.01)
    turned_back = skin.update(turned(0.3, path=2), pressed, NO_LOAD_N, 0.5)
    assert turned_back is not None and turned_back.torque_nm == pytest.approx(0, abs=0.1 * seen_again.torque_nm)
    skin.release()
    anew = skin.update(turned(0.4, path=2), pressed, NO_LOAD_N, 0.5)
    assert anew is not None and anew.torque_nm == pytest.approx(0, abs=1e-9)


def test_the_torque_of_an_image_that_hides_it_is_replaced_and_of_one_without_a_twist_made_sure() -> None:
    """Where the image says 0 ± 5 N·mm, a twist of 8 N·mm is believed, and no twist leaves less than a tenth of the error."""
    std = np.array([0.1, 0.1, 0.2, 5e-4, 5e-4, 5e-3])
    estimate = WrenchEstimate(
        Wrench(np.array([0.2, 0.0, -5.0]), np.array([1e-3, 2e-3, 0.0])), diagonal_covariance(std), touching=True
    )
    twisted = replace(follow([0.0, 0.6], Gel())[-1], torque_nm=8e-3, torque_std_nm=1e-3)
    still = follow([0.0, 0.0], Gel())[-1]
    found = twisted.correct(estimate)
    assert found.wrench.torque_nm[2] == pytest.approx(8e-3, rel=0.1) and found.std[5] < 1.1e-3
    assert found.wrench.six[:5] == pytest.approx(estimate.wrench.six[:5], abs=0.005)
    assert still.correct(estimate).std[5] < 5e-4 and abs(still.correct(estimate).wrench.torque_nm[2]) < 1e-4


def test_a_torque_without_a_stated_error_is_that_of_the_motion() -> None:
    unstated = WrenchEstimate(
        Wrench(np.array([0.0, 0.0, -5.0]), np.zeros(3)), np.diag(np.full(6, np.inf)), touching=True
    )
    twisted = follow([0.0, 0.6], Gel())[-1]
    assert twisted.correct(unstated).wrench.torque_nm[2] == pytest.approx(twisted.torque_nm, rel=1e-3)


def test_pressure_that_bears_no_torque_tells_nothing() -> None:
    """On a single cell, under a load that is not known, and where the object is seen to have left the skin that is pressed."""
    cell = np.zeros((29, 37), np.float32)
    cell[14, 18] = PRESSURE_MPA
    point = Traction(cell, np.zeros((2, 29, 37), np.float32), 0.6)
    assert CarriedSkin().update(turned(0.0), point, NO_LOAD_N, 0.5) is None
    skin, pressed = CarriedSkin(), disc_at(RigidMotion(), Gel())
    unknown = replace(pressed, pressure_mpa=pressed.pressure_mpa * np.float32(np.nan))
    assert skin.update(turned(0.0), unknown, NO_LOAD_N, 0.5) is None
    assert skin.update(turned(0.0), pressed, NO_LOAD_N, 0.5) is not None
    assert skin.update(turned(0.0), unknown, NO_LOAD_N, 0.5) is None
    found = skin.update(turned(0.1), pressed, NO_LOAD_N, 0.5)
    assert found is not None and found.torque_nm > 0
    gone = replace(turned(0.0), motion=RigidMotion(translation_mm=np.array([60.0, 0.0, 0.0])))
    assert skin.update(gone, pressed, NO_LOAD_N, 0.5) is None
