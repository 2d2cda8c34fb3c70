"""The page of a guided calibration in a real browser: a simulated sensor is calibrated to its certificate."""

import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from subprocess import PIPE
from urllib.request import urlopen

import numpy as np
import pytest
from page_client import LOCAL, page_client
from page_walk import find_layout_faults
from playwright.sync_api import Browser, Page
from reading_clients import page_errors
from small_calibrated_twin import TWIN, PluggedCamera
from small_sensor import sensor_folder, wait_until

from ninedtact.calibration.guidance import search_board_pins
from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.cli.calibrate import CalibrateCommand
from ninedtact.design import SensorDesign
from ninedtact.studio.calibration_page import CalibrationPage
from ninedtact.studio.calibration_session import CalibrationPhase, CalibrationSession
from ninedtact.studio.guided_session import SwitchableCamera
from ninedtact.studio.page_server import page_server

PATIENCE_S = 120.0


def test_a_simulated_sensor_is_calibrated_in_the_browser_to_its_certificate(browser: Browser, tmp_path: Path) -> None:
    camera, settings = PluggedCamera(TWIN, SensorDesign(), rate_hz=60.0), CalibrationSettings(method="ratio")
    session = CalibrationSession(
        SwitchableCamera(lambda address: camera, "sim"),
        tmp_path / "s",
        settings=settings,
        sensor_id="s",
        on_step=camera.follow,
    )
    desk, phone = (
        browser.new_page(viewport={"width": w, "height": h}, accept_downloads=True)
        for w, h in ((1280, 800), (390, 844))
    )
    errors, cameras = (page_errors(desk), page_errors(phone)), {"sim": "simulated sensor"}
    with page_server(LOCAL) as server, session:
        page = CalibrationPage(server, session, lambda: cameras, camera)

        def wait(is_true: Callable[[], bool]) -> None:
            wait_until(lambda: page.refresh() or is_true(), PATIENCE_S, pause_s=0.05)

        def says(tab: Page, text: str) -> bool:
            return text in tab.inner_text("body")

        for tab in (desk, phone):
            tab.goto(f"http://127.0.0.1:{server.port}")
            wait(lambda tab=tab: says(tab, "Choose the camera") and says(tab, "sharpness"))
        assert not says(desk, "replace the sensor") and phone.locator("img").count() > 0
        assert phone.evaluate("document.documentElement.scrollWidth") == 390
        box = phone.get_by_role("button", name="Start").bounding_box()
        assert box is not None and box["width"] > 330  # the controls fill the phone

        with page_client(server) as client:

            def offers(*names: str) -> bool:
                menu = client.control("camera")
                return (*menu.options,) == names and menu.value == names[0]

            cameras["/dev/video9"] = "a camera"  # is plugged in
            wait(lambda: offers("sim: simulated sensor", "/dev/video9: a camera"))
            cameras.clear()  # the one that is shown stays, even if it was unplugged
            wait(lambda: offers("sim: simulated sensor"))

        desk.get_by_role("button", name="brighter").click()
        wait(lambda: session.state.exposure is not None and session.state.exposure.now_ms == 12.5)
        wait(lambda: session.state.quality is not None and session.state.quality.mean_grey > 180)
        phone.get_by_role("button", name="darker").click()
        wait(lambda: session.state.quality is not None and session.state.quality.mean_grey < 170)
        desk.get_by_label("press automatically").uncheck()
        wait(lambda: not camera.plays_by_itself)
        phone.get_by_role("button", name="Start").click()
        wait(lambda: says(desk, "Press the pin board (9 x 7 pins)") and says(phone, "nothing touches the skin yet"))
        desk.get_by_role("button", name="board", exact=True).click()
        wait(lambda: says(phone, "the board is held 0.85 mm deep"))
        wait(lambda: session.state.step == 2)
        assert session.state.phase is CalibrationPhase.CAPTURE
        sensor_folder(session.out)  # another sensor appears at the folder to write
        phone.get_by_label("press automatically").check()
        wait(lambda: says(desk, "This calibration is refused.") and says(desk, "holds a calibrated sensor"))
        for tab in (desk, phone):
            tab.reload()
            wait(lambda tab=tab: says(tab, "This calibration is refused."))

        desk.get_by_label("replace the sensor").check()
        desk.get_by_role("button", name="Calibrate again from the images").click()
        wait(lambda: says(phone, "Calibrating.") or session.state.phase is CalibrationPhase.RESULT)
        wait(lambda: all(says(tab, "Pins: found 63 of 63.") and says(tab, "Saved in") for tab in (desk, phone)))
        with phone.expect_download() as download:
            phone.get_by_role("button", name="Download the certificate").click()
        assert b"<html" in download.value.path().read_bytes()
        assert [find_layout_faults(tab) for tab in (desk, phone)] == [[], []]
        assert not session.live_requested.is_set()
        desk.get_by_role("button", name="Open the sensor live").click()
        wait(session.live_requested.is_set)
    assert load_sensor(session.out).id == "s" and errors == ([], [])


def test_the_command_serves_the_page_until_ctrl_c_and_writes_nothing(tmp_path: Path) -> None:
    options = ["--page", "--source", "sim", "--port", "0", "--out", str(tmp_path / "s")]
    command = subprocess.Popen(
        [sys.executable, "-m", "ninedtact", "calibrate", *options], stdout=PIPE, stderr=PIPE, text=True
    )
    assert command.stdout is not None
    address = re.search(r"open (http://127.0.0.1:\d+) in a browser; Ctrl-C ends", command.stdout.readline())
    assert address is not None
    with urlopen(address[1], timeout=60) as page:
        assert page.status == 200
    command.send_signal(signal.SIGINT)
    _, complained = command.communicate(timeout=60)
    assert command.returncode == 1 and not (tmp_path / "s").exists()
    assert re.fullmatch(r"ninedtact: stopped before the calibration was complete; \S+ is as it was\n", complained)


def test_the_terminal_guides_through_the_presses_of_a_simulated_sensor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "ninedtact.cli.guided_capture.simulated_calibration_camera",
        lambda design: PluggedCamera(TWIN, design, rate_hz=60.0),
    )
    images = CalibrateCommand(tmp_path / "s", source="sim").obtain_images()
    assert images.board_pair is not None and images.ball_pair is not None
    assert search_board_pins(*images.board_pair, SensorDesign(), CalibrationSettings()).found == 63
    darkening = np.subtract(*(image.astype(float) for image in images.ball_pair))
    assert darkening.max() > 20 and images.ball_pair[0].shape == (240, 320, 3)
