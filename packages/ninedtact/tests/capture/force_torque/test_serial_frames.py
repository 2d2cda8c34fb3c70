"""The plain serial frame: written down once, found again in any noise, however the bytes are portioned."""

import struct
from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st

from ninedtact.capture.force_torque.serial_driver import (
    BEGIN,
    FRAME_BYTES,
    SerialFrame,
    SerialFrameParser,
    parse_serial_frame,
)

numbers = st.floats(-1e3, 1e3, width=32)
frames = st.builds(
    SerialFrame, st.integers(0, 65_535), st.integers(0, 2**32 - 1), st.tuples(*[numbers] * 6), st.integers(0, 3)
)
# The beginning of a frame, a whole half of one, or anything: what looks most like a frame without being one.
garbage = st.one_of(
    st.just(b""),
    st.just(BEGIN[:1]),
    st.just(BEGIN),
    st.binary(max_size=60),
    frames.map(lambda frame: frame.to_bytes()[:20]),
)


def found(raw: bytes, cuts: list[int]) -> list[SerialFrame]:
    finder = SerialFrameParser()
    places = [0, *sorted(cut % (len(raw) + 1) for cut in cuts), len(raw)]
    heard = [frame for start, stop in pairwise(places) for frame in finder.parse(raw[start:stop])]
    # A false beginning in the garbage holds the last frame back until as many bytes have come as a frame has.
    return heard + list(finder.parse(bytes(FRAME_BYTES)))


def test_the_format_is_the_documented_one() -> None:
    raw = SerialFrame(258, 67_305_985, (1.0, -2.0, 0.5, 0.0, 0.0, -1.0), 1).to_bytes()
    assert len(raw) == FRAME_BYTES == 36
    assert raw.hex(" ").startswith("a5 5a 02 01 01 02 03 04 01 00 00 00 80 3f 00 00 00 c0")
    crc = 0xFFFF  # CRC-16/CCITT-FALSE bit by bit: the check value of "123456789" is 29B1
    for byte in raw[2:34]:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    assert struct.unpack("<H", raw[34:])[0] == crc


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(garbage, frames), max_size=6), garbage, st.lists(st.integers(0, 10_000), max_size=12))
def test_every_whole_frame_is_found_in_order_whatever_lies_between(parts, tail, cuts) -> None:
    raw = b"".join(noise + frame.to_bytes() for noise, frame in parts) + tail
    assert found(raw, cuts) == [frame for _, frame in parts]


@settings(max_examples=100, deadline=None)
@given(st.lists(frames, min_size=3, max_size=5), st.integers(0, FRAME_BYTES * 8 - 1), st.booleans())
def test_a_damaged_frame_is_never_believed_and_costs_no_other(sent, bit, is_cut) -> None:
    raw = bytearray(sent[1].to_bytes())
    raw[bit // 8] ^= 1 << bit % 8
    damaged = bytes(raw[: bit // 8]) if is_cut else bytes(raw)
    assert parse_serial_frame(damaged) is None
    heard = found(sent[0].to_bytes() + damaged + b"".join(frame.to_bytes() for frame in sent[2:]), [])
    assert heard == [sent[0], *sent[2:]]
