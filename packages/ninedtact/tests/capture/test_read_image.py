"""Any file at all is either a whole 8-bit BGR image or one clear sentence."""

import os
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ninedtact.capture.strict_image_reading import (
    ImageSizeWrong,
    ImageUnreadable,
    _luminance_blocks,
    average_images,
    brightness_steps_at_rows,
    has_shifted_blocks,
    image_file_fault,
    jpeg_size,
    read_image,
    require_image_size,
)

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
    """The image, or None where it was refused as it should be."""
    path = folder / "image"
    path.write_bytes(content)
    try:
        image = read_image(path)
    except ImageUnreadable as refusal:
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


def test_bytes_inserted_among_the_pixels_are_refused(tmp_path: Path) -> None:
    content = WHOLE[".bmp"]
    assert read_or_refuse(content[:500] + b"inserted" + content[500:], tmp_path) is None


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


@FUZZ
@given(start=st.sampled_from([b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0", b"BM", b"GIF89a"]), rest=st.binary())
def test_random_bytes_are_refused_or_read_as_a_image(tmp_path: Path, start: bytes, rest: bytes) -> None:
    read_or_refuse(start + rest, tmp_path)


def gel_image(rows: int = 240, cols: int = 320) -> np.ndarray:
    """An image as of a gel under LEDs: smooth, with a press and the noise of a camera."""
    y, x = np.mgrid[:rows, :cols]
    press = 60 * np.exp(-((x - 150) ** 2 + (y - 110) ** 2) / 900)
    grey = (
        150 - 0.0004 * ((x - 170) ** 2 + (y - 100) ** 2) - press + np.random.default_rng(1).normal(0, 0.7, (rows, cols))
    )
    return np.clip(grey[..., None] + [0, 12, -9], 0, 255).round().astype(np.uint8)


@pytest.mark.parametrize(("sampling", "quality"), [(0x221111, 95), (0x111111, 90), (0x211111, 75)])
def test_a_flipped_bit_of_a_jpeg_is_refused_where_it_shifts_brightness(
    tmp_path: Path, sampling: int, quality: int
) -> None:
    options = (cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling)
    content = cv2.imencode(".jpg", gel_image(), options)[1].tobytes()
    whole, scan = read_or_refuse(content, tmp_path), content.index(b"\xff\xda") + 14
    assert whole is not None
    shifted, rng = 0, np.random.default_rng(0)
    for at in rng.integers(scan, len(content) - 2, 150):
        damaged = content[:at] + bytes([content[at] ^ 1 << int(rng.integers(8))]) + content[at + 1 :]
        decoded = cv2.imdecode(np.frombuffer(damaged, np.uint8), cv2.IMREAD_GRAYSCALE)
        change = decoded - cv2.cvtColor(whole, cv2.COLOR_BGR2GRAY).astype(np.float32)
        read = read_or_refuse(damaged, tmp_path)
        shifted += read is None
        assert read is None or np.abs(cv2.GaussianBlur(change, (0, 0), 12)).max() < 4, at
    assert shifted > 20


@pytest.mark.parametrize("quality", [30, 60, 90, 100])
def test_no_whole_jpeg_is_taken_for_a_damaged_one(tmp_path: Path, quality: int) -> None:
    edge = gel_image()
    edge[101:] //= 2  # a sharp line across the image, beside the borders of blocks
    noise = np.random.default_rng(2).integers(0, 256, (64, 80, 3), np.uint8)
    for image in (gel_image(), gel_image(50, 70), edge, noise, gel_image()[..., 0], np.full_like(noise, 7)):
        content = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, quality))[1].tobytes()
        assert read_or_refuse(content, tmp_path) is not None


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
        "GIF": b"GIF89a" + b"\0" * 100,
        "TIFF": encoded(IMAGE, ".tiff"),
        "something else": b"<html>404</html>",
        "cut short": whole[:-1],
        "damaged": whole[:60] + b"?" + whole[61:],
        "an animation": whole[:33] + png_chunk(b"acTL", b"\0\0\0\1" + b"\0" * 4) + rest,
        "50000 x 50000 pixels": whole[:8] + png_chunk(b"IHDR", huge) + rest,
    }
    for reason, content in reasons.items():
        path = tmp_path / "image.png"
        path.write_bytes(content)
        with pytest.raises(ImageUnreadable, match=f"expected .*, got .*{reason}.*; "):
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
        with pytest.raises(ImageUnreadable, match=reason):
            read_image(path)
    path = tmp_path / "lost.jpg"  # of which a restart marker is lost, which the decoder only prints
    content = cv2.imencode(".jpg", np.tile(SMOOTH, (2, 2, 1)), [cv2.IMWRITE_JPEG_RST_INTERVAL, 1])[1].tobytes()
    path.write_bytes(content.replace(b"\xff\xd1", b"", 1))
    with pytest.raises(ImageUnreadable, match="got damaged data; record it again"):
        read_image(path)
    printed = capfd.readouterr()
    assert printed.err == "" and printed.out == ""


