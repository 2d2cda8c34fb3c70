"""Recordings of strangers: damaged behind their checksums, or made to cost memory; refused in one sentence within limits."""

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from ninedtact import Frame, Wrench
from ninedtact.capture.strict_image_reading import decode_image_file
from ninedtact.checked_reading import parse_toml
from ninedtact.cli import main
from ninedtact.csv_table import to_csv
from ninedtact.errors import FileFormatError, NinedtactError
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.recording.reader import Recording
from ninedtact.recording.topics_and_messages import RecordingEvent, RecordingEventKind, Topic, encode_image
from ninedtact.recording.writer import RecordingWriter


def write_recording(path: Path, images: str = "zstd", sensor: str = "strange") -> Path:
    metadata = RecordingMetadata(sensor, images=images, mm_per_px=0.05, wall_minus_monotonic_ns=10**18)  # type: ignore[arg-type]
    topics = [Topic.IMAGES, Topic.MEASURED, Topic.EVENTS]
    with RecordingWriter(path, metadata, topics, {"sensor/one.txt": b"1"}) as writer:
        for number in range(6):
            stamp_ns = 10**9 + number * 33_000_000
            writer.write_image(Frame(np.full((12, 16, 3), number, np.uint8), stamp_ns, number))
            writer.write_measured(Wrench(np.array([0.1, 0.2, -number]), np.zeros(3), stamp_ns=stamp_ns))
        writer.write_event(RecordingEvent(stamp_ns, RecordingEventKind.DROPPED, "3"))
    return path


def rewritten(path: Path, out: Path, change: "object" = None) -> Path:
    """Write all records anew, uncompressed and with right checksums, where `change` may exchange the data of each message."""
    with Recording(path) as recording, out.open("wb") as file:
        source, writer = recording.file, Writer(file, 1 << 20, CompressionType.NONE)
        writer.start("ros2", "test")
        for one in source.metadata:
            writer.add_metadata(one.name, one.metadata)
        for number, record in enumerate(record for chunk in source.chunks() for record in chunk):
            kind = type(record).__name__
            if kind == "Schema":
                writer.register_schema(record.name, record.encoding, record.data)  # type: ignore[attr-defined]
            elif kind == "Channel":
                writer.register_channel(record.topic, record.message_encoding, record.schema_id, record.metadata)  # type: ignore[attr-defined]
            else:
                data = change(number, record.data) if callable(change) else record.data  # type: ignore[attr-defined]
                writer.add_message(record.channel_id, record.log_time, data, record.publish_time, record.sequence)  # type: ignore[attr-defined]
        writer.finish()
    return out


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    code = main(list(map(str, words)))
    said = capsys.readouterr()
    return code, said.out + said.err


@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.integers(0, 30), st.integers(0, 5000), st.binary(max_size=40), st.booleans(), st.sampled_from(["zstd", "png"])
)
def test_a_message_that_is_damaged_behind_its_checksum_is_refused_in_one_sentence(
    tmp_path_factory: pytest.TempPathFactory,
    capsys: pytest.CaptureFixture[str],
    which: int,
    at: int,
    other: bytes,
    cut: bool,
    images: str,
) -> None:
    folder = tmp_path_factory.mktemp("message")

    def change(number: int, data: bytes) -> bytes:
        if number % 31 != which:
            return data
        place = at % (len(data) + 1)
        return data[:place] + other + (b"" if cut else data[place + len(other) :])

    path = rewritten(write_recording(folder / "whole.mcap", images), folder / "damaged.mcap", change)
    for words in (("info", path), ("export", path, "--out", folder / "out")):
        code, said = run(capsys, *words)
        assert code in (0, 1) and (code == 0 or "expected" in said.splitlines()[-1]), said


def with_chunk(path: Path, out: Path, data: bytes, stated: int, compression: bytes = b"zstd") -> Path:
    """Exchange the first chunk of a recording for one with this content and stated size."""
    content = path.read_bytes()
    at = len(MCAP0_MAGIC)
    while content[at] != 6:
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    length = int.from_bytes(content[at + 1 : at + 9], "little")
    chunk = struct.pack("<QQQII", 0, 0, stated, 0, len(compression)) + compression + struct.pack("<Q", len(data)) + data
    out.write_bytes(content[:at] + struct.pack("<BQ", 6, len(chunk)) + chunk + content[at + 9 + length :])
    return out


@pytest.mark.parametrize("stated", [100, 1 << 32, 60_000_000])
def test_a_chunk_that_unpacks_to_more_than_it_may_is_refused(tmp_path: Path, stated: int) -> None:
    compressor, parts = zstandard.ZstdCompressor().compressobj(), []
    parts += [compressor.compress(bytes(1 << 20)) for _ in range(300)]
    bomb = b"".join([*parts, compressor.flush()])
    assert len(bomb) < 100_000
    path = with_chunk(write_recording(tmp_path / "whole.mcap"), tmp_path / "bomb.mcap", bomb, stated)
    with pytest.raises(FileFormatError):
        Recording(path)


