"""The twin's camera sees what presses it, and the twin's force/torque sensor feels the same."""

from dataclasses import replace

import numpy as np
import pytest
from small_press_simulation import TWIN, small_press_simulation

from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Ball
from ninedtact.simulation.gel_brightness import BrightnessModel
from ninedtact.simulation.ground_truth import true_height_map
from ninedtact.simulation.pixel_to_skin_map import WideAngleLens
from ninedtact.simulation.renderer import CameraNoise, Renderer
from ninedtact.simulation.simulated_sources import NO_FORCE_TORQUE_ERRORS, SimulatedCamera, SimulatedForceTorque
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import default_twin

QUIET = CameraNoise(0.0)
EVEN = np.full((480, 640, 3), 160, np.float32)
EVENLY_LIT = Renderer(WideAngleLens().pixel_map(), EVEN, BrightnessModel(), QUIET)


def factor(contact: Contact) -> np.ndarray:
    return EVENLY_LIT.render_without_noise(contact)[..., 1] / 160


def test_an_untouched_twin_gives_its_untouched_image_and_noise() -> None:
    images = np.array([TWIN.renderer(TWIN.model.initial_contact(), number) for number in range(16)], float)
    assert np.array_equal(images[3], TWIN.renderer(None, 3))
    np.testing.assert_allclose(images.mean(axis=0), TWIN.renderer.reference, atol=2.0)
    spread = images.std(axis=0, ddof=1)
    assert np.sqrt((spread**2).mean()) == pytest.approx(np.hypot(0.7, 0.29), rel=0.03)  # with rounding to 8 bits
    quiet = replace(TWIN.renderer, noise=QUIET)
    assert np.abs(quiet(None).astype(float) - TWIN.renderer.reference).max() <= 0.5


def test_the_same_seed_gives_the_same_bytes() -> None:
    def first_images(seed: int) -> list[bytes]:
        stage = small_press_simulation()
        stage.twin = default_twin(seed)
        with SimulatedCamera(stage) as camera:
            return [camera.read().image.tobytes() for _ in range(8)]

    assert first_images(3) == first_images(3)
    assert not set(first_images(3)) & set(first_images(4))


def test_camera_and_force_torque_sensor_see_one_motion() -> None:
    stage = small_press_simulation()
    camera, sensor = SimulatedCamera(stage), SimulatedForceTorque(stage, hz=10.0, errors=NO_FORCE_TORQUE_ERRORS)
    with camera, sensor:
        pairs = [(camera.read(), sensor.read()) for _ in range(int(stage.round_s * 10))]
    untouched = TWIN.renderer.reference[..., 1]
    assert all(frame.stamp_ns == wrench.stamp_ns for frame, wrench in pairs)
    darkness = np.array([np.percentile(untouched - frame.image[..., 1], 99) for frame, _ in pairs])
    load = np.array([-wrench.force_n[2] for _, wrench in pairs])
    assert np.corrcoef(darkness, load)[0, 1] > 0.9
    assert load[darkness.argmax()] == pytest.approx(load.max(), rel=0.05) and load.max() > 2


def test_the_front_of_a_drag_is_brighter_than_its_back() -> None:
    dragged = factor(ScriptedPress(1.2, drag_mm=(1.0, 0.0)).simulate(TWIN, Ball(4.0)))
    row, middle = 240, 640 // 2 + 24
    back, front = dragged[row, middle - 200 : middle].max(), dragged[row, middle : middle + 200].max()
    assert front > back + 0.03


def test_a_mirrored_press_gives_the_mirrored_image() -> None:
    press = ScriptedPress(1.0, at_mm=(2.0, -1.0), drag_mm=(0.6, 0.3))
    mirrored = replace(press, at_mm=(-2.0, -1.0), drag_mm=(-0.6, 0.3))
    one, other = (factor(each.simulate(TWIN, Ball(4.0))) for each in (press, mirrored))
    assert one == pytest.approx(other[:, ::-1], abs=2e-3)


def test_pressed_skin_is_seen_displaced_outwards() -> None:
    contact = ScriptedPress(1.5, at_mm=(7.0, 0.0)).simulate(TWIN, Ball(4.0))
    place, seen = (true_height_map(contact, (1, 401), 0.05, nearness) for nearness in (0.0, 0.05))
    x_place, x_seen = (float(height.axes_mm[0][height.z_mm[0].argmin()]) for height in (place, seen))
    assert x_place == pytest.approx(7.0, abs=0.11)  # half a cell of the simulated skin
    # The line of sight through P meets the skin at P(1 + z/D): what is 1.5 mm deep at 7 mm is seen at 7/(1 − 1.5 · 0.05).
    assert x_seen == pytest.approx(7.0 / (1 - 1.5 * 0.05), abs=0.12)
    assert seen.camera_distance_mm == 20 and np.isinf(place.camera_distance_mm)
    assert seen.z_mm.min() == pytest.approx(-1.5, abs=0.02)
