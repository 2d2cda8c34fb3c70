"""Recording: what an image, heights and a force sample cost to write, how large a minute is, and what each storage of them saves.

Times are the writing thread's own, which other programs on the machine do not change. Images: the twelve real ones, and
untouched skin of the default twin, whose noise is that of a sensor read without compression.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path
from tempfile import TemporaryDirectory
from time import thread_time

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_least
from real_images import PRESSES, real_sensor, sensor_folders

from ninedtact import Frame, HeightMap, Wrench, default_twin, read_image
from ninedtact.recording.metadata import HEIGHT_STEP_16_BIT_MM, RecordingMetadata
from ninedtact.recording.reader import Recording
from ninedtact.recording.recorded_source import RecordedWrenchSource
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.recording.writer import RecordingWriter

HZ, SAMPLES_HZ = 30, 1000
Images = list[np.ndarray]


def recording_speed(count: int = 150, quick: bool = False, json: bool = False) -> None:
    """Measure, and print."""
    twin, count, samples = default_twin(), 4 if quick else count, 200 if quick else 20_000
    sets = {
        "real": [read_image(folder / f"{name}.png") for folder in sensor_folders() for name in PRESSES],
        "twin": [twin.renderer(None, number) for number in range(12)],
    }
    cv2.setNumThreads(1)
    figures = [figure for name, images in sets.items() for figure in of_storages(name, images, count)]
    answer("Recording, one thread", [*figures, *of_heights(count), *of_samples(samples)], json)


def of_storages(name: str, images: Images, count: int) -> list[Figure]:
    """Both storages of images, written and read in turn; ratios are those of one run."""
    frames = [Frame(image, number, number) for number, image in enumerate(islice(cycle(images), count))]
    metadata = {storage: RecordingMetadata("benchmark", images=storage) for storage in ("zstd", "png")}
    zstd, png = (written_and_read(metadata[each], Topic.IMAGES, frames) for each in ("zstd", "png"))
    quick, packed = (cv2.IMWRITE_PNG_COMPRESSION, 1), list[np.ndarray]()
    opencv_ms = timed_ms(lambda: packed.extend(cv2.imencode(".png", image, quick)[1] for image in images))
    opencv = np.array([opencv_ms, sum(map(len, packed)) / 1e3]) / len(images)
    return [
        *compared(f"{name} images as PNG", "zstd", png, zstd),
        at_least(f"{name} images as zstd: most per second", round(1e3 / zstd[0]), 90, "Hz"),
        Figure(f"{name} images as zstd: a minute at {HZ} Hz, MB", round(zstd[2] * HZ * 60 / 1e3)),
        Figure(f"{name} images, OpenCV's fastest PNG, ms and kB", f"{opencv[0]:.1f}, {opencv[1]:.0f}"),
    ]


def of_heights(count: int) -> list[Figure]:
    """Heights of a real ball press and of no contact, in 32 and in 16 bits."""
    images, shape = real_sensor("sensor_a")
    depth = shape.depth_reader(Frame(images["ball_reference"]))
    seen = [depth(shape.rectify(Frame(images[name]))) for name in ("ball", "ball_reference", "board")]
    heights = [replace(height, stamp_ns=number) for number, height in enumerate(islice(cycle(seen), count))]
    steps_mm = {"32 bits": 0.0, "16 bits": HEIGHT_STEP_16_BIT_MM}
    large, small = (
        written_and_read(RecordingMetadata("benchmark", height_step_mm=step), Topic.HEIGHTS, heights)
        for step in steps_mm.values()
    )
    return [*compared("heights in 16 bits", "32 bits", small, large), Figure("heights in 16 bits: step, mm", 0.001)]


def written_and_read(metadata: RecordingMetadata, topic: Topic, items: Sequence[Frame | HeightMap]) -> np.ndarray:
    """Time to write and to read one item, ms, and its size, kB."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "items.mcap"
        with RecordingWriter(path, metadata, [topic]) as episode:
            write_ms = timed_ms(
                lambda: [
                    episode.write_image(item) if isinstance(item, Frame) else episode.write_height(item, item.stamp_ns)
                    for item in items
                ]
            )
        size_kb = path.stat().st_size / 1e3
        with Recording(path) as recording:
            read_ms = timed_ms(lambda: list(recording.frames() if topic is Topic.IMAGES else recording.heights()))
    return np.array([write_ms, read_ms, size_kb]) / len(items)


def compared(what: str, other: str, found: np.ndarray, beside: np.ndarray) -> list[Figure]:
    """Three figures with their ratios to those of the other storage."""
    return [
        Figure(f"{what}: {part}", round(one, 1), peer=f"{other} {two:.1f}; ratio {one / two:.2f}")
        for part, one, two in zip(("written in, ms", "read in, ms", "size, kB"), found, beside, strict=True)
    ]


def of_samples(count: int) -> list[Figure]:
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
