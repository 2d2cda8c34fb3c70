"""Whether an image file is whole, judged before any decoder sees it.

Decoders differ by version in what they let pass: half an image with a line on standard error, or a crash on a damaged
animation. The structure of a file tells the same on all of them. PNG: https://www.w3.org/TR/png-3/ section 5;
JPEG: ITU-T T.81 annex B.
"""

import zlib
from collections.abc import Iterator

LARGEST_PIXELS = 100_000_000
PNG, JPEG, BMP = b"\x89PNG\r\n\x1a\n", b"\xff\xd8", b"BM"
KNOWN_OTHERS = {
    b"GIF8": "a GIF",
    b"II*\0": "a TIFF",
    b"MM\0*": "a TIFF",
    b"RIFF": "a WebP or a video",
    b"\0\0\0": "a video, HEIC or AVIF",
    b"%PDF": "a PDF",
}
CUT_SHORT = "a file that is cut short"
DAMAGED = "a damaged file"


def fault_of(content: bytes) -> str | None:
    """What is wrong with an image file, as words that follow "got"; None for a whole PNG, JPEG or BMP."""
    if content.startswith(PNG):
        return _png_fault(content)
    if content.startswith(JPEG):
        return _jpeg_fault(content)
    if content.startswith(BMP):
        return _bmp_fault(content)
    kind = next((kind for start, kind in KNOWN_OTHERS.items() if content.startswith(start)), "something else")
    return f"{kind} where PNG, JPEG or BMP is read"


def _png_fault(content: bytes) -> str | None:
    at, last = len(PNG), b""
    while last != b"IEND":
        size, last = int.from_bytes(content[at : at + 4]), content[at + 4 : at + 8]
        body, check = content[at + 4 : at + 8 + size], content[at + 8 + size : at + 12 + size]
        if len(check) < 4:
            return CUT_SHORT
        if zlib.crc32(body) != int.from_bytes(check):
            return DAMAGED
        if last == b"acTL":
            return "an animation"
        if last == b"IHDR" and (fault := _too_large(int.from_bytes(body[4:8]), int.from_bytes(body[8:12]))):
            return fault
        at += 12 + size
    return None


def _jpeg_fault(content: bytes) -> str | None:
    """Walk the marker segments; only an end-of-image marker outside of all segments ends a whole file."""
    for marker, segment in _jpeg_segments(content):
        if marker == 0xD9:
            return None
        is_frame_header = 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC)
        if is_frame_header and (fault := _too_large(int.from_bytes(segment[5:7]), int.from_bytes(segment[3:5]))):
            return fault
    return CUT_SHORT


def _jpeg_segments(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Markers with the bytes that follow them, scan data skipped (in it, 0xFF precedes 0x00 or a restart marker)."""
    at = 2
    while (at := content.find(b"\xff", at)) >= 0 and at + 1 < len(content):
        marker = content[at + 1]
        if marker in (0x00, 0x01, 0xFF) or 0xD0 <= marker <= 0xD7:
            at += 1 if marker == 0xFF else 2
            continue
        size = 0 if marker == 0xD9 else int.from_bytes(content[at + 2 : at + 4])
        yield marker, content[at + 2 : at + 2 + size]
        at += 2 + size


def _bmp_fault(content: bytes) -> str | None:
    size = int.from_bytes(content[2:6], "little")
    if len(content) < max(size, 26):
        return CUT_SHORT
    cols, rows = (int.from_bytes(content[at : at + 4], "little", signed=True) for at in (18, 22))
    return _too_large(abs(cols), abs(rows))


def _too_large(cols: int, rows: int) -> str | None:
    return f"{cols} x {rows} pixels" if cols * rows > LARGEST_PIXELS else None
