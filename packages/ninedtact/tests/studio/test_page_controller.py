"""What a person is shown: the present, or clearly not the present; and what they keep."""

import re
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_sensor import SkinCamera, sensor_on, wait_until

from ninedtact.capture.frame_source import CameraLost
from ninedtact.capture.reconnecting import ReconnectingFrameSource
from ninedtact.capture.strict_image_reading import read_image
from ninedtact.errors import InputError, OutputError
from ninedtact.live.sensor_poller import SensorPoller
from ninedtact.live.wrench_history import WrenchHistory, WrenchWithUncertainty
from ninedtact.quantities import Wrench, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.shape.light_change import LightChange
from ninedtact.studio.page_controller import (
    MAX_SLOWDOWN,
    DisplayedSensor,
    PageController,
    PageMoment,
    most_urgent_status,
    next_drawing_slowdown,
)
from ninedtact.studio.reading_view import ImageKind, ReadingView, ShownTraction, SkinColouring
from ninedtact.studio.saved_files import SaveQuota


class Screen:
    """A `PageMomentDisplay` that remembers what it was told to show."""

    def __init__(self) -> None:
        self.is_watched = True
        self.moments: list[PageMoment] = []

    def show(self, moment: PageMoment) -> None:
        self.moments.append(moment)

    @property
    def views(self) -> list[ReadingView]:
        moments = [moment.sensors[0] for moment in self.moments]
        return [moment.view for moment in moments if moment.view is not None]

    @property
    def sentence(self) -> str:
        return self.moments[-1].sensors[0].status.sentence

    @property
    def deepest_mm(self) -> float:
        return self.views[-1].summary.max_indentation_mm if self.views else -1.0


class Stage:
    """A camera, a studio and a screen."""

    def __init__(self, out: Path) -> None:
        self.camera, self.screen = SkinCamera(), Screen()
        self.losses: list[CameraLost] = []
        self.loop = SensorPoller(sensor_on(ReconnectingFrameSource(self.camera, self.losses.append, retry_ms=20.0)))
        self.sensor = DisplayedSensor(self.loop)
        self.studio = PageController([self.sensor], out)

    def sees(self, depth_mm: float) -> bool:
        self.studio.refresh(self.screen)
        return bool(self.screen.deepest_mm == pytest.approx(depth_mm, abs=0.01))

    def says(self, beginning: str) -> bool:
        self.studio.refresh(self.screen)
        return self.screen.sentence.startswith(beginning)


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return Stage(tmp_path / "readings")


def test_the_screen_follows_the_skin_and_nothing_is_drawn_twice(stage: Stage) -> None:
    with stage.loop:
        wait_until(lambda: stage.sees(0.0))
        stage.camera.level = 75
        wait_until(lambda: stage.sees(1.0))
        brighter = replace(stage.screen.views[-1].reading, light=LightChange(level=1.08, gain=1.08))
        now_ns = time.monotonic_ns()
        status = most_urgent_status(stage.loop.snapshot(now_ns), brighter, False, now_ns)
        assert status.tone == "live" and "the light is 8.0% brighter than in the reference image" in status.sentence
    newest = stage.screen.views[-1]
    assert len({id(view) for view in stage.screen.views}) == len({id(view.reading) for view in stage.screen.views})
    assert newest.image(ImageKind.HEIGHT) is newest.image(ImageKind.HEIGHT)
    assert np.array_equal(newest.image(ImageKind.CAMERA), newest.reading.frame.image) and not newest.is_past


