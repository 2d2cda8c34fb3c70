"""Several sensors on one page: their wrenches and grip force, one recording of all, and a sensor that is lost alone."""

import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from subprocess import PIPE

import numpy as np
import pytest
from page_client import ServedPage, served_page
from page_walk import find_layout_faults
from playwright.sync_api import Browser, Page
from small_sensor import SkinCamera, image_folder, sensor_folder, sensor_on, wait_until
from test_recordings_on_page import ScaledForce

from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.capture.reconnecting import ReconnectingFrameSource
from ninedtact.cli import main
from ninedtact.live.reading_recorder import RecordedSensorMetadata
from ninedtact.live.sensor_poller import SensorPhase, SensorPoller, SensorSnapshot
from ninedtact.live.wrench_history import WrenchHistory, WrenchSourceSnapshot, WrenchWithUncertainty
from ninedtact.quantities import Wrench
from ninedtact.reading import Reading
from ninedtact.recording.reader import Recording, recorded_sensor_addresses
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.studio.page_controller import (
    DisplayedSensor,
    PageMoment,
    SensorMoment,
    SensorStatusMessage,
)
from ninedtact.studio.reading_view import full_range_colour_scale
from ninedtact.studio.recording_player import RecordedSensor, RecordingPlayer
from ninedtact.studio.recordings_panel import RecordingsPanel, RecordingsPanelContext
from ninedtact.studio.saved_files import SaveQuota
from ninedtact.studio.scene_3d import FIELD_OF_VIEW_RAD, GelBlock, SideBySideLayout
from ninedtact.studio.sensor_group import grip_forces

PATIENCE_S = 90.0
SMALLEST_IMAGE_PX = 30


