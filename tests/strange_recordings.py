"""Recordings that are damaged behind their checksums, or made to cost memory or time, as Hypothesis draws them.

An MCAP file is taken apart into its records, one thing is changed, and the records are put together again with right checksums, or
none: what only a checksum finds is not found here.
"""

import struct
import zlib
from functools import cache
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from damage import damaged_bytes, damaged_text
from ninedtact.checked_reading import CHECKSUM_KEY, mapping_checksum

Record = tuple[int, bytes]
NUMBERS = st.sampled_from((0, 1, 2, 255, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62, 2**63 - 1, 2**63, 2**64 - 1))
TEXTS = st.sampled_from(
    (
        *("", "0", "-1", "1e400", "nan", "inf", "9" * 5000, str(2**80), "null", "true", "[]", "{}", "[" * 100_000),
        *(
            "\0",
            "\x1b[2J",
            "\u202e",
            "../../x",
            "/dev/zero",
            "a" * 300,
            "x" * 100_000,
            "left",
            "png",
            "zstd",
            "\ud83d\ude00",
        ),
    )
)
SPANS = st.sampled_from(
    (
        *(b"", b"[" * 100_000, b"{}", b"[1]", b"\xff", b'[{"begin_ns":"now","end_ns":1,"label":""}]', b"null"),
        *(b'[{"begin_ns":%d,"end_ns":1,"label":"x"}]' % n for n in (2**62, 2**63, 2**70, -(2**63))),
        *(b'[{"begin_ns":1e400,"end_ns":1,"label":"x"}]', b'[{"begin_ns":1,"end_ns":0,"label":"\\ud800\\u001b[2J"}]'),
        b"[" + b'{"begin_ns":1,"end_ns":2,"label":"x"},' * 20_000 + b'{"begin_ns":1,"end_ns":2,"label":"x"}]',
    )
)


def records_of(data: bytes) -> list[Record]:
    """Return the opcodes and contents of records."""
    records, at = [], 0
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        records.append((opcode, data[at + 9 : at + 9 + length]))
        at += 9 + length
    return records


def joined(records: list[Record]) -> bytes:
    """Return records as they stand in a file."""
    return b"".join(struct.pack("<BQ", opcode, len(content)) + content for opcode, content in records)


@cache
def taken_apart(content: bytes) -> tuple[list[Record], list[Record]]:
    """Return the records before the chunks, metadata and attachments, and those within the chunks."""
    outer, inner = list[Record](), list[Record]()
    for opcode, data in records_of(content[len(MCAP0_MAGIC) : -len(MCAP0_MAGIC)]):
        if opcode == Opcode.DATA_END:
            break
        if opcode == Opcode.CHUNK:
            length = struct.unpack_from("<I", data, 28)[0]
            packed = data[32 + length + 8 :]
            inner += records_of(zstandard.ZstdDecompressor().stream_reader(packed).read())
        elif opcode != Opcode.MESSAGE_INDEX:
            outer.append((opcode, data))
    return outer, inner


def packed(data: bytes, compression: str) -> bytes:
    """Return data as a chunk holds it."""
    if compression == "zstd":
        return zstandard.ZstdCompressor(level=1).compress(data)
    return bytes(lz4.frame.compress(data)) if compression == "lz4" else data


def chunk(data: bytes, compression: str, has_crc: bool, **other: Any) -> Record:
    """Return a chunk; other: what it states or holds in place of the truth."""
    crc, size = zlib.crc32(data) if has_crc else 0, other.get("size", len(data))
    name, body = other.get("name", compression.encode()), other.get("body")
    body = packed(data, compression) if body is None else body
    stated = other.get("body_size", len(body))
    head = struct.pack("<QQQII", 0, 2**62, size, crc, len(name)) + name
    return Opcode.CHUNK, head + struct.pack("<Q", stated) + body


def message_indexes(inner: list[Record]) -> list[Record]:
    """Return the records of the times of messages, as they follow a chunk."""
    entries, at = dict[bytes, bytes](), 0
    for opcode, content in inner:
        if opcode == Opcode.MESSAGE and len(content) >= 22:
            stamp_ns = min(struct.unpack_from("<Q", content, 6)[0], 2**63)
            entries[content[:2]] = entries.get(content[:2], b"") + struct.pack("<QQ", stamp_ns, at)
        at += 9 + len(content)
    return [(Opcode.MESSAGE_INDEX, channel + struct.pack("<I", len(all_)) + all_) for channel, all_ in entries.items()]


def with_checksum(content: bytes, at: int) -> bytes:
    """Return an attachment with the checksum of what is before it."""
    return content[:at] + struct.pack("<I", zlib.crc32(content[:at]))


