"""A guided calibration of a simulated sensor, without a browser: what all viewers of its page share."""

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_calibrated_twin import TWIN, PluggedCamera
from small_sensor import sensor_folder, wait_until

from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.capture.frame_source import FrameSource
from ninedtact.design import SensorDesign
from ninedtact.errors import OutputError
from ninedtact.simulation.calibration_camera import HeldCalibrationObject
from ninedtact.studio.calibration_session import CalibrationPhase, CalibrationSession
from ninedtact.studio.guided_session import ImageQuality, SwitchableCamera, measure_image_quality

PATIENCE_S = 120.0
SETTINGS = CalibrationSettings(method="ratio")


@pytest.fixture
def camera() -> PluggedCamera:
    return PluggedCamera(TWIN, SensorDesign(), plays_by_itself=False, rate_hz=60.0)


@pytest.fixture
def session(camera: PluggedCamera, tmp_path: Path) -> Iterator[CalibrationSession]:
    one = CalibrationSession(
        SwitchableCamera(lambda address: camera, "sim"),
        tmp_path / "s",
        settings=SETTINGS,
        sensor_id="s",
        on_step=camera.follow,
    )
    with one:
        wait_until(lambda: one.state.quality is not None)
        yield one


def at_step(session: CalibrationSession, step: int) -> None:
    wait_until(lambda: session.state.step == step and session.state.phase is CalibrationPhase.CAPTURE)


def test_a_person_is_led_through_both_presses(session: CalibrationSession, camera: PluggedCamera) -> None:
    quality = session.state.quality
    assert quality is not None and 140 < quality.mean_grey < 170 and quality.overexposed_share == 0
    session.start()
    session.start()  # two people press it
    at_step(session, 1)

    camera.hold(HeldCalibrationObject("board", 0.4, tilt_deg=(4.0, 0.0)))
    wait_until(lambda: "harder in the lower part" in session.state.advice)
    state = session.state
    pins = state.pins
    assert pins is not None and 31 < pins.found < 60 and len(pins.missing_px) > 3
    assert state.advice.startswith(f"pins {pins.found} of 63: ")
    assert np.median(pins.missing_px[:, 1]) > 160 and np.median(pins.found_px[:, 1]) < 120  # of 240 rows

    camera.plugged_in = False  # the cable is pulled in the middle of the press
    wait_until(lambda: "plug" in session.state.camera_trouble)
    assert session.state.phase is CalibrationPhase.CAPTURE and session.state.step == 1
    camera.plugged_in = True
    wait_until(lambda: not session.state.camera_trouble)

    camera.hold(camera.good_press("board"))
    at_step(session, 2)
    camera.hold(HeldCalibrationObject())
    at_step(session, 3)
    camera.hold(HeldCalibrationObject("ball", 0.6))
    wait_until(lambda: "press deeper" in session.state.advice)
    session.back()
    session.back()  # the same wish of a second person is not two steps
    assert session.state.step == 2
    camera.hold(HeldCalibrationObject())
    at_step(session, 3)
    other = (sensor_folder(session.out) / "sensor.toml").read_bytes()  # somebody else calibrates there meanwhile
    camera.hold(camera.good_press("ball"))
    wait_until(lambda: session.state.phase is CalibrationPhase.REFUSED)
    assert "holds a calibrated sensor" in session.state.advice and session.state.step == 4
    assert (session.out / "sensor.toml").read_bytes() == other
    with pytest.raises(OutputError):
        session.fit_again()
    session.back()
    assert session.state.step == 2  # the images of the board stay


def test_a_person_who_goes_back_while_an_image_is_measured_is_followed(
    session: CalibrationSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    session.start()
    at_step(session, 1)
    has_gone_back = threading.Event()

    def go_back_and_measure(image: np.ndarray, last: ImageQuality | None) -> ImageQuality:
        if not has_gone_back.is_set():
            session.back()
            has_gone_back.set()
        return measure_image_quality(image, last)

    monkeypatch.setattr("ninedtact.studio.guided_session.measure_image_quality", go_back_and_measure)
    wait_until(has_gone_back.is_set)
    at_step(session, 1)  # the image without contact is taken again


def test_a_sensor_is_not_forgotten_when_one_person_starts_over_and_another_opens_it(
    session: CalibrationSession, camera: PluggedCamera
) -> None:
    camera.plays_by_itself = True
    session.start()
    wait_until(lambda: session.state.phase is CalibrationPhase.RESULT, PATIENCE_S)
    session.start_over()
    session.request_live()
    session.request_force()
    assert not session.live_requested.is_set() and not session.force_requested.is_set()
    assert session.saved is not None and session.saved.path == session.out  # what the command returns
    session.start(replace_sensor=True)
    wait_until(lambda: session.state.phase is CalibrationPhase.RESULT, PATIENCE_S)
    session.request_live()
    session.start_over()
    assert session.live_requested.is_set() and session.state.result is not None


def test_an_existing_sensor_is_replaced_only_by_agreement(session: CalibrationSession) -> None:
    sensor_folder(session.out)
    with pytest.raises(OutputError, match="holds a calibrated sensor; check 'replace the sensor'"):
        session.start()
    assert session.state.phase is CalibrationPhase.PREVIEW and session.would_replace
    session.start(replace_sensor=True)
    assert session.state.phase is CalibrationPhase.CAPTURE


def test_a_refused_press_of_the_simulation_keeps_its_image(camera: PluggedCamera) -> None:
    with camera:
        camera.hold(replace(camera.good_press("ball"), depth_mm=60.0))
        before = time.monotonic()
        image = camera.read().image
        assert camera.refusal and "expected" in camera.refusal and time.monotonic() - before < 60
        untouched = camera._twin.renderer.reference
        assert abs(image.astype(float).mean() - untouched.mean()) < 1


def test_an_error_of_the_program_is_not_kept_from_the_page(tmp_path: Path) -> None:
    def open_source(address: str) -> FrameSource:
        raise ZeroDivisionError

    with (
        CalibrationSession(SwitchableCamera(open_source, "sim"), tmp_path / "s") as session,
        pytest.raises(ZeroDivisionError),
    ):
        wait_until(lambda: session.state.phase is CalibrationPhase.RESULT)
