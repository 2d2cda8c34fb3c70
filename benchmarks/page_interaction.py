"""How long the page takes from a person's move to the new state of the twin, and how often it is renewed.

A client without a browser, in a process of its own, moves the 3D handle as viser's page does, and waits until a message says that
the object is at the new depth; images, surface and wrench come with the same message. The sensor is the twin of a real sensor, with
force by physics, and a second client only watches.
"""

import multiprocessing
import statistics
import time
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory

import msgspec
import numpy as np
import tyro
import viser
from figures import Figure, answer, at_most
from live_page import crowd, shown_page
from reading_clients import CAMERA, unpack_text
from real_images import calibrated
from websockets.sync.client import ClientConnection, connect

from ninedtact import SensorFolder
from ninedtact.calibration.save import save_sensor
from ninedtact.live.sensor_poller import SensorPoller
from ninedtact.live.wrench_history import WrenchHistory, WrenchPoller
from ninedtact.live_sensor import assemble_live_sensor
from ninedtact.simulation.simulated_sources import demo_sources
from ninedtact.studio.page_controller import DisplayedSensor
from ninedtact.studio.press_control import TwinPressController
from ninedtact.studio.twin_press_panel import HANDLE_LIFT_MM

DISPLAY_HZ = 30.0
DEPTHS_MM = (0.6, 0.75)
"""Depths between which the handle is moved; one step of the twin takes the object from one to the other."""


def move_handle(port: int, moves: int, watch_s: float, pipe: Connection) -> None:
    """Move the handle again and again, and send the time of each move in ms, then the updates per second of the images."""
    address = f"ws://127.0.0.1:{port}"
    with connect(address, subprotocols=[f"viser-v{viser.__version__}"], max_size=None, max_queue=None) as client:  # type: ignore[list-item]
        client.send(msgspec.msgpack.encode(CAMERA))
        owner = pipe.recv()
        handle = {"type": "TransformControlsUpdateMessage", "name": "/handle", "owner": owner, "wxyz": (1.0, 0, 0, 0)}
        pause, took_ms = np.random.default_rng(0), []
        for move in range(moves):
            depth = DEPTHS_MM[move % 2]
            sent_s = time.perf_counter()
            client.send(msgspec.msgpack.encode(handle | {"position": (0.0, 0.0, HANDLE_LIFT_MM - depth)}))
            wait_for(client, f"{depth:.2f} mm deep".encode())
            took_ms.append((time.perf_counter() - sent_s) * 1e3)
            read_for(client, float(pause.uniform(0.2, 0.3)))
        started_s, updates = time.perf_counter(), read_for(client, watch_s)
        pipe.send((took_ms, updates / (time.perf_counter() - started_s)))


def wait_for(client: ClientConnection, text: bytes) -> None:
    """Read until a text arrives."""
    while text not in unpack_text(client.recv()):
        pass


def read_for(client: ClientConnection, seconds: float) -> int:
    """Read for a time, and return how many messages had new images."""
    until_s, count = time.perf_counter() + seconds, 0
    while (left_s := until_s - time.perf_counter()) > 0:
        try:
            count += b"_data" in unpack_text(client.recv(timeout=left_s))
        except TimeoutError:
            break
    return count


def page_interaction(moves: int = 60, quick: bool = False, json: bool = False) -> None:
    """Press the twin through the page, and print how long it takes."""
    moves, watch_s = (2, 0.5) if quick else (moves, 5.0)
    with TemporaryDirectory() as path:
        folder = save_sensor(Path(path) / "sensor_a", calibrated("sensor_a", "physics"))
        took_ms, updates_hz, stage_ms = press_through_page(folder, moves, watch_s)
    answer("Pressing the twin through the page", figures(took_ms, updates_hz, stage_ms), json)


def press_through_page(folder: SensorFolder, moves: int, watch_s: float) -> tuple[list[float], float, dict[str, float]]:
    """Return the ms of each move, the updates per second, and the ms of each stage of the last reading."""
    sources = demo_sources(folder.twin())
    live = assemble_live_sensor(folder, sources, follow_reference=False, estimator="physics")
    estimates = WrenchHistory("estimated", "by physics", live.sensor.estimator.notices, states_errors=True)
    true = WrenchPoller(sources.force_torque, "true", "of the simulation")
    context = multiprocessing.get_context("spawn")
    here, there = context.Pipe()

    def keep(reading: object) -> None:
        estimates.add_estimate(reading.force)  # type: ignore[attr-defined]

    with SensorPoller(live.sensor, keep) as poller, true:
        control = TwinPressController(sources.simulation)
        twin = DisplayedSensor(poller, [true.history, estimates], control)
        with shown_page([twin], folder.shape, DISPLAY_HZ, Path("out/readings")) as (server, page):
            person = context.Process(target=move_handle, args=(server.port, moves, watch_s, there))
            person.start()
            while not page.viewers:
                time.sleep(0.05)
            with crowd(server, 1, silent=0, others=1):
                here.send(str(page.viewers[0].client.client_id))
                took_ms, updates_hz = here.recv()
            person.join()
            reading = poller.snapshot(0).reading
    return took_ms, updates_hz, {} if reading is None else reading.stage_ms


def figures(took_ms: list[float], updates_hz: float, stages: dict[str, float]) -> list[Figure]:
    return [
        at_most("from a move to the new state at the client, median ms", statistics.median(took_ms), 100),
        Figure("nine of ten within, ms", float(np.quantile(took_ms, 0.9))),
        Figure("updates of images and surface per second", updates_hz),
        Figure("of these ms, force by physics", stages.get("force", float("nan"))),
    ]


if __name__ == "__main__":
    tyro.cli(page_interaction)
