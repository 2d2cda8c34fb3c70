"""A camera in memory, the live page of sensors with it, and crowds of clients: shared by page benchmarks and soak."""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import viser

from ninedtact import Frame, FrameSource
from ninedtact.design import Gel
from ninedtact.live.socket_guard import SocketGuard
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.studio.page_controller import DisplayedSensor, PageController
from ninedtact.studio.page_server import PageServer, page_server
from ninedtact.studio.scene_3d import gel_block_under_skin
from ninedtact.studio.sensor_page import SensorPage

CLIENTS = Path(__file__).parents[1] / "packages/ninedtact/tests/studio/reading_clients.py"
sys.path.append(str(CLIENTS.parent))
STATM = Path("/proc/self/statm")


class CameraInMemory(FrameSource):
    """Untouched skin first, then a ball that comes and goes, noise on everything; it delivers at a rate, or as it is read."""

    name = "a camera in memory"

    def __init__(self, images: dict[str, np.ndarray], hz: float = np.inf, kinds: int = 16) -> None:
        noise, untouched = np.random.default_rng(0), images["ball_reference"]
        share = [*np.zeros(kinds), *(1 - np.cos(np.linspace(0, 2 * np.pi, kinds))) / 2]
        change = images["ball"].astype(np.float32) - untouched
        self.images = [
            np.clip(untouched + part * change + 0.6 * noise.standard_normal(change.shape, np.float32), 0, 255).astype(
                np.uint8
            )
            for part in np.float32(share)
        ]
        self.hz, self.next_index, self.opened_at_s = hz, 0, 0.0

    def open(self) -> None:
        self.next_index, self.opened_at_s = 0, time.monotonic()

    def read(self) -> Frame:
        time.sleep(max(self.opened_at_s + self.next_index / self.hz - time.monotonic(), 0))
        self.next_index += 1
        image = self.images[self.next_index % len(self.images)].copy()  # memory of its own, as a driver gives it
        return Frame(image, time.monotonic_ns(), self.next_index - 1)

    def close(self) -> None:
        pass


@contextmanager
def shown_page(
    sensors: Sequence[DisplayedSensor], shape: CalibratedShape, hz: float, readings: Path
) -> Iterator[tuple[PageServer, SensorPage]]:
    """Serve the page of sensors whose pollers run; yields server and page. readings: folder of what the page would save."""
    with page_server(SocketGuard("127.0.0.1")) as server:
        controller, stop = PageController(sensors, readings), threading.Event()
        page = SensorPage(server, controller, gel_block_under_skin(shape, Gel()), "benchmark")
        showing = threading.Thread(target=controller.run, args=(page, hz, stop.is_set))
        showing.start()
        try:
            yield server, page
        finally:
            stop.set()
            showing.join()


@contextmanager
def crowd(server: PageServer, clients: int, silent: int = 1, others: int = 0) -> Iterator[None]:
    """Connect clients, some of which never read, beside others, wait for all, and let them leave at the end."""
    command = [sys.executable, str(CLIENTS), f"ws://127.0.0.1:{server.port}", f"viser-v{viser.__version__}"]
    process = subprocess.Popen([*command, str(clients), str(silent)])
    try:
        while len(server.viser.get_clients()) < clients + others:
            time.sleep(0.1)
        time.sleep(1)
        yield
    finally:
        process.kill()
        process.wait()
    while len(server.viser.get_clients()) > others:
        time.sleep(0.1)


def require_linux() -> None:
    """End the program with a sentence where resident memory cannot be read."""
    if not STATM.is_file():
        sys.exit("expected Linux, whose /proc tells resident memory, got another system; run this one there")


def resident_now_mb() -> float:
    """Return the resident memory of this process."""
    return int(STATM.read_text().split()[1]) * 4096 / 1e6
