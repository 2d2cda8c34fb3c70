"""Any file at all is either a whole 8-bit BGR image or one clear sentence."""

import os
import re
import threading
import zlib
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from ninedtact.capture.strict_image_reading import average_images, image_file_fault, read_image, require_image_size
from ninedtact.errors import FileFormatError

IMAGE = np.random.default_rng(0).integers(0, 256, (24, 32, 3), dtype=np.uint8)
SMOOTH = cv2.GaussianBlur(IMAGE, (0, 0), 4)


def encoded(image: np.ndarray, suffix: str) -> bytes:
    done, content = cv2.imencode(suffix, image)
    assert done
    return content.tobytes()


def png_chunk(kind: bytes, body: bytes) -> bytes:
    return len(body).to_bytes(4) + kind + body + zlib.crc32(kind + body).to_bytes(4)


WHOLE = {suffix: encoded(SMOOTH, suffix) for suffix in (".png", ".jpg", ".bmp")}
FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def read_or_refuse(content: bytes, folder: Path) -> np.ndarray | None:
    path = folder / "image"
    path.write_bytes(content)
    try:
        image = read_image(path)
    except FileFormatError as refusal:
        assert "expected" in str(refusal) and ", got " in str(refusal) and "; " in str(refusal)
        return None
    assert image.dtype == np.uint8 and image.ndim == 3 and image.shape[2] == 3
    return image


@FUZZ
@given(suffix=st.sampled_from(sorted(WHOLE)), cut=st.floats(0, 1, exclude_max=True))
def test_a_file_cut_at_any_byte_is_refused(tmp_path: Path, suffix: str, cut: float) -> None:
    content = WHOLE[suffix]
    assert read_or_refuse(content[: int(cut * len(content))], tmp_path) is None


@pytest.mark.parametrize("suffix", WHOLE)
def test_the_last_bytes_count_too(tmp_path: Path, suffix: str) -> None:
    assert read_or_refuse(WHOLE[suffix], tmp_path) is not None
    assert read_or_refuse(WHOLE[suffix] + b"\0" * 20, tmp_path) is not None
    for missing in range(1, 20):
        assert read_or_refuse(WHOLE[suffix][:-missing], tmp_path) is None


@FUZZ
@given(
    suffix=st.sampled_from(sorted(WHOLE)), flips=st.lists(st.integers(0, 10**6), min_size=1, max_size=6, unique=True)
)
def test_flipped_bits_are_refused_or_read_as_a_image(tmp_path: Path, suffix: str, flips: list[int]) -> None:
    content = bytearray(WHOLE[suffix])
    for flip in flips:
        content[flip // 8 % len(content)] ^= 1 << flip % 8
    image = read_or_refuse(bytes(content), tmp_path)
    if suffix == ".png" and bytes(content) != WHOLE[suffix]:
        assert image is None  # a PNG carries checksums


def test_an_intact_jpeg_of_another_encoder_is_read(tmp_path: Path) -> None:
    """Some webcams pad with 0xFF before restart markers and behind the scan, and some programs append a preview."""
    interval = (cv2.IMWRITE_JPEG_RST_INTERVAL, 1)
    content = cv2.imencode(".jpg", np.tile(SMOOTH, (2, 2, 1)), interval)[1].tobytes()
    padded = content.replace(b"\xff\xd1", b"\xff\xff\xff\xd1")
    assert padded != content
    whole = read_or_refuse(content, tmp_path)
    for other in (padded, content[:-2] + b"\xff" + content[-2:], content + WHOLE[".jpg"]):
        assert np.array_equal(read_or_refuse(other, tmp_path), whole)
    thumbnail = jpeg_segment(0xE1, b"Exif" + WHOLE[".jpg"])  # its end is not the file's
    assert np.array_equal(read_or_refuse(content[:2] + thumbnail + content[2:], tmp_path), whole)
    assert read_or_refuse(content[:2] + thumbnail + content[2:-2], tmp_path) is None


@settings(FUZZ, max_examples=60)
@given(
    levels=arrays(np.uint8, st.tuples(st.integers(1, 40), st.integers(1, 40), st.just(3))),
    quality=st.integers(1, 100),
    options=st.sampled_from([{}, {"progressive": True}, {"optimize": True}, {"restart_marker_blocks": 1}]),
    subsampling=st.integers(0, 2),
    encoder=st.sampled_from(["Pillow", "libjpeg-turbo"]),
    padding=st.integers(0, 4),
    kept=st.floats(0.0, 1.0, exclude_max=True),
)
def test_intact_jpeg_is_read_and_cut_jpeg_is_refused(
    levels: np.ndarray,
    quality: int,
    options: dict[str, Any],
    subsampling: int,
    encoder: str,
    padding: int,
    kept: float,
    tmp_path: Path,
) -> None:
    """Of every encoder and setting, with bytes 0xFF before restart markers, where T.81 (B.1.1.2) allows any number of them."""
    if encoder == "Pillow":
        written = BytesIO()
        Image.fromarray(levels).save(written, "JPEG", quality=quality, subsampling=subsampling, **options)
        content = written.getvalue()
    else:
        chosen = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_RST_INTERVAL, subsampling]
        content = cv2.imencode(".jpg", levels, [*chosen, cv2.IMWRITE_JPEG_PROGRESSIVE, int("progressive" in options)])[
            1
        ].tobytes()
    header, scan = content.split(b"\xff\xda", 1)
    padded = header + b"\xff\xda" + re.sub(rb"\xff([\xd0-\xd7])", lambda marker: padding * b"\xff" + marker[0], scan)
    whole = read_or_refuse(content, tmp_path)
    assert whole is not None and whole.shape == levels.shape
    assert np.array_equal(read_or_refuse(padded, tmp_path), whole)
    assert read_or_refuse(padded[: int(kept * len(padded))], tmp_path) is None


