"""How often a client gets a new surface of a real sensor at full density, and what one update costs.

The camera delivers 60 images a second from memory. Sensor and page share one core; a client without a browser, in a process of its
own, counts the surfaces that arrive. Processor time is that of the process with sensor and page, with the client and without. Other
programs on the machine change it less than they change the rate.
"""

import multiprocessing
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import cv2
import msgspec
import tyro
import viser
from figures import Figure, answer, at_least, at_most
from live_page import shown_page
from page_clients import READINGS, paced_sensor, shape
from reading_clients import CAMERA, received_surfaces
from websockets.sync.client import connect

from ninedtact import Sensor
from ninedtact.studio.page_controller import DisplayedSensor

CAMERA_HZ, DISPLAY_HZ = 60.0, 40.0


@dataclass(frozen=True)
class Received:
    """What a client received."""

    surfaces_hz: float
    points: int
    """Number of points of the coarsest surface."""
    kb_per_surface: float


@dataclass(frozen=True)
class Load:
    """What the process with sensor and page did meanwhile."""

    share: float
    """Processor time per time."""
    images_hz: float


def watch(port: int, settle_s: float, seconds: float, pipe: Connection) -> None:
    """Watch the page without a browser on any core, and send what was received after `settle_s`."""
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    address, protocol = f"ws://127.0.0.1:{port}", f"viser-v{viser.__version__}"
    with connect(address, subprotocols=[protocol], max_size=None, compression=None) as client:  # type: ignore[list-item]
        client.send(msgspec.msgpack.encode(CAMERA))
        began_s = time.perf_counter() + settle_s
        while time.perf_counter() < began_s:
            client.recv()
        pipe.send("began")
        surfaces, size = list[int](), 0
        while (took_s := time.perf_counter() - began_s) < seconds:
            message = client.recv()
            surfaces, size = surfaces + received_surfaces(message), size + len(message)
        pipe.send(Received(len(surfaces) / took_s, min(surfaces, default=0), size / max(len(surfaces), 1) / 1e3))
        pipe.recv()


def page_updates(seconds: float = 20.0, quick: bool = False, json: bool = False) -> None:
    """Show a sensor's page to nobody, then to one client, and print what that costs."""
    cv2.setNumThreads(1)
    seconds, settle_s = (0.5, 0.5) if quick else (seconds, 3.0)
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    cores = os.sched_getaffinity(0)
    with (
        paced_sensor(CAMERA_HZ) as poller,
        shown_page([DisplayedSensor(poller)], shape(), DISPLAY_HZ, READINGS) as (
            server,
            _,
        ),
    ):
        client = context.Process(target=watch, args=(server.port, settle_s, seconds, there))
        keep_threads_on({min(cores)})
        alone = load_while(poller.sensor, lambda: time.sleep(seconds))
        client.start()
        here.recv()
        received: list[Received] = []
        watched = load_while(poller.sensor, lambda: received.append(here.recv()))
        here.send("end")
        client.join()
    keep_threads_on(cores)
    answer("Updates of the live page", figures(received[0], alone, watched), json)


def keep_threads_on(cores: set[int]) -> None:
    """Keep all threads of this process on these cores."""
    for thread in Path("/proc/self/task").iterdir():
        os.sched_setaffinity(int(thread.name), cores)


def load_while(sensor: Sensor, wait: Callable[[], object]) -> Load:
    """Return the load of this process while it waits."""
    worked_s, began_s, read = time.process_time(), time.monotonic(), sensor.frames_read
    wait()
    took_s = time.monotonic() - began_s
    return Load((time.process_time() - worked_s) / took_s, (sensor.frames_read - read) / took_s)


def figures(received: Received, alone: Load, watched: Load) -> list[Figure]:
    """Return the figures; the cost of an update is what the client adds to the cost of the images."""
    update_s = (watched.share - alone.share * watched.images_hz / alone.images_hz) / received.surfaces_hz
    needed = alone.share * CAMERA_HZ / alone.images_hz + 30 * update_s
    return [
        at_least("updates of the surface per second at the client", received.surfaces_hz, 30),
        Figure("points of a surface", received.points),
        Figure("kB of an update", received.kb_per_surface),
        Figure("images read per second without the client", alone.images_hz),
        Figure("with the client", watched.images_hz),
        Figure("processor time of one image, ms", 1e3 * alone.share / alone.images_hz),
        Figure("processor time of one update, ms", 1e3 * update_s),
        at_most("60 images and 30 updates, % of a core", 100 * needed, 100),
    ]


if __name__ == "__main__":
    tyro.cli(page_updates)