@dataclass
class Gripper(ServedPage):
    """A page of sensors whose skins are pressed by the brightness of their cameras: 2 N for every mm."""

    cameras: dict[str, SkinCamera]
    out: Path

    def refresh_for(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            self.refresh()
            time.sleep(0.03)


@pytest.fixture
def gripper(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Gripper]:
    """As many sensors as the test names, on one page, with a recorder."""
    folder, out, names = load_sensor(sensor_folder(tmp_path / "small")), tmp_path / "readings", request.param
    cameras, quota = {name: SkinCamera(0.03) for name in names}, SaveQuota(per_minute=100)
    recorded = [RecordedSensorMetadata(folder, "bench", has_estimates=True, name=name) for name in names]
    recorder = quota.new_recorder(recorded, out)
    sensors: list[DisplayedSensor] = []
    with ExitStack() as opened:
        opened.callback(recorder.stop)
        for number, (name, camera) in enumerate(cameras.items()):
            sensor = sensor_on(ReconnectingFrameSource(camera, on_lost=lambda loss: None, retry_ms=20.0))
            sensor.estimator = ScaledForce()
            history = WrenchHistory("estimated", "by the bench", states_errors=True)

            def keep(reading: Reading, number: int = number, history: WrenchHistory = history) -> None:
                assert reading.force is not None
                history.add_estimate(reading.force)
                recorder.add(reading, number)

            loop = opened.enter_context(SensorPoller(sensor, keep))
            sensors.append(DisplayedSensor(loop, [history], name=name))
        # A level that a test sets before a sensor has read would become its reference.
        wait_until(lambda: all(one.poller.snapshot(0).reading is not None for one in sensors))
        panel = partial(RecordingsPanel, context=RecordingsPanelContext(folder, recorder))
        served = opened.enter_context(served_page(sensors, out, [panel], quota))
        yield Gripper(served.server, served.controller, served.page, cameras, out)


def moment_with(
    name: str, force_z_n: float, std_n: float, tone: str = "live", source: str = "estimated"
) -> SensorMoment:
    sample = WrenchWithUncertainty(Wrench(np.array([0.1, 0.2, force_z_n]), np.zeros(3)), np.full(6, std_n))
    wrench = WrenchSourceSnapshot(source, "by hand", sample, (), 0, states_errors=True)
    snapshot = SensorSnapshot(SensorPhase.READING, None, 0, 0.0, 0.0, np.zeros((2, 0)))
    return SensorMoment(SensorStatusMessage(tone, "here"), snapshot, None, (wrench,), name=name)  # type: ignore[arg-type]


def test_grip_force_is_the_mean_of_each_two_opposing_normal_forces() -> None:
    four = [moment_with(name, -force, 0.3) for name, force in zip("abcd", (2.0, 4.0, 1.0, 7.0), strict=True)]
    grips = list(grip_forces(four))
    assert [(grip.fingers, grip.force_n) for grip in grips] == [(("a", "b"), 3.0), (("c", "d"), 4.0)]
    assert grips[0].std_n == pytest.approx(0.3)
    assert [grip.fingers for grip in grip_forces(four[:3])] == [("a", "b")]
    (alone,) = grip_forces([four[0], moment_with("b", -4.0, 0.3, tone="lost")])
    assert alone.force_n is None and alone.missing == "b"
    (unknown,) = grip_forces([moment_with("a", 0.0, np.inf), four[1]])
    assert unknown.force_n is None and unknown.missing == "a"
    assert not list(grip_forces([four[0], moment_with("b", -4.0, 0.3, source="true")]))


@pytest.mark.parametrize("gripper", [("left", "right")], indirect=True)
def test_two_fingers_are_seen_recorded_into_one_file_and_played(gripper: Gripper) -> None:
    with gripper.viewer() as (client, _):

        def until(*texts: str) -> None:
            wait_until(lambda: gripper.refresh() and all(map(client.shows, texts)), PATIENCE_S)

        until("<b>left</b>: live", "<b>right</b>: live", "grip force left and right, estimated")
        gripper.cameras["left"].level, gripper.cameras["right"].level = 75, 50  # 1 mm and 2 mm: 2 N and 4 N
        until("1.00 mm, ", "2.00 mm, ", "\N{MINUS SIGN}2.00", "\N{MINUS SIGN}4.00", "3.00 N")
        client.use("Record")
        until("recording recording_")
        gripper.refresh_for(0.5)
        gripper.cameras["left"].level = 50
        until("4.00 N")
        client.use("Stop recording")
        until("recorded recording_")
        (path,) = gripper.out.glob("*.mcap")
        assert recorded_sensor_addresses(path) == [f"{path}#left", f"{path}#right"]
        for name, first_n in (("left", -2.0), ("right", -4.0)):
            with Recording(f"{path}#{name}") as recording:
                wrenches = list(recording.wrenches(Topic.ESTIMATED))
                assert len(wrenches) == len(recording.positions(Topic.IMAGES)) > 10
                assert wrenches[0].force_n[2] == pytest.approx(first_n, abs=0.02)
                assert wrenches[-1].force_n[2] == pytest.approx(-4.0, abs=0.02)
        gripper.cameras["left"].level = gripper.cameras["right"].level = 100  # the sensors go on, and are not shown
        wait_until(lambda: gripper.refresh() and path.name in client.control("recording").options)
        client.use("recording", path.name)
        until("<b>left</b>: recorded, 0.00 of ", "<b>right</b>: recorded, 0.00 of ", "3.00 N", "2.00 mm, ")
        client.use("time (s)", 1e6)
        until("4.00 N")
        client.use("Images and tables")
        wait_until(lambda: any("Exported" in notice for notice in client.notices), PATIENCE_S)
    (exported,) = gripper.out.glob("*_export_*")
    assert {one.name for one in exported.iterdir()} == {"left", "right"}


@pytest.mark.parametrize("gripper", [("left", "right")], indirect=True)
def test_a_line_is_picked_on_the_nearest_finger_and_within_its_skin(gripper: Gripper) -> None:
    with gripper.viewer() as (hand, viewer):
        half_x, half_y = viewer.block.width_mm / 2, viewer.block.length_mm / 2
        (left_x, left_y, _), (right_x, right_y, _) = viewer.arrangement.places_mm
        hand.click_on_scene(right_x + 1.0, right_y - 2.0, "shift")
        wait_until(lambda: viewer.options.profile_mm[0] == (1.0, -2.0))
        assert viewer.options.with_profile and viewer.profiled_sensor == 1
        wait_until(lambda: hand.control("line on the skin").value)
        hand.click_on_scene(right_x + 1000.0, right_y - 1000.0, "shift")
        wait_until(lambda: viewer.options.profile_mm[1] == (round(half_x, 1), round(-half_y, 1)))
        hand.click_on_scene(left_x, left_y)  # nothing: Shift is not held
        hand.use("pick on the skin", value=True)
        hand.until_sent(lambda one: one["type"] == "ScenePointerEnableMessage" and len(one["modifiers"]) == 2)
        hand.click_on_scene(left_x + 3.0, left_y)
        wait_until(lambda: viewer.options.profile_mm[0] == (3.0, 0.0))
        assert viewer.profiled_sensor == 0
        gripper.cameras["right"].level = 75
        hand.click_on_scene(right_x, right_y)
        wait_until(lambda: viewer.profiled_sensor == 1)

        def plots_the_right() -> bool:
            gripper.refresh()
            return hand.shows("\N{MINUS SIGN}1.00 mm")

        wait_until(plots_the_right, pause_s=0.03)


@pytest.mark.parametrize("gripper", [("left", "right")], indirect=True)
def test_a_lost_finger_is_said_and_the_other_goes_on(gripper: Gripper) -> None:
    with gripper.viewer() as (client, viewer):

        def until_shown(*texts: str) -> None:
            wait_until(lambda: gripper.refresh() and all(map(client.shows, texts)), PATIENCE_S)

        until_shown("<b>left</b>: live", "<b>right</b>: live")
        gripper.cameras["left"].plugged_in, gripper.cameras["right"].level = False, 75
        until_shown("<b>left</b>: no image for", "<b>right</b>: live", "1.00 mm, ", "unknown without left")
        gripper.cameras["left"].plugged_in = True
        until_shown("<b>left</b>: live", "1.00 N")
        viewer.toggle_freeze()
        gripper.cameras["right"].level = 50
        until_shown("<b>left</b>: frozen", "<b>right</b>: frozen", "1.00 N")
        viewer.toggle_freeze()
        viewer.choose(sensor=1)
        until_shown("2.00 N")
        assert viewer.moment is not None and [one.name for one in viewer.choose_shown(viewer.moment)] == ["right"]
        assert [one.name for one in viewer.shown_sensors] == ["right"]


@pytest.mark.parametrize("gripper", [("thumb", "first", "second", "third")], indirect=True)
def test_four_fingers_have_room_on_a_desktop_and_on_a_phone(browser: Browser, gripper: Gripper, tmp_path: Path) -> None:
    for width, height in ((1280, 800), (390, 844)):
        tab = browser.new_page(viewport={"width": width, "height": height})
        tab.goto(f"http://127.0.0.1:{gripper.server.port}")
        states = [f"{name}: live" for name in gripper.cameras]

        def until_shown(*texts: str, tab: Page = tab) -> None:
            wait_until(
                lambda: gripper.refresh() and all(text in tab.inner_text("body") for text in texts), PATIENCE_S, 0.05
            )

        until_shown(*states, "grip force thumb and first", "grip force second and third")
        for number, camera in enumerate(gripper.cameras.values()):
            camera.level = 90 - 10 * number  # 0.4, 0.8, 1.2 and 1.6 mm
        until_shown("1.20 N", "2.80 N", "1.60 mm, ")
        gripper.refresh_for(2.0)
        tab.screenshot(path=tmp_path / f"four_{width}.png")
        assert find_layout_faults(tab) == []
        images = [image.bounding_box() for image in tab.locator("img[src^=blob]").all()]
        assert len(images) == 2 and all(box is not None and box["width"] > SMALLEST_IMAGE_PX for box in images)
        status, panels = (
            tab.locator("[role=status]").first.bounding_box(),
            tab.get_by_role("tablist").last.bounding_box(),
        )
        assert status is not None and panels is not None and status["y"] < panels["y"]
        tab.close()


@pytest.mark.parametrize("sensors", [1, 2, 4])
@pytest.mark.parametrize(("width_px", "height_px", "covered"), [(390, 844, 0.6), (700, 860, 0.0)])
def test_the_camera_sees_all_skins_in_what_panels_leave_free(
    sensors: int, width_px: int, height_px: int, covered: float
) -> None:
    """A pinhole camera by its definition: every corner of every skin is in the free upper part of the view."""
    block = GelBlock(24.0, 18.0, 2.0)
    view = SideBySideLayout(block, sensors, width_px / height_px, covered)
    corners = np.array([[x, y, 0.0] for x in (-12.0, 12.0) for y in (-9.0, 9.0)])
    seen = np.concatenate([corners + place for place in view.places_mm]) - view.camera_mm
    forwards = np.subtract(view.target_mm, view.camera_mm) / np.linalg.norm(np.subtract(view.target_mm, view.camera_mm))
    right = np.array([1.0, 0.0, 0.0])
    up = np.cross(right, forwards)
    half = np.tan(FIELD_OF_VIEW_RAD / 2)
    x, y = (seen @ right / (seen @ forwards) / half, seen @ up / (seen @ forwards) / half)
    assert np.abs(x).max() < width_px / height_px
    assert 2 * covered - 1 < y.min() and y.max() < 1


def test_a_recording_of_a_finger_that_was_lost_is_played_to_the_end_of_the_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, path = sensor_folder(tmp_path / "small"), tmp_path / "two.mcap"
    for name, count in (("left", 3), ("right", 60)):
        image_folder(tmp_path / name, *range(100, 100 - count, -1))
    sources = [f"{name}={tmp_path / name}" for name in ("left", "right")]
    sensors = [f"{name}={folder}" for name in ("left", "right")]
    assert main(["record", "--source", *sources, "--sensor", *sensors, "--out", str(path)]) == 0
    shape, addresses = load_sensor(folder).shape, [Path(address) for address in recorded_sensor_addresses(path)]
    newest, scale = PageMoment((moment_with("", 0.0, 0.1),)), full_range_colour_scale(shape)
    player = RecordingPlayer([RecordedSensor(address, shape, scale) for address in addresses])
    player.seek(1e9)
    left, other = player.moment(newest).sensors
    assert left.status.tone == "lost" and "this sensor has no image at this time" in left.status.sentence
    assert other.reading is not None and other.reading.image.min() == 41 and other.name == "right"
    player.seek(0.0)
    assert [one.status.tone for one in player.moment(newest).sensors] == ["held", "held"]
    player.add_span(0.0, player.duration_s, "grasp")
    player.close()
    with Recording(f"{path}#right") as recording:
        assert [span.label for span in recording.spans()] == ["grasp"]


def test_live_shows_named_sources_until_ctrl_c(tmp_path: Path) -> None:
    folder, images = sensor_folder(tmp_path / "small"), image_folder(tmp_path / "images", 100, 100, 100)
    options = ["--source", f"left={images}", f"right={images}", "--sensor", f"left={folder}", f"right={folder}"]
    command = [sys.executable, "-m", "ninedtact", "live", *options, "--loop", "--port", "0"]
    live = subprocess.Popen(command, stdout=PIPE, stderr=PIPE, text=True)
    assert live.stdout is not None
    assert re.match(r"left: .*images.*, right: .*images.*: open http://127", live.stdout.readline())
    live.send_signal(signal.SIGINT)
    said, complained = live.communicate(timeout=60)
    assert re.fullmatch(r"stopped after \d+ images of left, \d+ images of right\n", said) and complained == ""
