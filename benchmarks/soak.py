"""Hours of use in minutes: does anything grow or stay behind?

One round: a sensor opens, its page is watched by three browsers, one of which never reads, and it is read as fast as it can be with
force by physics and a reference that follows; it closes, then a recording with heights and forces is made, read back and deleted.
Memory, threads, open files (sockets among them) and child processes are counted after each round. What counts is their growth from
the eighth round on, when everything has been used and the allocator has settled. Run it with `make soak`.
"""

import ctypes
import gc
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import tyro
from figures import Figure, answer, at_most
from live_page import CameraInMemory, crowd, require_linux, resident_now_mb, shown_page
from real_images import calibrated

from ninedtact import Recording, Sensor, SensorFolder, record, save_sensor
from ninedtact.__main__ import limit_memory_arenas
from ninedtact.capture.frame_pacing import LatestFrameSource
from ninedtact.live.sensor_poller import SensorPoller
from ninedtact.live.wrench_history import WrenchHistory
from ninedtact.reference_images import FollowingSettings, ReferenceImages
from ninedtact.studio.page_controller import DisplayedSensor

SETTLED = 8
"""Number of the round from which growth counts: until then, the allocator's arenas of the threads fill."""
MAX_GROWTH_MB = 5.0
HZ = 200.0
"""Rate of the camera; one without any pause would keep the other threads from running."""


@dataclass(frozen=True)
class Census:
    """What a process holds at one moment."""

    memory_mb: float
    threads: int
    files: int
    children: int


def soak(
    minutes: float = 30.0, images: int = 1000, recorded: int = 100, quick: bool = False, json: bool = False
) -> None:
    """Repeat rounds until the time is over, and print what has grown. images, recorded: read and recorded in each round."""
    cv2.setNumThreads(1)
    require_linux()
    limit_memory_arenas()  # as every command does
    minutes, images, recorded, settled = (0.0, 8, 12, 1) if quick else (minutes, images, recorded, SETTLED)
    until_s = time.monotonic() + 60 * minutes
    found: list[Census] = []
    with TemporaryDirectory(prefix="soak_") as name:
        folder, made = Path(name), calibrated("sensor_a", "physics")
        sensor = save_sensor(folder / "sensor", made)
        while time.monotonic() < until_s or len(found) < settled + 1:
            watch_page(sensor, CameraInMemory(vars(made.images), HZ), folder / "readings", images)
            make_recording(sensor, CameraInMemory(vars(made.images), HZ), folder / "press.mcap", recorded)
            found.append(count_resources())
            print(f"round {len(found)}: {found[-1]}", file=sys.stderr, flush=True)
        left = {path.name for path in folder.iterdir()} - {"sensor"}
    title = f"Soak: {len(found)} rounds of {images} readings and {recorded} recorded images"
    answer(
        title,
        list(growth(found[settled - 1], found[-1], len(left), 10 * MAX_GROWTH_MB if quick else MAX_GROWTH_MB)),
        json,
    )


def watch_page(sensor: SensorFolder, camera: CameraInMemory, readings: Path, images: int) -> None:
    """Read as fast as possible while three browsers watch."""
    references = ReferenceImages(following=FollowingSettings())
    read = Sensor(LatestFrameSource(camera), sensor.shape, references, sensor.estimator("physics"))
    estimates = WrenchHistory("estimated", "force by physics", states_errors=True)

    def keep(reading) -> None:  # type: ignore[no-untyped-def]
        estimates.add_estimate(reading.force)

    with SensorPoller(read, keep) as poller:
        shown = [DisplayedSensor(poller, [estimates])]
        with shown_page(shown, sensor.shape, 15.0, readings) as (server, _), crowd(server, 3):
            while read.frames_read < images:
                time.sleep(0.05)


def make_recording(sensor: SensorFolder, camera: CameraInMemory, path: Path, images: int) -> None:
    """Record, read back and delete."""
    estimator = sensor.estimator("physics")
    record(camera, path, sensor, heights=True, estimator=estimator, should_stop=lambda: camera.next_index >= images)
    with Recording(path) as recording:
        assert sum(1 for _ in recording.frames()) > 0
    path.unlink()


def count_resources() -> Census:
    """Count what this process holds now."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)  # what the allocator keeps for itself is not in use
    children = Path(f"/proc/self/task/{threading.get_native_id()}/children").read_text().split()
    return Census(
        resident_now_mb(), threading.active_count(), len(list(Path("/proc/self/fd").iterdir())), len(children)
    )


def growth(first: Census, last: Census, left: int, most_mb: float) -> Iterator[Figure]:
    """Yield what has grown since the settled round; after a single one the allocator has not settled yet."""
    yield Figure(
        "memory after the settled and after the last round, MB", f"{first.memory_mb:.1f}, {last.memory_mb:.1f}"
    )
    yield at_most("growth of memory, MB", last.memory_mb - first.memory_mb, most_mb)
    yield at_most("threads more", last.threads - first.threads, 0)
    yield at_most("open files and sockets more", last.files - first.files, 0)
    yield at_most("child processes more", last.children - first.children, 0)
    yield at_most("files left beside the sensor", left, 0)


if __name__ == "__main__":
    tyro.cli(soak)
