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
from memory import CameraInMemory, require_linux, resident_now_mb
from mutated_kinds import calibration_images
from page_clients import crowd

from ninedtact import Frame, Sensor, SensorFolder, calibrate
from ninedtact.__main__ import limit_memory_arenas
from ninedtact.calibration.save import save_sensor
from ninedtact.capture.frame_pacing import LatestFrameSource
from ninedtact.recording.reader import Recording
from ninedtact.recording.recorder import record
from ninedtact.reference_images import FollowingSettings, ReferenceImages
from ninedtact.studio.page_and_server import SensorPage, page_server
from ninedtact.studio.page_controller import DisplayedSensor, PageController
from ninedtact.studio.scene_3d import gel_block_under_skin
from ninedtact.studio.sensor_poller import SensorPoller
from ninedtact.studio.wrench_history import WrenchHistory

SETTLED = 8
"""Number of the round from which growth counts: until then, the allocator's arenas of the threads fill."""
MAX_GROWTH_MB = 5.0


class FastCamera(CameraInMemory):
    """A camera of at most 200 Hz. A source without any pause would keep the other threads from running."""

    def read(self) -> Frame:
        """Wait for the next image, and return it."""
        time.sleep(0.005)
        return super().read()


@dataclass(frozen=True)
class Census:
    """What a process holds at one moment."""

    memory_mb: float
    threads: int
    files: int
    children: int


def soak(minutes: float = 30.0, images: int = 1000, recorded: int = 100, json: bool = False) -> None:
    """Repeat rounds until the time is over, and print what has grown.

    images: number that each round reads. recorded: number that each round records.
    """
    cv2.setNumThreads(1)
    require_linux()
    limit_memory_arenas()  # as every command does
    until_s = time.monotonic() + 60 * minutes
    found: list[Census] = []
    with TemporaryDirectory(prefix="soak_") as name:
        folder = Path(name)
        pictures = calibration_images()
        sensor = save_sensor(folder / "sensor", calibrate(pictures))
        camera = FastCamera(pictures.ball_reference, pictures.ball)
        while time.monotonic() < until_s or len(found) < SETTLED + 1:
            watch_page(sensor, camera, folder, images)
            make_recording(sensor, camera, folder / "press.mcap", recorded)
            found.append(count_resources())
            print(f"round {len(found)}: {found[-1]}", file=sys.stderr, flush=True)
        left = sorted(path.name for path in folder.iterdir())
    answer(
        f"Soak: {len(found)} rounds of {images} readings and {recorded} recorded images",
        list(growth(found, left)),
        json,
    )


def watch_page(sensor: SensorFolder, camera: FastCamera, folder: Path, images: int) -> None:
    """Read as fast as possible while three browsers watch."""
    references = ReferenceImages(following=FollowingSettings())
    read = Sensor(LatestFrameSource(camera), sensor.shape, references, sensor.estimator("physics"))
    estimates = WrenchHistory("estimated", "force by physics", states_errors=True)

    def keep(reading) -> None:  # type: ignore[no-untyped-def]
        estimates.add_estimate(reading.force)

    with page_server("127.0.0.1", 0) as server, SensorPoller(read, keep) as poller:
        studio, stop = PageController([DisplayedSensor(poller, [estimates])], folder / "readings"), threading.Event()
        page = SensorPage(server, studio, gel_block_under_skin(sensor.shape, sensor.gel), "soak")
        showing = threading.Thread(target=studio.run, args=(page, 15.0, stop.is_set))
        showing.start()
        with crowd(server, 3):
            while read.frames_read < images:
                time.sleep(0.05)
        stop.set()
        showing.join()


def make_recording(sensor: SensorFolder, camera: FastCamera, path: Path, images: int) -> None:
    """Record, read back and delete."""

    class Few(FastCamera):
        images = camera.images

        def __init__(self) -> None:
            self.next_index = 0

    source = Few()
    record(
        source, path, sensor, heights=True, estimator=sensor.estimator("physics"),
        should_stop=lambda: source.next_index >= images,
    )  # fmt: skip
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


def growth(found: list[Census], left: list[str]) -> Iterator[Figure]:
    """Yield what has grown since the settled round."""
    first, last = found[SETTLED - 1], found[-1]
    yield at_most("growth of memory, MB", last.memory_mb - first.memory_mb, MAX_GROWTH_MB)
    yield at_most("threads more", last.threads - first.threads, 0)
    yield at_most("open files and sockets more", last.files - first.files, 0)
    yield at_most("child processes more", last.children - first.children, 0)
    yield at_most("files left beside the sensor", len(set(left) - {"sensor"}), 0)


if __name__ == "__main__":
    tyro.cli(soak)
