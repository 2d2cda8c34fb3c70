"""The newest image, never the same twice, never a stale one, and nothing left running."""

import threading
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hand_fed import HandFed

from ninedtact.capture.frame_pacing import LatestFrameSource, LivePlayback, NoRecentFrame
from ninedtact.capture.frame_source import CameraLost, ImageFolder, SourceEnded, SourceNotOpen
from ninedtact.quantities import Frame

LONG_MS = 20_000.0


def wait_until(is_true: Callable[[], bool]) -> None:
    give_up_at = time.monotonic() + 20
    while not is_true():
        assert time.monotonic() < give_up_at
        time.sleep(0.001)


def test_a_slow_reader_gets_the_newest_once_and_hears_of_the_dropped() -> None:
    fed = HandFed()
    with LatestFrameSource(fed, max_age_ms=LONG_MS, timeout_ms=50.0) as freshest:
        for level in (1, 2, 3):
            fed.show(level)
        wait_until(lambda: freshest.dropped == 2)
        assert freshest.read().index == 2
        with pytest.raises(NoRecentFrame, match=r"expected a new image .* got none within 0.05 s; check that"):
            freshest.read()
        fed.name = "rtsp://camera.local/gel"
        with pytest.raises(
            NoRecentFrame, match=r"rtsp://camera.local/gel, got none within 0.05 s; check the camera and the net"
        ):
            freshest.read()
        fed.show(4)
        assert freshest.read().index == 3
        assert freshest.dropped == 2


def test_a_stale_image_is_not_served_as_new() -> None:
    fed = HandFed()
    with LatestFrameSource(fed, max_age_ms=1000.0, timeout_ms=100.0) as freshest:
        fed.show(age_ms=1500)
        with pytest.raises(
            NoRecentFrame, match=r"got 1 that came more than .* s late within 0.1 s; .* the computer is too slow"
        ):
            freshest.read()
        assert freshest.dropped == 1
    fed = HandFed()
    with LatestFrameSource(fed, max_age_ms=1000.0, timeout_ms=LONG_MS) as freshest:
        fed.show(age_ms=1500)
        fed.show(age_ms=500, level=7)
        assert freshest.read().image[0, 0, 0] == 7


@pytest.mark.parametrize("trouble", [CameraLost("gone"), ZeroDivisionError("a bug in a source")])
def test_trouble_of_the_source_reaches_the_reader_after_the_last_image(trouble: Exception) -> None:
    fed = HandFed()
    with LatestFrameSource(fed, max_age_ms=LONG_MS, timeout_ms=LONG_MS) as freshest:
        fed.show()
        fed.fail(trouble)
        assert freshest.read().index == 0
        for _ in range(2):
            with pytest.raises(type(trouble), match=str(trouble)):
                freshest.read()


def test_closing_wakes_a_waiting_reader_and_leaves_no_thread() -> None:
    freshest = LatestFrameSource(HandFed(), timeout_ms=LONG_MS)
    freshest.open()
    ended_with: list[BaseException] = []

    def read() -> None:
        try:
            freshest.read()
        except BaseException as trouble:
            ended_with.append(trouble)

    reader = threading.Thread(target=read)
    reader.start()
    freshest.close()
    reader.join(20)
    assert [type(trouble) for trouble in ended_with] == [SourceNotOpen]
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("fetch")]


def test_a_recording_is_played_at_its_own_rate_and_ends(tmp_path: Path) -> None:
    for number in range(6):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros((4, 4, 3), np.uint8))
    began = time.monotonic()
    with LatestFrameSource(LivePlayback(ImageFolder(tmp_path, recorded_hz=20.0)), LONG_MS) as freshest:
        served = list(freshest)
        assert time.monotonic() - began >= 5 / 20
        assert len(served) + freshest.dropped == 6
        assert served[-1].index == 5
        with pytest.raises(SourceEnded):
            freshest.read()


class SlowRecording(HandFed):
    """Fifty images a second, of which the third takes 0.3 s to read; the seventh was recorded 10 s after the sixth."""

    recorded_hz = 50.0
    is_live = False

    def read(self) -> Frame:
        if self.fed == 8:
            raise SourceEnded("expected another image, got the end; stop")
        time.sleep(0.3 if self.fed == 2 else 0.0)
        self.show(stamp_ns=20_000_000 * self.fed + 10_000_000_000 * (self.fed > 5))
        return super().read()


@pytest.mark.parametrize("keeps_times", [False, True])
def test_a_recording_is_played_at_its_own_times(keeps_times: bool) -> None:
    """A late image delays what follows on a screen, where a pause is cut short; in a recording it keeps its time."""
    with LivePlayback(SlowRecording(), keeps_times=keeps_times) as source:
        arrivals_s, stamps_s = [], []
        for frame in (source.read() for _ in range(6 if keeps_times else 8)):
            arrivals_s.append(time.monotonic())
            stamps_s.append(frame.stamp_ns / 1e9)
    steps_s, late_s = np.diff(stamps_s), np.subtract(arrivals_s, stamps_s)
    assert (late_s >= 0).all() and (np.diff(arrivals_s)[3:] <= 0.3).all()
    if keeps_times:
        assert steps_s == pytest.approx(0.02 * np.ones(5), abs=1e-6) and late_s[2] > 0.2
    else:
        assert steps_s[[0, 4, 5, 6]] == pytest.approx(0.02 * np.ones(4), abs=1e-6)
        assert steps_s[1] > 0.25 and late_s[2] < 0.2