def test_one_moment_has_the_reading_and_the_wrench_of_the_same_stamp(stage: Stage) -> None:
    history = WrenchHistory("measured", "by a sensor")
    stage.sensor.wrenches = (history,)
    with stage.loop:
        wait_until(lambda: stage.sees(0.0))
        for _ in range(5):
            held = stage.loop.snapshot(0)
            reading = held.reading
            assert reading is not None
            for offset_ns in (-40_000_000, 0, 40_000_000):
                wrench = Wrench(
                    np.array([0.0, 0.0, -offset_ns / 1e9]), np.zeros(3), stamp_ns=reading.stamp_ns + offset_ns
                )
                history.add(WrenchWithUncertainty(wrench, np.full(6, np.nan)))
            stage.loop.snapshot = lambda now_ns, held=held: held  # type: ignore[method-assign, misc]
            stage.studio.refresh(stage.screen)
            (moment,) = stage.screen.moments[-1].sensors
            sample = moment.wrenches[0].sample
            assert moment.reading is not None and sample is not None
            assert sample.wrench.stamp_ns == moment.reading.stamp_ns
            del stage.loop.snapshot
            time.sleep(0.05)


def test_one_moment_has_the_estimate_of_its_own_reading(stage: Stage) -> None:
    history = WrenchHistory("estimated", "by the bench", states_errors=True)
    shown: list[Reading] = []

    def estimate_and_show(reading: Reading) -> None:  # readings come faster than the history keeps estimates
        wrench = Wrench(np.zeros(3), np.zeros(3), stamp_ns=reading.stamp_ns)
        shown.append(reading.with_force(WrenchEstimate(wrench, np.eye(6), True, ())))
        history.add_estimate(shown[-1].force)  # type: ignore[arg-type]

    stage.sensor.wrenches = (history,)
    with stage.loop:
        wait_until(lambda: stage.sees(0.0))
        read = stage.loop.snapshot(0)
    assert read.reading is not None
    for number in range(20):
        frame = replace(read.reading.frame, stamp_ns=read.reading.stamp_ns + number * 4_000_000)
        estimate_and_show(replace(read.reading, frame=frame))
        stage.loop.snapshot = lambda now_ns: replace(read, reading=shown[-1])  # type: ignore[method-assign]
        stage.studio.refresh(stage.screen)
        sample = stage.screen.moments[-1].sensors[0].wrenches[0].sample
        assert sample is not None and sample.wrench.stamp_ns == frame.stamp_ns
    assert len(history.snapshot(None, 0).samples) < 10


def test_what_is_not_the_present_is_faded_until_the_camera_is_back(stage: Stage) -> None:
    with stage.loop:
        wait_until(lambda: stage.sees(0.0))
        bright = stage.screen.views[-1]
        stage.camera.plugged_in = False
        wait_until(lambda: stage.says("no image for"))
        faded = stage.screen.views[-1]
        assert faded.is_past and len(stage.losses) == 1
        assert faded.image(ImageKind.HEIGHT).mean() < 0.5 * bright.image(ImageKind.HEIGHT).mean()
        points = [view.surface(SkinColouring.HEIGHT, 1, ShownTraction.ESTIMATED).colours for view in (bright, faded)]
        assert points[1].mean() < 0.5 * points[0].mean()
        wait_until(lambda: stage.loop.snapshot(time.monotonic_ns()).delivered_hz == 0)
        assert stage.loop.snapshot(0).reading is faded.reading
        stage.camera.level, stage.camera.plugged_in = 50, True
        wait_until(lambda: stage.says("live"))
        assert stage.sees(2.0) and not stage.screen.views[-1].is_past


def test_nothing_is_drawn_while_nobody_looks(stage: Stage) -> None:
    stage.screen.is_watched = False
    with stage.loop:
        wait_until(lambda: stage.says("live") and stage.loop.sensor.frames_read > 10)
        assert not stage.screen.views
        stage.screen.is_watched = True
        wait_until(lambda: stage.sees(0.0))