@pytest.mark.parametrize("number", [2**80, -(2**80), 1 << 63])
def test_clocks_of_no_time_are_refused(number: int) -> None:
    from ninedtact.recording.metadata import parse_recording_metadata

    with pytest.raises(FileFormatError):
        parse_recording_metadata(RecordingMetadata("x", wall_minus_monotonic_ns=number).to_mcap_metadata(), "x")


@pytest.mark.parametrize(
    ("name", "length"),
    [
        (b"sensor/a\xff", 1),
        (b"sensor/a\0b", 1),
        (b"sensor/sensor.toml/a", 1),
        (b"spans.json", 1 << 60),
        (b"spans.json", 0),
    ],
)
@pytest.mark.parametrize("text", [b'[{"begin_ns":"now","end_ns":1,"label":""}]', b"[" * 100_000])
def test_attachments_are_read_within_their_limits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: bytes, length: int, text: bytes
) -> None:
    content = write_recording(tmp_path / "whole.mcap").read_bytes()
    at = len(MCAP0_MAGIC)
    while content[at] != 9:
        at += 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    end = at + 9 + int.from_bytes(content[at + 1 : at + 9], "little")
    stated = length if length > 1 else len(text)
    body = struct.pack("<QQI", 0, 0, len(name)) + name + struct.pack("<I", 0) + struct.pack("<Q", stated) + text
    body += struct.pack("<I", zlib.crc32(body))
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content[:at] + struct.pack("<BQ", 9, len(body)) + body + content[end:])
    for words in (("info", path), ("export", path, "--out", tmp_path / "out")):
        code, said = run(capsys, *words)
        assert code in (0, 1) and (code == 0 or "expected" in said.splitlines()[-1]), said


def test_names_of_strangers_are_escaped_in_terminals_messages_and_tables(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_recording(tmp_path / "a.mcap", sensor="left\x1b[31m\u202e\x9b")
    for words in (("info", path), ("info", path, "--json")):
        code, said = run(capsys, *words)
        assert code == 0 and not set(said) & set("\x1b\u202e\x9b")
    assert "\x1b" not in str(NinedtactError("expected a, got \x1b[2J; b"))
    assert to_csv(["a", "b", "c"], [["=1+1", -1.5, "ball"]]).decode().splitlines() == ["a,b,c", "'=1+1,-1.5,ball"]
    surrogates = RecordingMetadata("x", source="caf\udce9.mp4").to_mcap_metadata()
    assert surrogates["source"].encode().decode() == "caf\\udce9.mp4"


def test_images_of_a_recording_have_one_size_and_one_format(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    other = encode_image(np.zeros((5, 6, 3), np.uint8), 0, "png")

    def change(number: int, data: bytes) -> bytes:
        return other if b"png compressed" in data and b"IHDR" in data and number > 10 else data

    path = rewritten(write_recording(tmp_path / "a.mcap", "png"), tmp_path / "b.mcap", change)
    code, said = run(capsys, "export", path, "--out", tmp_path / "out")
    assert code == 1 and "16 x 12" in said and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "text", [".".join(["a"] * 50_000) + " = 1", "a = " + "[" * 100_000, "a = 1\n" * 500_000, "a = " + "9" * 9000]
)
def test_toml_that_would_take_long_is_refused_before_it_is_parsed(text: str) -> None:
    with pytest.raises(ValueError):
        parse_toml(text)


def test_more_channels_than_a_recording_has_are_refused(tmp_path: Path) -> None:
    names = b"".join(struct.pack("<I", len(each)) + each for each in (b"/a/b", b"cdr"))
    channels = (struct.pack("<HH", at, 0) + names + struct.pack("<I", 0) for at in range(1, 60_000))
    data = b"".join(struct.pack("<BQ", 4, len(one)) + one for one in channels)
    packed = zstandard.ZstdCompressor().compress(data)
    path = with_chunk(write_recording(tmp_path / "whole.mcap"), tmp_path / "channels.mcap", packed, len(data))
    with pytest.raises(FileFormatError, match="damaged"):
        Recording(path)


def test_a_png_without_its_palette_is_refused() -> None:
    def part(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = part(b"IHDR", struct.pack(">IIBBBBB", 16, 16, 8, 3, 0, 0, 0))
    content = b"\x89PNG\r\n\x1a\n" + header + part(b"IDAT", zlib.compress(bytes(17 * 16))) + part(b"IEND", b"")
    with pytest.raises(FileFormatError):
        decode_image_file(content)
