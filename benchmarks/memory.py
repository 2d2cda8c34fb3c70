"""Whether memory grows: 100,000 frames through a `Sensor` (capture, rectify, height) and on to points with normals.

The source is a camera that lives in memory: every frame has memory of its own, as a driver would give it. Resident
memory is sampled between frames; what counts is its growth from frame 1,000, when everything has been used once.
"""

import gc
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_most
from live_page import CameraInMemory
from real_images import real_sensor
from tqdm import tqdm

from ninedtact import Sensor, point_cloud

SETTLED = 1000
SAMPLES = 100
STATM = Path("/proc/self/statm")


def memory(frames: int = 100_000, quick: bool = False, json: bool = False) -> None:
    """Run, and print the growth."""
    cv2.setNumThreads(1)
    require_linux()
    frames, settled = (20, 10) if quick else (frames, SETTLED)
    images, shape = real_sensor("sensor_a")
    camera = CameraInMemory(images)
    start = time.perf_counter()
    with Sensor(camera, shape) as sensor:
        samples = list(resident_mb(sensor, frames, settled))
    answer("Memory over many frames", grown(samples, frames, time.perf_counter() - start), json)


def resident_mb(sensor: Sensor, frames: int, settled: int) -> Iterator[tuple[int, float]]:
    """Frame number and resident memory in MB, at the settled frame and then evenly."""
    every = max((frames - settled) // SAMPLES, 1)
    for number in tqdm(range(1, frames + 1), unit=" frames", mininterval=5, disable=None):
        point_cloud(sensor.read().height)
        if number >= settled and (number - settled) % every == 0:
            gc.collect()
            yield number, resident_now_mb()


def resident_now_mb() -> float:
    pages = int(STATM.read_text().split()[1])
    return pages * 4096 / 1e6


def grown(samples: list[tuple[int, float]], frames: int, seconds: float) -> list[Figure]:
    resident = np.array([mb for _, mb in samples])
    return [
        at_most(f"growth from frame {samples[0][0]} to {samples[-1][0]}, MB", resident[-1] - resident[0], 1, "MB"),
        Figure("resident memory at the start and at the end, MB", f"{resident[0]:.1f}, {resident[-1]:.1f}"),
        Figure("least and most in between, MB", f"{resident.min():.1f}, {resident.max():.1f}"),
        Figure("frames per second, capture and points included", frames / seconds),
    ]


def require_linux() -> None:
    if not STATM.is_file():
        sys.exit("expected Linux, whose /proc tells resident memory, got another system; run this one there")


if __name__ == "__main__":
    tyro.cli(memory)