def test_images_are_read_while_another_thread_prints(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    for suffix in WHOLE:
        (tmp_path / f"image{suffix}").write_bytes(WHOLE[suffix])
    written: list[str] = []
    is_over = threading.Event()

    def print_lines() -> None:
        while not is_over.wait(0.0002):
            written.append(f"Premature end of line {len(written)}\n")
            os.write(2, written[-1].encode())

    printer = threading.Thread(target=print_lines)
    printer.start()
    try:
        while len(written) < 50:
            for suffix in WHOLE:
                read_image(tmp_path / f"image{suffix}")
    finally:
        is_over.set()
        printer.join()
    assert capfd.readouterr().err == "".join(written)


def test_images_of_every_accepted_kind_are_bgr(tmp_path: Path) -> None:
    grey = IMAGE[:, :, 1]
    opaque = np.dstack([IMAGE, np.full(grey.shape, 255, np.uint8)])
    accepted = [(IMAGE, IMAGE), (grey, np.dstack([grey] * 3)), (opaque, IMAGE)]
    for stored, expected in accepted:
        assert np.array_equal(read_or_refuse(encoded(stored, ".png"), tmp_path), expected)
    path = tmp_path / "größe 触觉.png"
    path.write_bytes(encoded(IMAGE, ".png"))
    assert np.array_equal(read_image(str(path)), IMAGE)
    jpeg = read_or_refuse(WHOLE[".jpg"], tmp_path)
    assert jpeg is not None and np.abs(jpeg.astype(int) - SMOOTH).mean() < 5


def test_what_cannot_be_measured_is_refused_with_the_reason(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    glass = np.dstack([IMAGE, np.full(IMAGE.shape[:2], 255, np.uint8)])
    glass[5, 6, 3] = 254
    whole = WHOLE[".png"]
    header, rest = whole[16:29], whole[33:]
    huge = (50_000).to_bytes(4) * 2 + header[8:]
    reasons = {
        "16": encoded(IMAGE.astype(np.uint16) * 257, ".png"),
        "transparent": encoded(glass, ".png"),
        "empty": b"",
        "something else than PNG, JPEG or BMP": encoded(IMAGE, ".tiff"),
        "cut short": whole[:-1],
        "damaged": whole[:60] + b"?" + whole[61:],
        "an animation": whole[:33] + png_chunk(b"acTL", b"\0\0\0\1" + b"\0" * 4) + rest,
        "50000 x 50000 pixels": whole[:8] + png_chunk(b"IHDR", huge) + rest,
    }
    for reason, content in reasons.items():
        path = tmp_path / "image.png"
        path.write_bytes(content)
        with pytest.raises(FileFormatError, match=f"expected .*, got .*{reason}.*; "):
            read_image(path)
    huge_file = tmp_path / "huge.png"
    huge_file.touch()
    os.truncate(huge_file, 500_000_001)
    for path, reason in (
        (tmp_path, "folder"),
        (tmp_path / "none.png", "no such file"),
        (Path("/dev/zero"), "device"),
        (huge_file, "huge file"),
    ):
        with pytest.raises(FileFormatError, match=reason):
            read_image(path)
    printed = capfd.readouterr()
    assert printed.err == "" and printed.out == ""


def test_an_average_is_rounded_and_refuses_mixed_sizes() -> None:
    levels = [np.full((2, 3, 3), level, np.uint8) for level in (255, 254, 254)]
    assert np.all(average_images(levels) == 254)
    assert np.all(average_images(levels[:2]) == 255)
    assert np.array_equal(average_images([IMAGE]), IMAGE)
    with pytest.raises(FileFormatError, match="image 2 of 2 to be 3 x 2 pixels, got 32 x 24"):
        average_images([levels[0], IMAGE])
    with pytest.raises(FileFormatError, match="got none"):
        average_images([])
    with pytest.raises(FileFormatError, match="the press"):
        require_image_size(IMAGE, rows=480, cols=640, what="the press")


def jpeg_segment(marker: int, body: bytes) -> bytes:
    return bytes((0xFF, marker)) + (len(body) + 2).to_bytes(2) + body


def test_an_image_of_a_hundred_million_pixels_is_the_largest(tmp_path: Path) -> None:
    def of_width(cols: int) -> bytes:
        header = cols.to_bytes(4) + (10_000).to_bytes(4) + bytes((1, 0, 0, 0, 0))
        pixels = zlib.compress(bytes(10_000 * (1 + (cols + 7) // 8)))
        return WHOLE[".png"][:8] + b"".join(
            png_chunk(kind, body) for kind, body in ((b"IHDR", header), (b"IDAT", pixels), (b"IEND", b""))
        )

    (tmp_path / "large.png").write_bytes(of_width(10_001))
    with pytest.raises(FileFormatError, match="got 10001 x 10000 pixels"):
        read_image(tmp_path / "large.png")
    assert read_or_refuse(of_width(1000), tmp_path) is not None


def test_a_bmp_is_as_long_as_it_says_and_only_padded_behind() -> None:
    whole = WHOLE[".bmp"]
    assert image_file_fault(whole) is image_file_fault(whole + b"\0\0") is None
    assert image_file_fault(whole[:-1]) == "a file that is cut short"
    assert image_file_fault(whole + b"\0\1") == "a damaged file"
    assert image_file_fault(whole[:2] + bytes(4) + whole[6:]) is None  # some programs leave the length zero
