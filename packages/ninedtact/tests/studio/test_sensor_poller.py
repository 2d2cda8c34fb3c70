"""The sensor thread: the newest reading, how the source is doing, and nothing left running."""

import threading
import time
from pathlib import Path

import numpy as np
import pytest
from hand_fed import HandFed
from small_sensor import SHAPE, UNTOUCHED, SkinCamera, image_folder, sensor_on, skin, wait_until

from ninedtact.capture.frame_pacing import DelayCorrectedSource, LivePlayback
from ninedtact.capture.frame_source import ImageFolder
from ninedtact.capture.reconnecting import ReconnectingFrameSource, RepeatingSource
from ninedtact.live.sensor_poller import SensorPhase, SensorPoller, SensorSnapshot
from ninedtact.quantities import Frame
from ninedtact.reading import Reading
from ninedtact.sensor import Sensor
from ninedtact.simulation.simulated_sources import SimulatedCamera
from ninedtact.studio.page_controller import most_urgent_status


def now_in(loop: SensorPoller) -> SensorSnapshot:
    return loop.snapshot(time.monotonic_ns())


def deepest_mm(loop: SensorPoller) -> float:
    reading = now_in(loop).reading
    return -1.0 if reading is None else float(reading.height.indentation_mm.max())


def sentence(loop: SensorPoller) -> str:
    moment = now_in(loop)
    return most_urgent_status(moment, moment.reading, False, time.monotonic_ns()).sentence


def test_the_newest_reading_wins_and_the_rest_is_counted() -> None:
    fed = HandFed()
    sensor = sensor_on(fed, reference_frames=1)
    sensor.references.given = SHAPE.depth_reader(Frame(skin(UNTOUCHED)))

    def feed(*levels: int) -> None:
        for level in levels:
            fed.queue.put(Frame(skin(level), time.monotonic_ns(), fed.fed))
            fed.fed += 1

    feed(100, 90, 80)
    with SensorPoller(sensor) as loop:
        wait_until(lambda: (reading := now_in(loop).reading) is not None and reading.frame.index == 2)
        feed(75)
        wait_until(lambda: deepest_mm(loop) == pytest.approx(1.0, abs=0.01))
        reading = now_in(loop).reading
        assert reading is not None
        assert reading.dropped == 4 - sensor.frames_read
        assert set(reading.stage_ms) == {"capture", "rectify", "depth"}


def test_nobody_looking_holds_nothing_up() -> None:
    with SensorPoller(sensor_on(SkinCamera())) as loop:
        wait_until(lambda: loop.sensor.frames_read > 100)
        moment = now_in(loop)
    assert moment.read_hz > 5 and moment.delivered_hz >= 0.9 * moment.read_hz
    seconds, depths_mm = moment.history
    assert len(seconds) > 50 and (np.diff(seconds) > 0).all() and seconds[-1] <= 0 and np.abs(depths_mm).max() < 0.01


def test_a_dark_reference_is_refused_in_words_and_tried_again() -> None:
    camera = SkinCamera()
    camera.level = 3
    with SensorPoller(sensor_on(camera)) as loop:
        wait_until(lambda: "expected a lit reference image (no contact)" in sentence(loop))
        assert now_in(loop).phase is SensorPhase.REFERENCE and now_in(loop).reading is None
        camera.level = UNTOUCHED
        wait_until(lambda: sentence(loop).startswith("live"))


def test_a_computer_that_is_too_slow_is_not_taken_for_an_unplugged_camera() -> None:
    camera, is_fast = SkinCamera(), threading.Event()
    is_fast.set()
    source = ReconnectingFrameSource(camera, on_lost=lambda loss: None, retry_ms=20.0)

    def wait(reading: Reading) -> None:
        is_fast.wait()

    with SensorPoller(sensor_on(source), wait) as loop:
        wait_until(lambda: sentence(loop).startswith("live"))
        is_fast.clear()  # the camera goes on, and the next reading takes as long as the test wants
        wait_until(lambda: sentence(loop).startswith("images arrive, but this computer is"))
        moment, now_ns = now_in(loop), time.monotonic_ns()
        status = most_urgent_status(moment, moment.reading, False, now_ns)
        assert "lower the camera's rate or size, or use --force none" in status.sentence
        assert status.tone == "warned" and not status.is_past and moment.delivered_hz > 0
        assert most_urgent_status(moment, moment.reading, True, now_ns).sentence.startswith("frozen")
        camera.plugged_in = False
        wait_until(lambda: sentence(loop).startswith("no image for"))
        is_fast.set()


@pytest.mark.parametrize("kind", ["a simulation", "a recording"])
def test_a_simulation_or_a_recording_is_late_and_not_unplugged(kind: str) -> None:
    fed = HandFed()
    fed.is_simulated, fed.is_live = kind == "a simulation", kind == "a simulation"
    wrapped = ReconnectingFrameSource(fed, on_lost=lambda loss: None)
    sensor = sensor_on(LivePlayback(RepeatingSource(DelayCorrectedSource(wrapped, 0.0))))
    assert sensor.source.is_simulated is (kind == "a simulation") and SimulatedCamera.is_simulated
    sensor.references.given = SHAPE.depth_reader(Frame(skin(UNTOUCHED)))
    with SensorPoller(sensor) as loop:
        fed.queue.put(Frame(skin(UNTOUCHED), time.monotonic_ns(), 0))
        wait_until(lambda: sentence(loop).startswith("this computer is "))
        moment, now_ns = now_in(loop), time.monotonic_ns()
        status = most_urgent_status(moment, moment.reading, False, now_ns)
        assert status.sentence.endswith("behind: end other programs, or use --force none") and not status.is_past
        assert most_urgent_status(moment, moment.reading, True, now_ns).sentence.startswith("frozen")


def recording(folder: Path, *levels: int) -> ImageFolder:
    return ImageFolder(image_folder(folder / "images", *levels))


def test_a_recording_ends_with_its_last_image(tmp_path: Path) -> None:
    with SensorPoller(Sensor(recording(tmp_path, 100, 100, 100, 75), SHAPE, reference_frames=2)) as loop:
        wait_until(lambda: now_in(loop).phase is SensorPhase.ENDED)
        assert deepest_mm(loop) == pytest.approx(1.0, abs=0.01)
        assert sentence(loop).startswith("recording ended, its last image is shown")


@pytest.mark.parametrize("is_silent", [False, True])
def test_closing_leaves_nothing_running(is_silent: bool) -> None:
    before = set(threading.enumerate())
    with SensorPoller(sensor_on(HandFed() if is_silent else SkinCamera())) as loop:
        if not is_silent:
            wait_until(lambda: now_in(loop).reading is not None)
    assert set(threading.enumerate()) == before
    assert now_in(loop).phase is not SensorPhase.FAILED
