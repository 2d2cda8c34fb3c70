"""Each client gets whole moments as fast as it takes them; one that is too slow gets fewer points, and it alone."""

import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest
import viser
from reading_clients import CAMERA, received_surfaces, unpack_text
from small_sensor import SHAPE, SkinCamera, sensor_on, wait_until
from websockets.sync.client import connect

from ninedtact.design import Gel
from ninedtact.live.sensor_poller import SensorPoller
from ninedtact.live.socket_guard import SocketGuard, SocketLimits
from ninedtact.quantities import Frame
from ninedtact.studio.page_controller import DisplayedSensor, PageController
from ninedtact.studio.page_server import page_server
from ninedtact.studio.scene_3d import gel_block_under_skin
from ninedtact.studio.sensor_page import SensorPage
from ninedtact.studio.viewer import MAX_COARSER, MAX_LEFT_OUT, PACE_OVER_S, RETRY_S, ClientSurfaceDensity


class TremblingSkin(SkinCamera):
    """A skin that is pressed a little more or less in every image, because an unchanged surface is not sent again."""

    def read(self) -> Frame:
        self.level = 60 if self.level > 60 else 70
        return super().read()


class Client:
    """A client without a browser that takes a message, and then nothing for a time."""

    def __init__(self, port: int, pause_s: float = 0.0) -> None:
        self.port, self.pause_s = port, pause_s
        self.points: list[int] = []
        self.text = b""
        self.is_closing = False

    def run(self) -> None:
        protocol = f"viser-v{viser.__version__}"
        options = {"subprotocols": [protocol], "max_size": None, "max_queue": 1, "close_timeout": 0.1}
        with connect(f"ws://127.0.0.1:{self.port}", **options) as socket:
            socket.send(msgspec.msgpack.encode(CAMERA))
            while not self.is_closing:
                try:
                    message = socket.recv(timeout=0.1)
                except TimeoutError:
                    continue
                self.text += unpack_text(message)
                self.points += received_surfaces(message)
                time.sleep(self.pause_s)


@contextmanager
def connected(page: SensorPage, *clients: Client) -> Iterator[None]:
    """Connect clients one after the other, so that the viewers of the page are in the same order."""
    with ThreadPoolExecutor(len(clients)) as threads:
        try:
            for number, client in enumerate(clients, 1):
                running = threads.submit(client.run)
                wait_until(lambda wanted=number: len(page.viewers) == wanted)
            yield
        finally:
            for client in clients:
                client.is_closing = True
    running.result()


def test_a_client_that_is_too_slow_gets_fewer_points_and_it_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ninedtact.studio.viewer.PACE_OVER_S", 0.5)
    monkeypatch.setattr("ninedtact.studio.viewer.PACE_MOMENTS", 8)
    limits, stop = SocketLimits(acknowledged_bytes=1, unacknowledged=1), threading.Event()
    with (
        page_server("127.0.0.1", 0, SocketGuard("127.0.0.1", limits=limits)) as server,
        SensorPoller(sensor_on(TremblingSkin(period_s=0.02))) as loop,
        ThreadPoolExecutor(1) as page_thread,
    ):
        studio = PageController([DisplayedSensor(loop)], tmp_path)
        page = SensorPage(server, studio, gel_block_under_skin(SHAPE, Gel()), "small")
        fast, slow = Client(server.port), Client(server.port, pause_s=0.4)
        showing = page_thread.submit(studio.run, page, 10.0, stop.is_set)
        try:
            with connected(page, fast, slow):
                rows, cols, _ = SHAPE.rectify.source_px.shape
                all_points, least = rows * cols, -(-rows // MAX_COARSER) * -(-cols // MAX_COARSER)
                wait_until(lambda: slow.points[-1:] == [least] and b"keep up" in slow.text)
                assert page.viewers[0].pace.coarser == 1 and set(fast.points) == {all_points}
                assert b"keep up" not in fast.text and len(fast.points) > len(slow.points)
        finally:
            stop.set()
        showing.result(timeout=60)


def test_density_falls_while_moments_are_left_out_and_rises_again_more_and_more_carefully() -> None:
    pace, now_s = ClientSurfaceDensity(), 0.0

    def seconds_until(coarser: int, left_out: float) -> float:
        nonlocal now_s
        began_s = now_s
        while pace.coarser != coarser:
            assert now_s < began_s + 1000
            now_s += 0.05
            pace.count_moment(round(now_s / 0.05) % 10 < 10 * left_out, now_s)
        return now_s - began_s

    assert seconds_until(2, left_out=0.8) <= PACE_OVER_S + 0.1
    assert "1 of 4 points" in pace.sentence and "80% of the moments" in pace.sentence
    first = seconds_until(1, left_out=0.0)
    assert first > RETRY_S and pace.sentence == ""
    seconds_until(MAX_COARSER, left_out=0.8)
    assert seconds_until(1, left_out=0.0) > 2 * first
    for _ in range(1000):
        now_s += 0.05
        pace.count_moment(round(now_s / 0.05) % 10 < 10 * (MAX_LEFT_OUT - 0.1), now_s)
    assert pace.coarser == 1
