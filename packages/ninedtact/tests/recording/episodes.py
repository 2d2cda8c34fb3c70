"""Small episodes with known content."""

from collections import Counter
from pathlib import Path

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from ninedtact.force.estimator_and_scale import unknown_wrench_estimate
from ninedtact.quantities import EstimateWarning, Frame, Wrench, WrenchEstimate
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import Recording
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.recording.writer import RecordingWriter

BEGAN_NS, FRAME_NS, SAMPLE_NS = 5_000_000_000, 33_333_333, 2_000_001
SHAPE = (30, 44, 3)
TYPES = get_typestore(Stores.ROS2_JAZZY)
BOTH = (Topic.IMAGES, Topic.MEASURED)


def noise(number: int, shape: tuple[int, ...] = SHAPE) -> np.ndarray:
    """An image that no lossy code would keep."""
    return np.random.default_rng(number).integers(0, 256, shape, np.uint8)


def frame(number: int) -> Frame:
    return Frame(noise(number), BEGAN_NS + number * FRAME_NS, number)


def sample(number: int, about_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Wrench:
    """One wrench of five hundred a second, like no other."""
    six = np.random.default_rng(number).normal(0, 1, 6)
    return Wrench(six[:3], six[3:], np.array(about_mm), BEGAN_NS + number * SAMPLE_NS)


def write_episode(path: Path, frames: int = 12, samples: int = 200, session: RecordingMetadata | None = None) -> Path:
    """Images and samples in the order of their stamps, with a file of a sensor folder, in a dozen chunks."""
    with RecordingWriter(
        path, session or RecordingMetadata("small"), BOTH, {"sensor/sensor.toml": b"id = 'small'"}
    ) as episode:
        write_messages(episode, frames, samples)
    return path


def write_messages(episode: RecordingWriter, frames: int = 12, samples: int = 200) -> None:
    """The content of `write_episode`; every `flush` ends a chunk."""
    messages = [frame(number) for number in range(frames)] + [sample(number) for number in range(samples)]
    for number, message in enumerate(sorted(messages, key=lambda message: message.stamp_ns)):
        if isinstance(message, Frame):
            episode.write_image(message)
        else:
            episode.write_measured(message)
        if number % 15 == 14:
            episode.flush()


def read_beginning(path: Path) -> tuple[int, int]:
    """Return how many images and samples a recording holds, which are the beginning of `write_episode`."""
    with Recording(path) as read:
        frames, wrenches = list(read.frames()), list(read.wrenches())
    assert [one.index for one in frames] == list(range(len(frames)))
    assert all(np.array_equal(one.image, noise(one.index)) for one in frames)
    assert all(np.array_equal(one.six, sample(number).six) for number, one in enumerate(wrenches))
    return len(frames), len(wrenches)


def count_as_others_do(path: Path) -> dict[str, int]:
    """Return the messages by topic, as the libraries of MCAP and of ROS bags count them; they must agree."""
    counts: Counter[str] = Counter()
    with path.open("rb") as file:
        for _, channel, _, _ in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            counts[channel.topic] += 1
    with Reader(path) as bag:
        for connection, _, raw in bag.messages():
            TYPES.deserialize_cdr(raw, connection.msgtype)
        assert {one.topic: one.msgcount for one in bag.connections if one.msgcount} == counts
    return counts


def write_estimates(path: Path, frames: int = 4) -> list[WrenchEstimate]:
    """Images and their estimates: a known one, one with two warnings, one that knows nothing, and so on."""
    rng, estimates = np.random.default_rng(0), []
    with RecordingWriter(
        path, RecordingMetadata("small"), {Topic.IMAGES, Topic.ESTIMATED, Topic.COVARIANCE, Topic.WARNINGS}
    ) as episode:
        for number in range(frames):
            image, root = frame(number), rng.normal(size=(6, 6))
            wrench = Wrench(rng.normal(size=3), rng.normal(size=3), stamp_ns=image.stamp_ns)
            warnings = (EstimateWarning.OUT_OF_RANGE, EstimateWarning.PART_UNSEEN)[: 2 * (number % 3 == 1)]
            estimates.append(WrenchEstimate(wrench, root @ root.T, True, warnings))
            if number % 3 == 2:
                estimates[-1] = unknown_wrench_estimate(image.stamp_ns, (EstimateWarning.OUT_OF_RANGE,))
            episode.write_image(image)
            episode.write_estimated(estimates[-1], image.index)
    return estimates