def test_an_average_is_rounded_and_refuses_mixed_sizes() -> None:
    levels = [np.full((2, 3, 3), level, np.uint8) for level in (255, 254, 254)]
    assert np.all(average_images(levels) == 254)
    assert np.all(average_images(levels[:2]) == 255)
    assert np.array_equal(average_images([IMAGE]), IMAGE)
    with pytest.raises(ImageSizeWrong, match="image 2 of 2 to be 3 x 2 pixels, got 32 x 24"):
        average_images([levels[0], IMAGE])
    with pytest.raises(ImageUnreadable, match="got none"):
        average_images([])
    with pytest.raises(ImageSizeWrong, match="the press"):
        require_image_size(IMAGE, rows=480, cols=640, what="the press")


def test_a_jpeg_tells_its_size_and_its_end_through_restart_markers() -> None:
    done, content = cv2.imencode(".jpg", IMAGE, [cv2.IMWRITE_JPEG_RST_INTERVAL, 1])
    whole = content.tobytes()
    assert done and b"\xff\xd0" in whole and b"\xff\xd7" not in whole[:200]
    assert image_file_fault(whole) is None and jpeg_size(whole) == (24, 32)
    assert image_file_fault(whole[:-2]) == "a file that is cut short" == image_file_fault(whole[: len(whole) // 2])
    assert jpeg_size(whole[: whole.index(b"\xff\xc0") + 9]) == (24, 32)
    assert jpeg_size(whole[: whole.index(b"\xff\xc0")]) is None
    thumbnail = b"\xff\xe1\x00\x0a" + b"\xff\xd9" * 4  # an end of image within a segment is not the file's
    assert image_file_fault(whole[:2] + thumbnail + whole[2:]) is None
    assert image_file_fault(whole[:2] + thumbnail) == "a file that is cut short"


def test_an_image_of_a_hundred_million_pixels_is_the_largest() -> None:
    header = (10_000).to_bytes(4) + (10_000).to_bytes(4) + bytes((8, 2, 0, 0, 0))
    end = png_chunk(b"IEND", b"")
    start = b"\x89PNG\r\n\x1a\n"
    assert image_file_fault(start + png_chunk(b"IHDR", header) + end) is None
    larger = (10_000).to_bytes(4) + (10_001).to_bytes(4) + header[8:]
    assert image_file_fault(start + png_chunk(b"IHDR", larger) + end) == "10000 x 10001 pixels"


def test_a_bmp_is_as_long_as_it_says_and_only_padded_behind() -> None:
    whole = WHOLE[".bmp"]
    assert image_file_fault(whole) is image_file_fault(whole + b"\0\0") is None
    assert image_file_fault(whole[:6] + b"\1\2\3\4" + whole[10:]) is None  # bytes that are a program's own
    assert image_file_fault(whole[:-1]) == "a file that is cut short"
    assert image_file_fault(whole + b"\0\1") == "a damaged file"
    wide = whole[:18] + (20_000).to_bytes(4, "little") + (-20_000).to_bytes(4, "little", signed=True) + whole[26:]
    assert image_file_fault(wide) == "20000 x 20000 pixels"
    unstated = whole[:2] + bytes(4) + whole[6:]  # some programs leave the length zero
    assert image_file_fault(unstated[:26]) is None and image_file_fault(unstated[:25]) == "a file that is cut short"


def jpeg_segment(marker: int, body: bytes) -> bytes:
    return bytes((0xFF, marker)) + (len(body) + 2).to_bytes(2) + body


def frame_header(rows: int, cols: int, *components: tuple[int, int], marker: int = 0xC0) -> bytes:
    """A frame header with sampling factors and quantisation table of each component."""
    parts = b"".join(bytes((number, *component)) for number, component in enumerate(components, start=1))
    return jpeg_segment(marker, b"\x08" + rows.to_bytes(2) + cols.to_bytes(2) + bytes((len(components),)) + parts)


@pytest.mark.parametrize(("sampling", "height"), [(0x111111, 8), (0x211111, 8), (0x121111, 16), (0x221111, 16)])
@pytest.mark.parametrize(("quality", "of_16"), [(20, 40), (50, 16), (75, 8), (90, 3)])
def test_a_jpeg_tells_the_height_of_its_blocks_and_the_quantum_of_their_brightness(
    sampling: int, height: int, quality: int, of_16: int
) -> None:
    """Encoders scale the table of ITU-T T.81, annex K, whose first entry is 16; a mean is an eighth of its coefficient."""
    options = (cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, sampling)
    content = cv2.imencode(".jpg", IMAGE, options)[1].tobytes()
    assert _luminance_blocks(content) == (height, of_16 / 8)


def test_the_first_component_names_the_table_of_its_brightness() -> None:
    """Tables of 8 and of 16 bits follow each other in one segment; a single component has blocks of 8 rows whatever it says."""
    fine, coarse, bytes_64 = b"\x00\x02", b"\x11" + (800).to_bytes(2), bytes(64)
    tables = jpeg_segment(0xDB, fine + bytes_64[1:] + coarse + 2 * bytes_64[1:] + b"\x02\x18" + bytes_64[1:])
    for table, quantum in ((0, 0.25), (1, 100.0), (2, 3.0), (3, 2.0)):
        grey = b"\xff\xd8" + tables + frame_header(48, 64, (0x22, table))
        colour = b"\xff\xd8" + tables + frame_header(48, 64, (0x22, table), (0x11, 0), (0x11, 0))
        assert _luminance_blocks(grey) == (8, quantum) and _luminance_blocks(colour) == (16, quantum)
        assert jpeg_size(grey) == (48, 64)
    only_tables = b"\xff\xd8" + tables
    assert _luminance_blocks(b"\xff\xd8") == (8, 2.0) and _luminance_blocks(only_tables) == (8, 0.25)
    colour += b"\xff\xd9"
    assert _luminance_blocks(colour + only_tables + frame_header(48, 64, (0x11, 1))) == (16, 2.0)  # a preview behind it
    for count in range(len(colour)):  # a header that is cut anywhere has no blocks of another size
        assert _luminance_blocks(colour[:count])[0] in (8, 16)


def test_every_frame_header_and_no_other_segment_has_the_size() -> None:
    """ITU-T T.81, table B.1: C4 defines Huffman tables, C8 is reserved, CC defines arithmetic coding."""
    known = {
        marker for marker in range(0xB0, 0xD0) if jpeg_size(b"\xff\xd8" + frame_header(9, 7, (17, 0), marker=marker))
    }
    assert known == {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
    for in_scan in (0x00, 0x01, *range(0xD0, 0xD8)):  # ITU-T T.81, B.1.1.3: what has no length
        scan = jpeg_segment(0xDA, bytes(10)) + bytes((0xFF, in_scan, 0xFF, 0xD9))
        assert image_file_fault(b"\xff\xd8" + frame_header(9, 7, (17, 0)) + scan) is None
    padded = b"\xff\xd8" + jpeg_segment(0xE0, b"JFIF") + 3 * b"\xff" + frame_header(9, 7, (17, 0)) + b"\xff\xff"
    assert jpeg_size(padded) == (9, 7) and image_file_fault(padded + b"\xd9") is None
    assert image_file_fault(padded) == "a file that is cut short"
    large = b"\xff\xd8" + frame_header(10_000, 10_001, (17, 0)) + b"\xff\xd9"
    assert image_file_fault(large) == "10001 x 10000 pixels"


def test_a_step_of_brightness_is_what_no_curved_scene_makes() -> None:
    rows = np.arange(16)
    for scene in (7 + 0 * rows, 250 - 13 * rows, (rows - 5) ** 2):
        assert not brightness_steps_at_rows(np.repeat(scene[:, None], 3, 1).astype(np.uint8), rows[2:-1]).any()
    darker = np.where(rows < 8, 200, 100).astype(np.uint8)[:, None]
    assert brightness_steps_at_rows(darker, rows[2:-1]).ravel().tolist() == [0] * 5 + [50, -100, 50] + [0] * 5


def shifted_from(block: int, levels: int, rows: int = 48, cols: int = 64) -> np.ndarray:
    """A flat image whose blocks, counted along the rows of blocks, are brighter from one on."""
    return np.full((rows, cols), 90, np.uint8) + np.uint8(levels) * (np.arange(rows * cols // 64) >= block).reshape(
        rows // 8, cols // 8
    ).repeat(8, 0).repeat(8, 1).astype(np.uint8)


@pytest.mark.parametrize("block", [8, 11, 23, 24, 37, 40])
def test_a_shift_counts_beyond_five_quarters_of_a_quantum_and_half_a_level_wherever_it_begins(block: int) -> None:
    header = header_of_quantum(54)  # steps up to 1.25 · 6.75 + 0.5 = 8.94 levels are usual
    assert not has_shifted_blocks(header, shifted_from(block, 8))
    assert has_shifted_blocks(header, shifted_from(block, 9)) and has_shifted_blocks(header, ~shifted_from(block, 9))
    assert has_shifted_blocks(header, shifted_from(2, 9, cols=16))  # also along the first border of a narrow image
    assert not has_shifted_blocks(header_of_quantum(48), shifted_from(block, 8))  # 1.25 · 6 + 0.5 is not beyond
    scene = shifted_from(block, 20)
    scene[block // 8 * 8 + 4 :] += 30  # a line of the scene itself, half a block lower, explains it
    assert not has_shifted_blocks(header, scene)


def header_of_quantum(eighths: int) -> bytes:
    return b"\xff\xd8" + jpeg_segment(0xDB, bytes((0, eighths)) + bytes(63)) + frame_header(48, 64, (17, 0))


@pytest.mark.parametrize("beside_px", [-4, -3, 3, 4])
def test_a_line_of_the_scene_beside_a_border_explains_a_step_of_twice_its_size(beside_px: int) -> None:
    for levels, is_shifted in ((11, False), (12, True)):  # of 2 · 5 + 0.31 + 0.5 and 0.6 for what deviates
        scene = shifted_from(24, levels)
        scene[24 + beside_px :] += 5
        assert has_shifted_blocks(header_of_quantum(2), scene) is is_shifted


def test_four_deviations_of_the_mean_of_noise_are_no_shift() -> None:
    """Pixels that alternate by ± 2 levels have steps that alternate by ± 8, of which 64 have a mean within ± 1."""
    noise = np.where(np.add.outer(np.arange(48), np.arange(64)) % 2, 2, -2)
    for levels, is_shifted in ((5, False), (6, True)):  # of 1.25 · 1 + 0.5 + 4 · 1
        assert (
            has_shifted_blocks(header_of_quantum(8), (shifted_from(24, levels) + noise).astype(np.uint8)) is is_shifted
        )


def test_an_image_is_checked_once_four_rows_follow_a_border() -> None:
    header = b"\xff\xd8" + frame_header(14, 64, (17, 0))
    image = shifted_from(8, 100, 16)
    assert has_shifted_blocks(header, image[:14]) and not has_shifted_blocks(header, image[:13])