def test_what_is_saved_is_what_was_shown(stage: Stage, tmp_path: Path) -> None:
    with stage.loop:
        with pytest.raises(InputError, match="wait for the first image"):
            stage.studio.save(())
        wait_until(lambda: stage.sees(0.0))
        stage.camera.level = 75
        wait_until(lambda: stage.sees(1.0))
        shown, stage.camera.level = stage.screen.moments[-1].sensors, 50
        wait_until(lambda: stage.sees(2.0))
        paths = stage.studio.save(shown)
    by_ending = {path.name.split("_", maxsplit=4)[-1]: path for path in paths}
    assert set(by_ending) == {"image.png", "height.npy", "height.png", "height.ply", "moment.json"}
    assert np.load(by_ending["height.npy"]).min() == pytest.approx(-1.0, abs=0.01)
    assert read_image(by_ending["image.png"]).min() == 75
    assert {path.parent for path in paths} == {tmp_path / "readings"}


def test_too_many_saves_are_refused_and_write_nothing(stage: Stage, tmp_path: Path) -> None:
    hasty = PageController([stage.sensor], tmp_path / "hasty", SaveQuota(per_minute=2))
    small = PageController([stage.sensor], tmp_path / "small", SaveQuota(disk_share=0.0))
    with stage.loop:
        wait_until(lambda: stage.sees(0.0))
        hasty.refresh(stage.screen)
        small.refresh(stage.screen)
        with ThreadPoolExecutor(20) as clicks:
            results = [clicks.submit(hasty.save, stage.screen.moments[-1].sensors) for _ in range(20)]
        refusals = [result.exception() for result in results if result.exception() is not None]
        with pytest.raises(OutputError, match=r"at most 0% of the free disk, 0 MB, got 0 MB and another reading; free"):
            small.save(stage.screen.moments[-1].sensors)
    assert len(refusals) == 18 and len(list((tmp_path / "hasty").iterdir())) == 10 and not (tmp_path / "small").exists()
    assert re.fullmatch(
        r"expected at most 2 saves a minute, got one more; wait (59|60) s, or use 'ninedtact record'", str(refusals[0])
    )


def test_the_page_gives_way_to_a_sensor_that_loses_images(stage: Stage) -> None:
    with stage.loop:
        wait_until(lambda: stage.sees(0.0))
        moment = stage.loop.snapshot(time.monotonic_ns())
    keeps_up = replace(moment, delivered_hz=30.0, read_hz=30.0)
    slowdowns = [1.0]
    for _ in range(30):
        slowdowns.append(next_drawing_slowdown(slowdowns[-1], replace(keeps_up, read_hz=27.0)))
    assert np.diff(slowdowns).min() >= 0 and slowdowns[-1] == MAX_SLOWDOWN > slowdowns[5] > 1.5
    for _ in range(60):
        slowdowns.append(next_drawing_slowdown(slowdowns[-1], keeps_up))
    assert slowdowns[-1] == 1.0 == next_drawing_slowdown(1.0, replace(moment, delivered_hz=0.0, read_hz=0.0))


def test_a_sensor_thread_that_gives_up_is_told_to_the_screen_and_to_the_caller(stage: Stage) -> None:
    def broken() -> None:
        raise ZeroDivisionError("a bug in a source")

    with stage.loop:
        wait_until(lambda: stage.sees(0.0))
        stage.camera.read = broken  # type: ignore[method-assign, assignment]
        with pytest.raises(ZeroDivisionError, match="a bug in a source"):
            stage.studio.run(stage.screen, display_hz=100.0)
    assert stage.screen.sentence == "stopped: a bug in a source" and stage.screen.views[-1].is_past


def test_an_interrupted_page_says_that_it_is_over(stage: Stage) -> None:
    def interrupted(moment: PageMoment) -> None:
        stage.screen.moments.append(moment)
        if moment.sensors[0].status.tone == "live":
            raise KeyboardInterrupt

    stage.screen.show = interrupted  # type: ignore[method-assign]
    with stage.loop, pytest.raises(KeyboardInterrupt):
        stage.studio.run(stage.screen, display_hz=100.0)
    assert stage.screen.sentence == "stopped: the program has ended" and stage.screen.views[-1].is_past
