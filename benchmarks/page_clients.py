"""What clients of the live page cost: images that the sensor loses with none and with twenty, one of which never reads; memory.

The camera delivers 30 images a second from memory. The clients run in a process of their own. Phases without and with clients
take turns, because other programs on the machine make the sensor lose images too.
"""

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import tyro
from figures import Figure, answer, at_most
from live_page import CameraInMemory, crowd, resident_now_mb, shown_page
from real_images import real_sensor

from ninedtact import Sensor
from ninedtact.capture.frame_pacing import LatestFrameSource
from ninedtact.live.sensor_poller import SensorPoller
from ninedtact.reference_images import ReferenceImages
from ninedtact.studio.page_controller import DisplayedSensor

CAMERA_HZ, DISPLAY_HZ = 30.0, 15.0
READINGS = Path("out/readings")


def page_clients(
    clients: int = 20, rounds: int = 5, images: int = 240, quick: bool = False, json: bool = False
) -> None:
    """Show the page to nobody and to a crowd in turns, then pages of several sensors to one client, and print what that costs."""
    clients, rounds, images, several = (3, 1, 15, (2,)) if quick else (clients, rounds, images, (2, 4))
    of_many = [figure for sensors in several for figure in several_sensors(sensors, images)]
    alone, crowded, few, memory_mb = 0, 0, 0, []
    with (
        paced_sensor() as poller,
        shown_page([DisplayedSensor(poller)], shape(), DISPLAY_HZ, READINGS) as (server, page),
    ):
        for _ in range(rounds):
            alone += lost_images(poller, images)
            with crowd(server, clients):
                crowded += lost_images(poller, images)
            with crowd(server, 3):
                page.viewers[1].toggle_freeze()
                few += lost_images(poller, images)
            time.sleep(0 if quick else 3)
            memory_mb.append(resident_now_mb())
    percent = 100 / (rounds * images)
    figures = [
        Figure("lost without clients, %", percent * alone),
        at_most(f"lost with {clients} clients, one of which never reads, %", percent * crowded, 5),
        at_most("lost with three viewers, one of them frozen and one asleep, %", percent * few, 5),
        Figure("memory after the first crowd left, MB", memory_mb[0]),
        Figure(f"memory after {len(memory_mb)} crowds left, MB", memory_mb[-1]),
    ]
    answer("Clients of the live page", [*figures, *of_many], json)


def shape():
    """Return the calibrated shape of the real sensor A."""
    return real_sensor("sensor_a")[1]


def paced_sensor(hz: float = CAMERA_HZ) -> SensorPoller:
    """Return a sensor that reads its camera at a rate."""
    return SensorPoller(
        Sensor(LatestFrameSource(CameraInMemory(real_sensor("sensor_a")[0], hz)), shape(), ReferenceImages())
    )


def several_sensors(sensors: int, images: int) -> list[Figure]:
    """Return the share of images that the worst of several sensors loses while a client watches all, and the processor time."""
    with ExitStack() as opened:
        pollers = [opened.enter_context(paced_sensor()) for _ in range(sensors)]
        shown = [DisplayedSensor(one, name=f"finger_{number}") for number, one in enumerate(pollers)]
        server, _ = opened.enter_context(shown_page(shown, shape(), DISPLAY_HZ, READINGS))
        with crowd(server, 1, silent=0), ThreadPoolExecutor(sensors) as counters:
            began_s, worked_s = time.monotonic(), time.process_time()
            lost = max(counters.map(lost_images, pollers, [images] * sensors)) / images
            load = (time.process_time() - worked_s) / (time.monotonic() - began_s)
    return [
        at_most(f"lost by the worst of {sensors} sensors on a page with a client, %", 100 * lost, 5),
        Figure(f"processor time of {sensors} sensors and their page, % of a core", 100 * load),
    ]


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
