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
from ninedtact.studio.displayed_reading import (
    MAX_SLOWDOWN,
    DisplayOptions,
    NothingToSave,
    PageController,
    PageReport,
    SaveLimits,
    SaveRefused,
    adapt_slowdown,
)
from ninedtact.studio.reading_view import ReadingView
from ninedtact.studio.sensor_poller import SensorPoller


class Screen:
    """A `Display` that remembers what it was told to show."""

    def __init__(self) -> None:
        self.is_watched = True
        self.wanted = DisplayOptions()
        self.views: list[ReadingView] = []
        self.looks: list[DisplayOptions] = []
        self.report: PageReport | None = None

    def display_options(self) -> DisplayOptions:
        return self.wanted

    def show(self, view: ReadingView, look: DisplayOptions) -> None:
        self.views.append(view)
        self.looks.append(look)

    def show_report(self, report: PageReport) -> None:
        self.report = report

    @property
    def sentence(self) -> str:
        assert self.report is not None
        return self.report.status.sentence

    @property
    def deepest_mm(self) -> float:
        return self.views[-1].summary.max_indentation_mm if self.views else -1.0


class Stage:
    """A camera, a studio and a screen."""

    def __init__(self, out: Path) -> None:
        self.camera, self.screen = SkinCamera(), Screen()
        self.losses: list[CameraLost] = []
        self.loop = SensorPoller(sensor_on(ReconnectingFrameSource(self.camera, self.losses.append, retry_ms=20.0)))
        self.studio = PageController(self.loop, out)

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
    drawn = [id(view.reading) for view in stage.screen.views]
    assert len(drawn) == len(set(drawn))
    newest = stage.screen.views[-1]
    assert np.array_equal(newest.image, newest.reading.frame.image) and not newest.is_past


def test_frozen_holds_what_is_shown_and_says_how_old_it_is(stage: Stage) -> None:
    with stage.loop:
        wait_until(lambda: stage.sees(0.0))
        stage.studio.frozen = True
        stage.camera.level, shown = 75, len(stage.screen.views)
        time.sleep(0.1)
        assert stage.says("frozen, what is shown is ") and len(stage.screen.views) == shown
        stage.screen.wanted = DisplayOptions(as_points=False, exaggeration=3.0)
        assert stage.sees(0.0) and stage.screen.looks[-1].exaggeration == 3.0 and len(stage.screen.views) == shown + 1
        stage.studio.frozen = False
        wait_until(lambda: stage.sees(1.0))


def test_what_is_not_the_present_is_faded_until_the_camera_is_back(stage: Stage) -> None:
    with stage.loop:
        wait_until(lambda: stage.sees(0.0))
        bright = stage.screen.views[-1]
        stage.camera.plugged_in = False
        wait_until(lambda: stage.says("no image for"))
        faded = stage.screen.views[-1]
        assert faded.is_past and len(stage.losses) == 1
        for image, past in ((bright.heights, faded.heights), (bright.surface.colours, faded.surface.colours)):
            assert past.mean() < 0.5 * image.mean()
        stage.camera.plugged_in = True
        wait_until(lambda: stage.says("live"))
        assert not stage.screen.views[-1].is_past


def test_nothing_is_drawn_while_nobody_looks(stage: Stage) -> None:
    stage.screen.is_watched = False
    with stage.loop:
        wait_until(lambda: stage.says("live") and stage.loop.sensor.frames_read > 10)
        assert not stage.screen.views
        stage.screen.is_watched = True
        wait_until(lambda: stage.sees(0.0))


def test_what_is_saved_is_what_was_shown(stage: Stage, tmp_path: Path) -> None:
    with stage.loop:
        with pytest.raises(NothingToSave, match="wait for the first image"):
            stage.studio.save()
        wait_until(lambda: stage.sees(0.0))
        stage.camera.level = 75
        wait_until(lambda: stage.sees(1.0))
        stage.studio.frozen, stage.camera.level = True, 50
        paths = stage.studio.save()
    by_ending = {path.name.split("_", maxsplit=4)[-1]: path for path in paths}
    assert set(by_ending) == {"image.png", "height.npy", "height.png", "height.ply"}
    assert np.load(by_ending["height.npy"]).min() == pytest.approx(-1.0, abs=0.01)
    assert read_image(by_ending["image.png"]).min() == 75
    assert {path.parent for path in paths} == {tmp_path / "readings"}


def test_too_many_saves_are_refused_and_write_nothing(stage: Stage, tmp_path: Path) -> None:
    hasty = PageController(stage.loop, tmp_path / "hasty", save_limits=SaveLimits(per_minute=2))
    small = PageController(stage.loop, tmp_path / "small", save_limits=SaveLimits(disk_share=0.0))
    with stage.loop:
        wait_until(lambda: stage.sees(0.0))
        hasty.refresh(stage.screen)
        small.refresh(stage.screen)
        with ThreadPoolExecutor(20) as clicks:
            results = [clicks.submit(hasty.save) for _ in range(20)]
        refusals = [result.exception() for result in results if result.exception() is not None]
        with pytest.raises(SaveRefused, match=r"at most 0% of the free disk, 0 MB, got 0 MB and another reading; free"):
            small.save()
    assert len(refusals) == 18 and len(list((tmp_path / "hasty").iterdir())) == 8 and not (tmp_path / "small").exists()
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
        slowdowns.append(adapt_slowdown(slowdowns[-1], replace(keeps_up, read_hz=27.0)))
    assert np.diff(slowdowns).min() >= 0 and slowdowns[-1] == MAX_SLOWDOWN > slowdowns[5] > 1.5
    for _ in range(60):
        slowdowns.append(adapt_slowdown(slowdowns[-1], keeps_up))
    assert slowdowns[-1] == 1.0 == adapt_slowdown(1.0, replace(moment, delivered_hz=0.0, read_hz=0.0))


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
    def interrupted(report: PageReport) -> None:
        stage.screen.report = report
        if report.status.tone == "live":
            raise KeyboardInterrupt

    stage.screen.show_report = interrupted  # type: ignore[method-assign]
    with stage.loop, pytest.raises(KeyboardInterrupt):
        stage.studio.run(stage.screen, display_hz=100.0)
    assert stage.screen.sentence == "stopped: the program has ended" and stage.screen.views[-1].is_past
