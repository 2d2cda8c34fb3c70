"""Twins of six real sensors have the light and the gel that were fitted, and can be pressed as their calibration says."""

import numpy as np
import pytest
from real_sensor_twins import REAL_FITS, RealFit, twins_of_real_fits

from ninedtact.mechanics.indenter import Ball
from ninedtact.simulation.trajectory import ScriptedPress


def test_there_are_six_by_name_and_they_are_the_same_every_time() -> None:
    assert list(twins_of_real_fits()) == ["A", "I", "L", "P", "Q", "R"]
    assert twins_of_real_fits() == twins_of_real_fits()


@pytest.mark.parametrize("fit", REAL_FITS, ids=lambda fit: fit.name)
def test_a_twin_is_what_was_fitted(fit: RealFit) -> None:
    sensor = twins_of_real_fits()[fit.name]
    assert sensor.light == fit.light and sensor.gel.thickness_mm == fit.thickness_mm
    assert sensor.design.pin_board.pitch_mm == fit.board_pitch_mm
    assert sensor.presses.ball_depth_mm <= min(fit.ball_depth_mm, 0.9 * fit.thickness_mm)
    twin = sensor.twin(0.4)
    pressed = ScriptedPress(0.4 * fit.thickness_mm).simulate(twin, Ball(4.0))
    reference, image = (twin.renderer(contact, number).astype(float) for number, contact in enumerate((None, pressed)))
    ratio = image.mean(axis=2) / np.maximum(reference.mean(axis=2), 1)
    assert ratio.min() < 0.98 < 1.005 < ratio.max()
    # A wider board comes with a lens that sees as many of its pins.
    assert twin.renderer.pixel_map.reach_mm[0] / fit.board_pitch_mm == pytest.approx(5.85, rel=0.05)
