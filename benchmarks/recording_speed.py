"""Recording: what an image and a force sample cost to write, how large a minute is, and what else could hold the images.

Times are the writing thread's own, which other programs on the machine do not change. Images: the twelve real ones, and
untouched skin of the default twin, whose noise is that of a sensor read without compression.
"""

from collections.abc import Callable
from itertools import cycle, islice
from pathlib import Path
from tempfile import TemporaryDirectory
from time import thread_time

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_least
from real_images import PRESSES, sensor_folders

from ninedtact import Frame, Wrench, default_twin, read_image
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.recorded_source import RecordedSource, RecordedWrenchSource
from ninedtact.recording.ros_messages import Topic
from ninedtact.recording.writer import RecordingWriter

HZ, SAMPLES_HZ = 30, 1000
Images = list[np.ndarray]


def recording_speed(count: int = 150, json: bool = False) -> None:
    """Measure, and print."""
    twin = default_twin()
    sets = {
        "real": [read_image(folder / f"{name}.png") for folder in sensor_folders() for name in PRESSES],
        "twin": [twin.renderer(None, number) for number in range(12)],
    }
    cv2.setNumThreads(1)
    figures = [figure for name, images in sets.items() for figure in of_images(name, images, count)]
    answer("Recording, one thread", [*figures, *of_samples()], json)


def of_images(name: str, images: Images, count: int) -> list[Figure]:
    """Cost and size of 640 x 480 images, beside PNG."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "images.mcap"
        frames = [Frame(image, number, number) for number, image in enumerate(islice(cycle(images), count))]
        with RecordingWriter(path, RecordingMetadata("benchmark"), [Topic.IMAGES]) as episode:
            write_ms = timed_ms(lambda: [episode.write_image(frame) for frame in frames]) / count
        per_image_kb = path.stat().st_size / count / 1e3
        with RecordedSource(path) as source:
            read_ms = timed_ms(lambda: list(source)) / count
    quick = (cv2.IMWRITE_PNG_COMPRESSION, 1)
    packed: list[np.ndarray] = []
    png_ms = timed_ms(lambda: packed.extend(cv2.imencode(".png", image, quick)[1] for image in images)) / len(images)
    png_kb = np.mean([len(one) for one in packed]) / 1e3
    return [
        at_least(f"{name} images: most per second", round(1e3 / write_ms), 90, "Hz", f"PNG {1e3 / png_ms:.0f} Hz"),
        Figure(f"{name} images: written in, ms", round(write_ms, 1), peer=f"PNG {png_ms:.1f}"),
        Figure(f"{name} images: read in, ms", round(read_ms, 1)),
        Figure(
            f"{name} images: size, kB",
            round(per_image_kb),
            peer=f"PNG {png_kb:.0f}, bare {images[0].nbytes / 1e3:.0f}",
        ),
        Figure(f"{name} images: a minute at {HZ} Hz, MB", round(per_image_kb * HZ * 60 / 1e3)),
    ]


def of_samples(count: int = 20_000) -> list[Figure]:
    """Cost and size of wrenches."""
    rng = np.random.default_rng(0)
    samples = [Wrench(rng.normal(0, 3, 3), rng.normal(0, 0.1, 3), stamp_ns=number) for number in range(count)]
    with TemporaryDirectory() as folder:
        path = Path(folder) / "samples.mcap"
        with RecordingWriter(path, RecordingMetadata("benchmark"), [Topic.MEASURED]) as episode:
            write_us = timed_ms(lambda: [episode.write_measured(sample) for sample in samples]) / count * 1e3
        size = path.stat().st_size / count
        with RecordedWrenchSource(path) as source:
            read_us = timed_ms(lambda: [source.read() for _ in range(count)]) / count * 1e3
    return [
        Figure("force samples: written in, µs", round(write_us)),
        Figure("force samples: read in, µs", round(read_us)),
        Figure(f"force samples: a minute at {SAMPLES_HZ} Hz, MB", round(size * SAMPLES_HZ * 60 / 1e6, 1)),
    ]


def timed_ms(work: Callable[[], object]) -> float:
    """The thread's own time."""
    began = thread_time()
    work()
    return (thread_time() - began) * 1e3


if __name__ == "__main__":
    tyro.cli(recording_speed)
