"""What clients of the live page cost: images that the sensor loses with none and with twenty, one of which never reads; memory.

The camera delivers 30 images a second from memory. The clients run in a process of their own. Phases without and with clients
take turns, because other programs on the machine make the sensor lose images too.
"""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import tyro
import viser
from figures import Figure, answer, at_most
from memory import CameraInMemory, resident_now_mb
from real_sensor import real_sensor

from ninedtact import Frame, Sensor
from ninedtact.capture.frame_pacing import LatestFrameSource
from ninedtact.design import Gel
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.studio.page_and_server import SensorPage, page_server
from ninedtact.studio.page_controller import DisplayedSensor, PageController
from ninedtact.studio.scene_3d import gel_block_under_skin
from ninedtact.studio.sensor_poller import SensorPoller

CLIENTS = Path(__file__).parents[1] / "packages/ninedtact/tests/studio" / "reading_clients.py"
sys.path.append(str(CLIENTS.parent))
CAMERA_HZ, DISPLAY_HZ = 30.0, 15.0


class PacedCamera(CameraInMemory):
    """A camera in memory that delivers at a rate, on time."""

    def __init__(self, untouched: np.ndarray, pressed: np.ndarray, hz: float = CAMERA_HZ) -> None:
        super().__init__(untouched, pressed)
        self.hz = hz

    def open(self) -> None:
        super().open()
        self.opened_at_s = time.monotonic()

    def read(self) -> Frame:
        time.sleep(max(self.opened_at_s + self.next_index / self.hz - time.monotonic(), 0))
        return super().read()


def page_clients(clients: int = 20, rounds: int = 5, images: int = 240, json: bool = False) -> None:
    """Show the page to nobody and to a crowd in turns, then pages of several sensors to one client, and print what that costs."""
    pictures, shape = real_sensor("sensor_a")
    several = {sensors: lost_of_several(pictures, shape, sensors, images) for sensors in (2, 4)}
    sensor = Sensor(LatestFrameSource(PacedCamera(pictures["ball_reference"], pictures["ball"])), shape, 2)
    alone, crowded, few, memory_mb = [], [], [], []
    with page_server("127.0.0.1", 0) as server, SensorPoller(sensor) as poller:
        studio, stop = PageController([DisplayedSensor(poller)], Path("out/readings")), threading.Event()
        page = SensorPage(server, studio, gel_block_under_skin(shape, Gel()), "sensor_a")
        showing = threading.Thread(target=studio.run, args=(page, DISPLAY_HZ, stop.is_set))
        showing.start()
        for _ in range(rounds):
            alone.append(lost_images(poller, images))
            with crowd(server, clients):
                crowded.append(lost_images(poller, images))
            with crowd(server, 3):
                page.viewers[1].toggle_freeze()
                few.append(lost_images(poller, images))
            time.sleep(3)
            memory_mb.append(resident_now_mb())
        stop.set()
        showing.join()
    lost = [
        at_most(f"lost by the worst of {sensors} sensors on a page with a client, %", 100 * share, 5)
        for sensors, (share, _) in several.items()
    ]
    lost += [
        Figure(f"processor time of {sensors} sensors and their page, % of a core", 100 * share)
        for sensors, (_, share) in several.items()
    ]
    answer(
        "Clients of the live page", [*figures(clients, rounds * images, alone, crowded, few, memory_mb), *lost], json
    )


def lost_of_several(
    pictures: dict[str, np.ndarray], shape: CalibratedShape, sensors: int, images: int
) -> tuple[float, float]:
    """The largest share of images that one of several sensors loses while a client watches all, and processor time per time."""
    stop = threading.Event()
    pollers = [
        SensorPoller(Sensor(LatestFrameSource(PacedCamera(pictures["ball_reference"], pictures["ball"])), shape, 2))
        for _ in range(sensors)
    ]
    with page_server("127.0.0.1", 0) as server, ExitStack() as opened:
        for poller in pollers:
            opened.enter_context(poller)
        shown = [DisplayedSensor(one, name=f"finger_{number}") for number, one in enumerate(pollers)]
        studio = PageController(shown, Path("out/readings"))
        page = SensorPage(server, studio, gel_block_under_skin(shape, Gel()), "fingers")
        showing = threading.Thread(target=studio.run, args=(page, DISPLAY_HZ, stop.is_set))
        showing.start()
        with crowd(server, 1, silent=0), ThreadPoolExecutor(sensors) as counters:
            began_s, worked_s = time.monotonic(), time.process_time()
            lost = list(counters.map(lost_images, pollers, [images] * sensors))
            load = (time.process_time() - worked_s) / (time.monotonic() - began_s)
        stop.set()
        showing.join()
    return max(lost) / images, load


def figures(
    clients: int, images: int, alone: list[int], crowded: list[int], few: list[int], memory_mb: list[float]
) -> Iterator[Figure]:
    yield Figure("lost without clients, %", 100 * sum(alone) / images)
    yield at_most(f"lost with {clients} clients, one of which never reads, %", 100 * sum(crowded) / images, 5)
    yield at_most("lost with three viewers, one of them frozen and one asleep, %", 100 * sum(few) / images, 5)
    yield Figure("memory after the first crowd left, MB", memory_mb[0])
    yield Figure(f"memory after {len(memory_mb)} crowds left, MB", memory_mb[-1])


@contextmanager
def crowd(server: viser.ViserServer, clients: int, silent: int = 1, others: int = 0) -> Iterator[None]:
    """Connect clients, some of which never read, beside others, wait for all, and let them leave at the end."""
    command = [sys.executable, str(CLIENTS), f"ws://127.0.0.1:{server.get_port()}", f"viser-v{viser.__version__}"]
    process = subprocess.Popen([*command, str(clients), str(silent)])
    while len(server.get_clients()) < clients + others:
        time.sleep(0.1)
    time.sleep(1)
    yield
    process.kill()
    process.wait()
    while len(server.get_clients()) > others:
        time.sleep(0.1)


def lost_images(poller: SensorPoller, images: int) -> int:
    """Return how many of the next images arrive and are not read."""

    def count() -> tuple[int, int]:
        reading = poller.snapshot(0).reading
        return (-1 if reading is None else reading.frame.index), poller.sensor.frames_read

    while (arrived := count()[0]) < 0:
        time.sleep(0.01)
    read = count()[1]
    while count()[0] < arrived + images:
        time.sleep(0.005)
    later = count()
    return max((later[0] - arrived) - (later[1] - read), 0)


if __name__ == "__main__":
    tyro.cli(page_clients)