def attachment(name: bytes, data: bytes, stated: int | None = None) -> bytes:
    """Return the content of an attachment; stated: its size in place of the true one."""
    size = len(data) if stated is None else stated
    body = struct.pack("<QQI", 1, 1, len(name)) + name + struct.pack("<I", 0) + struct.pack("<Q", size) + data
    return with_checksum(body + b"0000", len(body))


def name_and_data(content: bytes) -> tuple[bytes, bytes]:
    """Return the name and the data of a whole attachment."""
    length = struct.unpack_from("<I", content, 16)[0]
    name, rest = content[20 : 20 + length], content[20 + length :]
    media = struct.unpack_from("<I", rest, 0)[0]
    return name, rest[4 + media + 8 : -4]


def metadata(name: str, values: dict[str, str]) -> bytes:
    """Return the content of a metadata record."""

    def text(value: str) -> bytes:
        encoded = value.encode("utf-8", "surrogatepass")
        return struct.pack("<I", len(encoded)) + encoded

    entries = b"".join(text(key) + text(value) for key, value in values.items())
    return text(name) + struct.pack("<I", len(entries)) + entries


def metadata_values(content: bytes) -> tuple[str, dict[str, str]]:
    """Return name and values of a metadata record."""
    words, at = [], 0
    while at < len(content):
        length = struct.unpack_from("<I", content, at)[0]
        if len(words) == 1 and at == 4 + len(words[0]):  # the length of all entries
            at += 4
            continue
        words.append(content[at + 4 : at + 4 + length].decode())
        at += 4 + length
    return words[0], dict(zip(words[1::2], words[2::2], strict=True))


def replaced(records: list[Record], at: int, content: bytes) -> list[Record]:
    """Return records with another content of one."""
    return [*records[:at], (records[at][0], content), *records[at + 1 :]]


def places(records: list[Record], *opcodes: int) -> st.SearchStrategy[int]:
    """Draw the place of a record of these kinds."""
    return st.sampled_from([at for at, (opcode, _) in enumerate(records) if opcode in opcodes])


def checked_toml(text: bytes) -> bytes:
    """Return a damaged `sensor.toml` with the checksum of its numbers, where it is still TOML."""
    import tomllib

    from ninedtact.calibration.sensor_toml_schema import NOT_CALIBRATED

    lines = [line for line in text.decode(errors="replace").splitlines() if not line.startswith(CHECKSUM_KEY)]
    try:
        checksum = mapping_checksum(tomllib.loads("\n".join(lines)), NOT_CALIBRATED)
    except (ValueError, RecursionError):
        return text
    return f'{CHECKSUM_KEY} = "{checksum}"\n'.encode() + "\n".join(lines).encode()


def png_with_right_checksums(content: bytes) -> bytes:
    """Return a damaged PNG whose parts have the checksums of their content."""
    parts, at = [content[:8]], 8
    while at + 12 <= len(content):
        size = struct.unpack_from(">I", content, at)[0]
        body = content[at + 4 : at + 8 + size]
        parts.append(content[at : at + 4] + body + struct.pack(">I", zlib.crc32(body)))
        at += 12 + size
    return b"".join(parts) + content[at:]


