"""An unplugged camera is reported once and reopened when it is back."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from bench_camera import BenchCamera
from hand_fed import HandFed
from mjpeg_camera import MjpegCamera

from ninedtact.capture.frame_pacing import DelayCorrectedSource, LatestFrameSource, LivePlayback, NoRecentFrame
from ninedtact.capture.frame_source import CameraLost, FrameSource
from ninedtact.capture.network_stream import NetworkStream
from ninedtact.capture.reconnecting import ReconnectingFrameSource
from ninedtact.capture.uvc_camera import UvcCamera
from ninedtact.errors import CameraError
from ninedtact.quantities import Frame

Plug = Callable[[bool], None]


@contextmanager
def network_camera() -> Iterator[tuple[FrameSource, Plug]]:
    with MjpegCamera() as camera:
        yield NetworkStream(camera.url), lambda is_in: camera.plug_in() if is_in else camera.unplug()


@contextmanager
def usb_camera() -> Iterator[tuple[FrameSource, Plug]]:
    camera = BenchCamera()
    yield UvcCamera(0, opener=camera.open_capture), lambda is_in: setattr(camera, "plugged_in", is_in)
    assert camera.held == 0


@pytest.mark.parametrize("kind", [network_camera, usb_camera])
def test_a_loss_is_reported_once_and_reading_goes_on_when_the_camera_is_back(kind: Callable[[], object]) -> None:
    told: list[str] = []
    with kind() as (camera, plug):
        source = ReconnectingFrameSource(
            camera, lambda loss: told.append(str(loss)), on_back=lambda: told.append("back"), retry_ms=20.0
        )
        with source:
            first = source.read()
            plug(False)
            replug = threading.Timer(0.3, plug, [True])
            replug.start()
            frames = [source.read()]
            while not told:  # images that were under way when the plug was pulled
                frames.append(source.read())
            source.open()  # opening an open source does nothing, also after a loss
            frames.append(source.read())
            replug.join()
        indices = [first.index, *(frame.index for frame in frames)]
        assert indices == list(range(len(indices)))
        assert len(told) == 2 and "expected an image" in told[0] and told[1] == "back"


@pytest.mark.parametrize("kind", [network_camera, usb_camera])
def test_under_freshest_the_reader_sees_no_old_image_meanwhile(kind: Callable[[], object]) -> None:
    losses: list[CameraLost] = []
    with (
        kind() as (camera, plug),
        LatestFrameSource(
            ReconnectingFrameSource(camera, losses.append, retry_ms=20.0), max_age_ms=20_000.0, timeout_ms=300.0
        ) as freshest,
    ):
        last = freshest.read()
        plug(False)
        with pytest.raises(NoRecentFrame):
            for last in freshest:  # noqa: B007
                pass
        assert len(losses) == 1
        plug(True)
        for _ in range(60):  # of 300 ms each
            try:
                assert freshest.read().stamp_ns > last.stamp_ns
                break
            except NoRecentFrame:
                continue
        else:
            pytest.fail("the camera was back and no image came")
        plug(False)  # and closing while it is away ends the wait


def test_closing_while_the_camera_is_away_leaves_nothing_open() -> None:
    camera = BenchCamera()
    lost = threading.Event()
    freshest = LatestFrameSource(
        ReconnectingFrameSource(UvcCamera(0, opener=camera.open_capture), lambda loss: lost.set(), retry_ms=60_000.0)
    )
    with freshest:
        camera.plugged_in = False
        assert lost.wait(20)
    assert camera.held == 0
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("fetch")]


@pytest.mark.parametrize("read", [None, "image", np.zeros((4, 5, 3), np.uint8), Frame(np.zeros((0, 5, 3), np.uint8))])
def test_what_is_no_frame_is_refused_in_one_sentence(read: Any) -> None:
    class Wrong(FrameSource):
        name = "my camera"

        def open(self) -> None: ...
        def close(self) -> None: ...
        def read(self) -> Frame:
            return read  # type: ignore[no-any-return]

    for source in (DelayCorrectedSource(Wrong(), 1.0), LatestFrameSource(Wrong()), LivePlayback(Wrong())):
        with source, pytest.raises(CameraError, match=r"expected a Frame from my camera.*, got .*; correct its read"):
            source.read()


def test_a_source_has_one_owner_at_a_time() -> None:
    camera = HandFed()
    first, second = DelayCorrectedSource(camera, 1.0), LatestFrameSource(camera)
    with first:
        first.open()
        with pytest.raises(CameraError, match="to be read by one sensor, got a second one while the first is open"):
            second.open()
        second.close()
        camera.show()
        assert first.read().index == 0
    with second:
        pass
