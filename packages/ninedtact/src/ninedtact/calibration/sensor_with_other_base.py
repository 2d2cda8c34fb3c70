"""A calibrated sensor on another base of its gel: the ball of its calibration, explained again with the base held.

A base that yields more moves depth, thickness and light of the fit with it, so that the image of the ball stays explained. Lens and
viewing distance come from the board and stay as they are.
"""

from dataclasses import replace

import msgspec
from threadpoolctl import threadpool_limits

from ninedtact.calibration.ball.ball_fit import fit_ball_by_physics
from ninedtact.calibration.ball.ball_press import find_ball_press
from ninedtact.calibration.brightness_change import estimate_camera_noise, flat_fielded_brightness_change
from ninedtact.calibration.fits_to_sensor_toml import (
    depth_curve_to_toml_table,
    fitted_ball_press,
    make_ball_quality,
    twin_to_toml_table,
)
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.calibration.twin.gel_base import KnownBase
from ninedtact.calibration.twin.press_search import ParameterPrior
from ninedtact.simulation.calibration_press_models import BallPressModel


def sensor_with_other_base(folder: SensorFolder, base: KnownBase) -> SensorFolder:
    """Return the sensor, not saved, as its calibration would be with this base: with the modulus of the design.

    Raises what reading images and fitting raise.
    """
    record, depth, twin = folder.record, folder.depth, folder.record.twin
    assert twin is not None, "expected a sensor whose calibration fitted the gel, got one without a twin"
    images = folder.stored_image("ball_reference").image, folder.stored_image("ball").image
    initial = replace(fitted_ball_press(twin), gel_to_base_modulus_ratio=base.modulus_ratio)
    with threadpool_limits(1):
        press = find_ball_press(folder.rectification, *images, record.design.ball, "physics")
        ball = fit_ball_by_physics(press, record.design, _viewing_distance(folder), (initial,), base=base)
        noise_grey_levels = estimate_camera_noise(flat_fielded_brightness_change(*images))
        depth = depth_curve_to_toml_table(ball, folder.rectification, images[0], noise_grey_levels, depth.smoothing)
    fitted = twin_to_toml_table(ball.twin_fit, twin.noise_grey_levels, None)
    fitted = msgspec.structs.replace(fitted, board_press=twin.board_press)
    certificate = record.certificate
    if certificate is not None:
        quality = make_ball_quality(images[0], ball, record.design, depth.noise_mm)
        certificate = msgspec.structs.replace(certificate, ball=quality)
    new = msgspec.structs.replace(record, depth=depth, twin=fitted, known_loads=None, certificate=certificate)
    return SensorFolder(folder.path, new, folder.is_edited, folder.has_checksum)


def load_on_calibration_ball_n(folder: SensorFolder) -> float:
    """Return the load on the ball of the calibration, by the mechanics that explain its image and the modulus of the gel."""
    contact = BallPressModel(folder.record.design).contact(fitted_ball_press(folder.require_twin()))
    return float(-contact.wrench().force_n[2]) * folder.gel.shear_modulus_mpa


def _viewing_distance(folder: SensorFolder) -> tuple[ParameterPrior, ...]:
    """Return the prior of the viewing distance that the image of the board gave the fit of the ball."""
    assert folder.record.twin is not None
    board = folder.record.twin.board_press
    if board is None or not board.accepted:
        return ()
    name = "inverse_distance_per_mm"
    return (ParameterPrior(name, board.inverse_distance_per_mm, board.inverse_distance_std_per_mm),)