@cache
def image_bomb(rows: int, cols: int, bits: int = 8, colour: int = 2) -> bytes:
    """Return a PNG of a few kilobytes that states this size and unpacks to zeros."""
    compressor = zlib.compressobj(9)
    data = (
        b"".join(compressor.compress(bytes(1 << 20)) for _ in range(min(300, rows * cols * 3 >> 20)))
        + compressor.flush()
    )

    def part(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", cols, rows, bits, colour, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + part(b"IHDR", header) + part(b"IDAT", data) + part(b"IEND", b"")


@st.composite
def strange_images(draw: st.DrawFn, content: bytes) -> tuple[str, bytes]:
    """Damage a PNG or JPEG image, whose checksums are right again, or state another size."""
    if content.startswith(b"\xff\xd8") and draw(st.booleans()):
        at = next(at for at in range(len(content)) if content[at : at + 2] in (b"\xff\xc0", b"\xff\xc2"))
        rows, cols = draw(st.sampled_from(((65535, 65535), (20000, 20000), (0, 5), (5, 5), (481, 640))))
        return f"JPEG of {rows} x {cols}", content[: at + 5] + struct.pack(">HH", rows, cols) + content[at + 9 :]
    if draw(st.integers(0, 3)) == 0:
        size = draw(
            st.sampled_from(((20000, 20000), (4000, 4990), (1, 2**31 - 1), (2**31 - 1, 2**31 - 1), (0, 0), (16, 16)))
        )
        bits, colour = draw(st.sampled_from(((8, 2), (16, 2), (1, 0), (8, 3), (8, 6), (3, 7))))
        return f"PNG of {size}, {bits} bits, colour {colour}", image_bomb(*size, bits, colour)
    name, other = draw(damaged_bytes(content))
    return name, png_with_right_checksums(other) if content.startswith(b"\x89PNG") else other


@st.composite
def changed_records(draw: st.DrawFn, inner: list[Record]) -> tuple[str, bytes]:
    """Change one of the records within chunks, or their bytes."""
    what = draw(st.sampled_from(("message", "message", "image", "header", "channel", "bytes")))
    if what == "bytes":
        return draw(damaged_bytes(joined(inner)))
    opcodes = (Opcode.CHANNEL, Opcode.SCHEMA) if what == "channel" else (Opcode.MESSAGE,)
    at = draw(places(inner, *opcodes))
    content = inner[at][1]
    if what == "channel":
        detail, changed = draw(damaged_bytes(content))
    elif what == "header":
        place = draw(st.sampled_from((0, 2, 6, 14)))
        size = {0: "<H", 2: "<I", 6: "<Q", 14: "<Q"}[place]
        number = struct.pack(size, draw(NUMBERS) % 2 ** (8 * struct.calcsize(size)))
        detail, changed = f"byte {place}", content[:place] + number + content[place + len(number) :]
    else:
        detail, data = draw(changed_images(content[22:]) if what == "image" else damaged_bytes(content[22:]))
        changed = content[:22] + data
    return f"{what}: {detail}", joined(replaced(inner, at, changed))


@st.composite
def changed_images(draw: st.DrawFn, data: bytes) -> tuple[str, bytes]:
    """Change the PNG in a message, or a number near its beginning, such as a size."""
    png = data.find(b"\x89PNG")
    if png > 0:
        detail, image = draw(strange_images(data[png:]))
        return detail, data[: png - 4] + struct.pack("<I", len(image)) + image
    place, number = draw(st.integers(0, min(80, len(data) - 4))), draw(NUMBERS) % 2**32
    return f"{number} at byte {place}", data[:place] + struct.pack("<I", number) + data[place + 4 :]


@st.composite
def changed_metadata(draw: st.DrawFn, outer: list[Record]) -> tuple[str, list[Record]]:
    """Change or leave out a value of the metadata, with the checksum or without."""
    at = draw(places(outer, Opcode.METADATA))
    name, values = metadata_values(outer[at][1])
    key, text = draw(st.sampled_from(sorted(values))), draw(TEXTS)
    values = {**values, key: text}
    if key != CHECKSUM_KEY and draw(st.booleans()):
        values[CHECKSUM_KEY] = mapping_checksum(values)
    elif draw(st.booleans()):
        del values[key]
    return f"{key} = {text[:20]!r}", replaced(outer, at, metadata(name, values))


@st.composite
def changed_attachments(draw: st.DrawFn, outer: list[Record]) -> tuple[str, list[Record]]:
    """Change the name, the size or the content of an attached file, or attach spans."""
    at, choice = draw(places(outer, Opcode.ATTACHMENT)), draw(st.integers(0, 6))
    name, data = name_and_data(outer[at][1])
    size, detail = None, ""
    if choice == 0:
        name = draw(TEXTS).encode("utf-8", "surrogatepass") + name
    elif choice == 1:
        name = b"sensor/" + draw(st.binary(max_size=20))
    elif choice == 2:
        size = draw(NUMBERS)
    elif choice == 3:
        return "spans", [*outer, (Opcode.ATTACHMENT, attachment(b"spans.json", draw(SPANS)))]
    elif b"toml" in name:
        detail, data = draw(damaged_text(data))
        data = checked_toml(data)
    else:
        detail, data = draw(strange_images(data) if data.startswith(b"\x89PNG") else damaged_bytes(data))
    return f"{name[:30]!r}, {choice}: {detail}", replaced(outer, at, attachment(name, data, size))


@st.composite
def crowded(draw: st.DrawFn, outer: list[Record], inner: list[Record]) -> tuple[str, list[Record], bytes]:
    """Add tens of thousands of small records of one kind."""
    kind, number = draw(st.sampled_from(("channels", "schemas", "messages", "metadata", "attachments"))), 60_000
    extra = struct.pack("<H", 0) + struct.pack("<I", 4) + b"/a/b" + struct.pack("<I", 3) + b"cdr" + struct.pack("<I", 0)
    if kind == "metadata":
        outer = outer + [(Opcode.METADATA, metadata("x", {"y": "z"}))] * number
    elif kind == "attachments":
        outer = outer + [(Opcode.ATTACHMENT, attachment(b"sensor/%d" % at, b"1")) for at in range(3000)]
    elif kind == "channels":
        inner = inner + [(Opcode.CHANNEL, struct.pack("<H", at % 65536) + extra) for at in range(number)]
    elif kind == "schemas":
        inner = inner + [(Opcode.SCHEMA, struct.pack("<HIII", at % 65535 + 1, 0, 0, 0)) for at in range(number)]
    else:
        first = next(data for opcode, data in inner if opcode == Opcode.MESSAGE and len(data) < 1000)
        inner = inner + [(Opcode.MESSAGE, first)] * number
    return f"many {kind}", outer, joined(inner)


@st.composite
def strange_recordings(draw: st.DrawFn, content: bytes) -> tuple[str, bytes]:
    """Change one thing in a recording and put it together again with right checksums, or none."""
    outer, inner = taken_apart(content)
    kinds = (
        "records",
        "records",
        "records",
        "metadata",
        "attachments",
        "attachments",
        "chunk",
        "bomb",
        "index",
        "file",
        "many",
    )
    what, detail, data, other = draw(st.sampled_from(kinds)), "", joined(inner), dict[str, Any]()
    if what == "bomb":
        return draw(recording_bombs(outer, inner))
    if what == "records":
        detail, data = draw(changed_records(inner))
    elif what == "metadata":
        detail, outer = draw(changed_metadata(outer))
    elif what == "attachments":
        detail, outer = draw(changed_attachments(outer))
    elif what == "many":
        detail, outer, data = draw(crowded(outer, inner))
    elif what == "chunk":
        key = draw(st.sampled_from(("size", "body_size", "name")))
        other[key] = draw(TEXTS).encode("utf-8", "surrogatepass")[:50] if key == "name" else draw(NUMBERS)
        detail = f"{key} = {other[key]}"
    packed_chunk = chunk(data, draw(st.sampled_from(("zstd", "", "lz4"))), draw(st.booleans()), **other)
    indexes = message_indexes(records_of(data)) if what == "index" or draw(st.booleans()) else []
    if what == "index":
        at = draw(st.integers(0, len(indexes) - 1))
        detail, changed = draw(damaged_bytes(indexes[at][1]))
        indexes = replaced(indexes, at, changed)
    body = joined([*outer, packed_chunk, *indexes])
    if what == "file":
        detail, body = draw(damaged_bytes(body))
    return f"{what}: {detail}", finished(body)


def finished(body: bytes) -> bytes:
    """Return the records of a file with its ends, without a summary."""
    return MCAP0_MAGIC + body + joined([(Opcode.DATA_END, bytes(4)), (Opcode.FOOTER, bytes(20))]) + MCAP0_MAGIC


@cache
def zeros(megabytes: int, compression: str, unit: bytes = bytes(1 << 20)) -> bytes:
    """Return some megabytes, packed without being held at once."""
    if compression == "lz4":
        packer = lz4.frame.LZ4FrameCompressor()
        return packer.begin() + b"".join(packer.compress(unit) for _ in range(megabytes)) + packer.flush()
    zstd = zstandard.ZstdCompressor(level=3).compressobj()
    return b"".join(zstd.compress(unit) for _ in range(megabytes)) + zstd.flush()


@st.composite
def recording_bombs(draw: st.DrawFn, outer: list[Record], inner: list[Record]) -> tuple[str, bytes]:
    """Add chunks that unpack to much more than their size, of zeros or of records."""
    compression, megabytes = draw(st.sampled_from(("zstd", "lz4"))), draw(st.sampled_from((50, 63, 300)))
    small = (Opcode.MESSAGE, bytes(22))
    unit = draw(st.sampled_from((bytes(1 << 20), joined([small]) * 34_000, joined([(Opcode.METADATA, b"")]) * 116_000)))
    body = zeros(megabytes, compression, unit)
    size = draw(st.sampled_from((megabytes * len(unit), 100, 2**32, 60_000_000)))
    one = chunk(b"", compression, False, size=size, body=body)
    count = draw(st.sampled_from((1, 5, 60)))
    first = [chunk(joined(inner), "zstd", False), *message_indexes(inner)]
    chunks = first + [one] * count if draw(st.booleans()) else [one] * count + first
    return f"bomb: {count} of {megabytes} MB {compression}, stated {size}", finished(joined([*outer, *chunks]))
