"""Our topics in files of other programs, without metadata, sensor folder, numbers, times or chunks: read with --sensor."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from twin_folder import twin_folder

from ninedtact.cli import main
from ninedtact.errors import NinedtactError
from ninedtact.quantities import Frame, HeightMap, Wrench, WrenchEstimate
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import Recording, recorded_sensor_addresses
from ninedtact.recording.topics_and_messages import (
    Topic,
    decode_image,
    encode_message,
    message_header,
    type_store,
)
from ninedtact.recording.writer import RecordingWriter

IMAGES = 12
WALL_NS = 10**18


@dataclass(frozen=True)
class Program:
    """How another program writes what it receives."""

    chunks: bool = True
    index: bool = True
    own_clock: bool = False
    """Whether it stamps with the wall clock when a message arrives, and numbers nothing, as `ros2 bag record` does."""


PROGRAMS = {
    "mcap filter": Program(),
    "ros2 bag": Program(own_clock=True),
    "ros2 bag, fastwrite": Program(chunks=False, index=False, own_clock=True),
    "no index": Program(index=False),
}


def rewrite(paths: list[Path], out: Path, program: Program, topics: tuple[str, ...] = ("",)) -> Path:
    """Write the messages of recordings as another program does, of topics that end so."""
    with out.open("wb") as file:
        index = IndexType.ALL if program.index else IndexType.NONE
        writer = Writer(file, 100_000, CompressionType.ZSTD, use_chunking=program.chunks, index_types=index)
        writer.start("ros2", "another program")
        writer.add_metadata("rosbag2", {"serialized_metadata": "version: 9"})
        channels: dict[str, int] = {}
        for path in paths:
            with path.open("rb") as whole:
                for number, (schema, channel, one) in enumerate(make_reader(whole).iter_messages(log_time_order=False)):
                    assert schema is not None
                    if not channel.topic.endswith(topics):
                        continue
                    if channel.topic not in channels:
                        kind = writer.register_schema(schema.name, schema.encoding, schema.data)
                        channels[channel.topic] = writer.register_channel(channel.topic, "cdr", kind)
                    at_ns = one.publish_time + 1000 * number if program.own_clock else one.log_time
                    sent_ns = at_ns - 2_000_000 if program.own_clock else one.publish_time
                    sequence = 0 if program.own_clock else one.sequence
                    writer.add_message(channels[channel.topic], at_ns, one.data, sent_ns, sequence)
        writer.finish()
    return out


def write_recording(path: Path, skin: np.ndarray, sensor: str = "twin") -> Path:
    metadata = RecordingMetadata(sensor, mm_per_px=0.05, wall_minus_monotonic_ns=WALL_NS)
    topics = (Topic.IMAGES, Topic.MEASURED, Topic.HEIGHTS, Topic.ESTIMATED, Topic.COVARIANCE)
    with RecordingWriter(path, metadata, topics) as writer:
        for number in range(IMAGES):
            stamp_ns, index = 10**9 + number * 33_000_000, 3 + 2 * number
            image = cv2.subtract(skin, (5.0 * (number == IMAGES - 1),) * 4)  # type: ignore[call-overload]
            writer.write_image(Frame(image, stamp_ns, index))
            wrench = Wrench(np.array([0.1, 0.2, -number]), np.zeros(3), stamp_ns=stamp_ns)
            writer.write_measured(wrench)
            z_mm = np.full((6, 8), -0.1 * number, np.float32)
            writer.write_height(HeightMap(z_mm, np.full((6, 8), 2, np.uint8), 0.05, stamp_ns=stamp_ns), index)
            writer.write_estimated(WrenchEstimate(wrench, (1.0 + number) * np.eye(6), True), index)
    return path


@pytest.fixture(scope="module")
def sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return twin_folder(tmp_path_factory.mktemp("others") / "sensor")


@pytest.fixture(scope="module")
def skin(sensor: Path) -> np.ndarray:
    image = cv2.imread(str(sensor / "untouched.png"))
    assert image is not None
    return image


@pytest.mark.parametrize("program", PROGRAMS.values(), ids=PROGRAMS.keys())
def test_a_rewritten_recording_holds_what_it_held(
    tmp_path: Path, sensor: Path, skin: np.ndarray, program: Program, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = write_recording(tmp_path / "whole.mcap", skin)
    path = rewrite([whole], tmp_path / "rewritten.mcap", program)
    with Recording(whole) as before, Recording(path, sensor) as after:
        assert after.is_finished and after.sensor == "twin" and after.topics == before.topics
        numbers = list(range(IMAGES)) if program.own_clock else [frame.index for frame in before.frames()]
        assert [frame.index for frame in after.frames()] == numbers
        for one, other in zip(before.frames(), after.frames(), strict=True):
            np.testing.assert_array_equal(one.image, other.image)
            wall_ns = (
                recording.metadata.wall_ns(frame.stamp_ns) for recording, frame in ((before, one), (after, other))
            )
            assert abs(next(wall_ns) - next(wall_ns)) < 10**6
        for one, other in zip(before.estimates(), after.estimates(), strict=True):
            np.testing.assert_array_equal(one.covariance, other.covariance)
            np.testing.assert_array_equal(one.wrench.six, other.wrench.six)
        for (_, z_mm), (index, same), number in zip(before.heights(), after.heights(), numbers, strict=True):
            assert index == number
            np.testing.assert_array_equal(z_mm, same)
        assert len(list(after.readings())) == IMAGES
    for command in (["info"], ["estimate", "--force", "none"], ["export", "--out", str(tmp_path / "out")]):
        assert main([*command, str(path), "--sensor", str(sensor)]) == 0, capsys.readouterr()
    assert (tmp_path / "out/sensor/sensor.toml").read_bytes() == (sensor / "sensor.toml").read_bytes()
    assert main(["record", "--source", str(path), "--sensor", str(sensor), "--out", str(tmp_path / "anew.mcap")]) == 0
    capsys.readouterr()
    assert main(["estimate", str(path)]) == 1 and "name one with --sensor" in capsys.readouterr().err
    assert main(["info", str(path)]) == 0 and "with --sensor FOLDER" in capsys.readouterr().err


def test_several_sensors_are_told_apart_by_their_topics(tmp_path: Path, sensor: Path, skin: np.ndarray) -> None:
    parts = [write_recording(tmp_path / f"{name}.mcap", skin, name) for name in ("left", "twin")]
    path = rewrite(parts, tmp_path / "both.mcap", PROGRAMS["ros2 bag"])
    assert recorded_sensor_addresses(path) == [f"{path}#left", f"{path}#twin"]
    with Recording(path, sensor) as recording:
        assert recording.sensor == "twin" and len(recording.stamps_ns(Topic.IMAGES)) == IMAGES
    with pytest.raises(NinedtactError, match="#left"):
        Recording(path)


@pytest.mark.parametrize("ending", [".jpg", ".png"])
def test_compressed_images_of_other_programs_are_read(
    tmp_path: Path, sensor: Path, skin: np.ndarray, ending: str
) -> None:
    path, name = tmp_path / "compressed.mcap", "sensor_msgs/msg/CompressedImage"
    types, content = type_store().types, cv2.imencode(ending, skin)[1].reshape(-1)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        channel = writer.register_channel(
            "/twin/image_raw/compressed", "cdr", writer.register_schema(name, "ros2msg", b"")
        )
        for number in range(3):
            header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](number, 0), "camera")
            data = encode_message(name, header=header, format="bgr8; jpeg compressed bgr8", data=content)
            writer.add_message(channel, WALL_NS + number * 10**8, data, WALL_NS + number * 10**8)
        writer.finish()
    with Recording(path, sensor) as recording:
        images = [frame.image.astype(int) for frame in recording.frames()]
    assert len(images) == 3 and max(np.abs(image - skin).max() for image in images) < (40 if ending == ".jpg" else 1)


@pytest.mark.parametrize("encoding", ["bgr8", "8UC3", "rgb8", "bgra8", "rgba8", "mono8", "8UC1"])
@pytest.mark.parametrize("padding", [0, 5])
def test_images_of_every_driver_are_read_as_blue_green_and_red(skin: np.ndarray, encoding: str, padding: int) -> None:
    """Whatever the order of the channels, and with rows that are longer than their pixels."""
    conversions = {"r": cv2.COLOR_BGR2RGBA, "b": cv2.COLOR_BGR2BGRA, "8": cv2.COLOR_BGR2BGRA, "m": cv2.COLOR_BGR2GRAY}
    is_grey, has_alpha = encoding in ("mono8", "8UC1"), "a" in encoding
    pixels = cv2.cvtColor(skin, cv2.COLOR_BGR2GRAY if is_grey else conversions[encoding[0]])
    rows = (pixels if is_grey or has_alpha else pixels[..., :3]).reshape(len(skin), -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    layout = {"height": len(skin), "width": skin.shape[1], "encoding": encoding, "is_bigendian": 1}
    header = message_header(WALL_NS, "camera")
    data = encode_message("sensor_msgs/msg/Image", header=header, step=rows.shape[1], data=rows.reshape(-1), **layout)
    truth = cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR) if is_grey else skin
    np.testing.assert_array_equal(decode_image(data), truth)
    empty = encode_message("sensor_msgs/msg/Image", header=header, step=0, data=rows[:0, 0], **{**layout, "height": 0})
    with pytest.raises(ValueError, match="0 bytes"):
        decode_image(empty)
    with pytest.raises(ValueError, match=r"yuv.*bgr8.*are read"):
        decode_image(data.replace(encoding.encode() + b"\0", b"yuv422_yuy2"[: len(encoding)] + b"\0"))


def test_the_file_in_the_folder_of_a_bag_is_named(
    tmp_path: Path, skin: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_recording(tmp_path / "bag_0.mcap", skin)
    for command in (
        ["info"],
        ["estimate", "--force", "none", "--sensor", "x"],
        ["export", "--out", str(tmp_path / "out")],
    ):
        assert main([*command, str(tmp_path)]) == 1
    assert capsys.readouterr().err.count(str(path)) >= 2


def test_a_recording_without_images_of_ros_names_its_topics(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "foxglove.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.CompressedImage", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/camera", "json", schema), WALL_NS, b"{}", WALL_NS)
        writer.finish()
    assert main(["info", str(path)]) == 1
    assert "/camera (foxglove.CompressedImage); record with" in capsys.readouterr().err
