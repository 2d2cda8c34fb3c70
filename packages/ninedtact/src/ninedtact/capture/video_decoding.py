"""Decodes a video file in a process of its own, whose error output tells which images are damaged.

OpenCV delivers a damaged video without an error: it leaves out images that cannot be decoded, fills damaged areas of others with
guesses, and scales an image of another size. Three things reveal this. FFmpeg prints a message for damaged data; the process of its
own keeps these messages apart from those of the program. The stored images (packets) are read beside the decoded ones, and their
number and sizes are compared. Positions in time and the duration in the file's header show what the file lacks. Damage that leaves
a video decodable is found in the decoded images, as steps along the borders of blocks that no optical image has.

`VideoFileDecoder` starts `python -m ninedtact.capture.video_decoding FILE` and reads its standard output: a `_HEADER`, then for
every image an `_IMAGE` and its pixels (BGR), then an `_IMAGE` without pixels.
"""

import os
import struct
import subprocess
import sys
import tempfile
from pathlib import Path
from threading import Lock
from typing import BinaryIO, NamedTuple

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

_HEADER = struct.Struct("<dd")
"""Images per second and number of images, as the file states them; not positive where it states none."""
_IMAGE = struct.Struct("<?dIIII")
"""Whether the image is damaged, its time in ms, its rows and columns, and those of the stored image (0 where unknown). After the
last image all are zero but the third number, which counts the stored images that could not be decoded."""
_HARMLESS = ("overread", "APP fields", "EOI missing")
"""Parts of messages that FFmpeg prints about healthy images of common USB cameras."""
_PREDICTED = (ord("P"), ord("B"))
"""Types of images that are predicted from others."""
_FFV1 = int.from_bytes(b"ffv1", "little")
"""Four-letter code of the codec whose images are not predicted, but whose entropy coder continues from image to image."""
_JPEG = b"\xff\xd8"
_BLOCK_PX = 8
_BESIDE_BORDER_PX = (3, 4, 5)
"""Distances from the border of a block at which the scene itself is compared."""


class DecodedVideoImage(NamedTuple):
    """One image of a video, its time, and whether it is damaged."""

    image: UInt8[Array, "rows cols 3"]
    position_ms: float
    """Time after the first image."""
    is_damaged: bool
    """Whether the decoder reported damage in this image or in one from which it is predicted."""
    stored_size: tuple[int, int] | None
    """Rows and columns as stored, before OpenCV scaled the image; None where only the decoder knows them."""


class VideoFileDecoder:
    """A running decoder of one video file. One thread reads; any thread may close."""

    def __init__(self, path: Path) -> None:
        environment = {name: value for name, value in os.environ.items() if name != "OPENCV_FFMPEG_LOGLEVEL"}
        environment |= {"OPENCV_LOG_LEVEL": "SILENT", "PYTHONPATH": os.pathsep.join(sys.path)}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "ninedtact.capture.video_decoding", str(path)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            start_new_session=True,  # Ctrl-C ends the program, which then closes the decoder
        )
        self._lock = Lock()
        self.undecoded: int | None = None
        """Stored images that could not be decoded, known after the last one; None also where the decoder itself failed."""
        header = self._read_bytes(_HEADER.size)
        self.is_video = header is not None
        """Whether the file could be opened as a video."""
        self.rate_hz, self.announced_images = _HEADER.unpack(header) if header is not None else (0.0, 0.0)

    def read(self) -> DecodedVideoImage | None:
        """Return the next image, in memory of its own; None after the last, or where the decoder was closed or has failed."""
        with self._lock:
            content = self._read_bytes(_IMAGE.size)
            if content is None:
                return None
            damaged, position_ms, rows, cols, stored_rows, stored_cols = _IMAGE.unpack(content)
            if rows == 0:
                self.undecoded = stored_rows
                return None
            pixels = self._read_bytes(rows * cols * 3)
            if pixels is None:
                return None
            image = np.frombuffer(pixels, np.uint8).reshape(rows, cols, 3)
            return DecodedVideoImage(image, position_ms, damaged, (stored_rows, stored_cols) if stored_rows else None)

    def close(self) -> None:
        """End the decoder after a read in progress, which returns None."""
        self._process.kill()
        with self._lock:
            assert self._process.stdout is not None
            self._process.stdout.close()
            self._process.wait()

    def _read_bytes(self, count: int) -> bytearray | None:
        """Return the next bytes of the decoder; None where there are fewer."""
        pipe = self._process.stdout
        if pipe is None or pipe.closed:
            return None
        content = bytearray(count)
        return content if pipe.readinto(content) == count else None  # type: ignore[attr-defined]


class _DecoderMessages:
    """The error output of this process, captured in a file from now on."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the process runs
        os.dup2(self._file.fileno(), 2)
        self._read_until = 0

    def report_damage(self) -> bool:
        """Return whether a message about damage was printed since the last call."""
        end = os.fstat(2).st_size
        text = os.pread(self._file.fileno(), end - self._read_until, self._read_until).decode(errors="replace")
        self._read_until = end
        return any(line.strip() and not any(part in line for part in _HARMLESS) for line in text.splitlines())


def _decode_video(path: str, out: BinaryIO) -> None:
    """Write the header and the images of a video; write nothing where the file is none."""
    import cv2

    messages = _DecoderMessages()
    # One thread, so that a message belongs to the image that was read last.
    images = cv2.VideoCapture(path, cv2.CAP_FFMPEG, [cv2.CAP_PROP_N_THREADS, 1])
    stored = cv2.VideoCapture(path, cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    if not images.isOpened():
        return
    out.write(_HEADER.pack(images.get(cv2.CAP_PROP_FPS), images.get(cv2.CAP_PROP_FRAME_COUNT)))
    messages.report_damage()
    is_damaged, jpegs_are_complete, stored_count, image_count = False, False, 0, 0
    while True:
        delivered, image = images.read()
        packet_delivered, packet = stored.read()
        stored_count += packet_delivered
        if not delivered:
            break
        image_count += 1
        is_lossless = images.get(cv2.CAP_PROP_FOURCC) == _FFV1
        is_predicted = images.get(cv2.CAP_PROP_FRAME_TYPE) in _PREDICTED or (
            is_lossless and not stored.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME)
        )
        size, is_complete, is_whole = _inspect_packet(packet.tobytes() if packet_delivered else b"", image, is_lossless)
        # Some cameras never send the marker that ends a JPEG image; from those that do, an image without it is cut short.
        jpegs_are_complete = is_complete if image_count == 1 else jpegs_are_complete
        is_damaged = (
            messages.report_damage()
            or not is_whole
            or (is_damaged and is_predicted)
            or (jpegs_are_complete and not is_complete)
        )
        out.write(_IMAGE.pack(is_damaged, images.get(cv2.CAP_PROP_POS_MSEC), *image.shape[:2], *size))
        out.write(np.ascontiguousarray(image).data)
    while packet_delivered and stored.grab():
        stored_count += 1
    out.write(_IMAGE.pack(False, 0.0, 0, 0, max(stored_count - image_count, 0), 0))
    out.flush()


def _inspect_packet(
    packet: bytes, image: UInt8[Array, "rows cols 3"], is_lossless: bool
) -> tuple[tuple[int, int], bool, bool]:
    """Return rows and columns of a stored JPEG image, whether it is complete, and whether the blocks of any image fit together.

    Rows and columns are zero for other formats, which count as complete.
    """
    import cv2

    from ninedtact.capture.strict_image_reading import has_shifted_blocks, image_file_fault, jpeg_size

    if is_lossless:
        return (0, 0), True, True
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8)
    if not packet.startswith(_JPEG):
        return (0, 0), True, not (_has_odd_blocks(grey) or _has_odd_blocks(np.ascontiguousarray(grey.T)))
    return jpeg_size(packet) or (0, 0), image_file_fault(packet) is None, not has_shifted_blocks(packet, grey)


def _has_odd_blocks(grey: UInt8[Array, "rows cols"]) -> bool:
    """Return whether a block differs from the one above by far more than other blocks do, and the scene beside the border does."""
    from ninedtact.capture.strict_image_reading import brightness_steps_at_rows

    rows, cols = grey.shape
    borders = np.arange(_BLOCK_PX, rows - 1 - max(_BESIDE_BORDER_PX), _BLOCK_PX)
    if not borders.size or cols < _BLOCK_PX:
        return False
    inside = grey[:, : cols - cols % _BLOCK_PX]
    at_border, *beside = (
        np.abs(brightness_steps_at_rows(inside, borders + px).reshape(len(borders), -1, _BLOCK_PX).mean(2))
        for px in (0, *_BESIDE_BORDER_PX)
    )
    usual = max(5 * float(np.quantile(at_border, 0.9)), 2 * float(np.max(beside)))
    return float(at_border.max()) > usual + 4


class MissingImageCounter:
    """The times of the images of a video, from which follows how many are missing."""

    def __init__(self, rate_hz: float, announced_images: float) -> None:
        """rate_hz, announced_images: as the header of the file states them; not positive where it states none."""
        self._announced_ms = 1000 * announced_images / rate_hz if rate_hz > 0 and announced_images > 0 else 0.0
        self._usual_ms = 1000 / rate_hz if rate_hz > 0 else 0.0
        self._positions_ms: list[float] = []

    def add(self, position_ms: float) -> None:
        """Add the time of an image, damaged or not."""
        self._positions_ms.append(position_ms)

    def missing_count(self) -> int:
        """Return how many images are missing between the first and the announced end.

        Gaps count only in a video of constant rate; a camera that slows down in the dark leaves gaps of its own.
        """
        steps_ms = np.diff(self._positions_ms)
        period_ms = float(np.median(steps_ms)) if len(steps_ms) else self._usual_ms
        if period_ms <= 0:
            return 0
        is_constant = np.mean(np.abs(steps_ms - period_ms) < 0.25 * period_ms) > 0.9 if len(steps_ms) else True
        gaps = sum(round(step / period_ms) - 1 for step in steps_ms if is_constant and step > 1.5 * period_ms)
        reached_ms = self._positions_ms[-1] + period_ms if self._positions_ms else 0.0
        early_ms = self._announced_ms - reached_ms
        tolerance_ms = 0.5 * period_ms if is_constant else max(1.5 * period_ms, 500.0)
        return gaps + (round(early_ms / period_ms) if early_ms > tolerance_ms else 0)


if __name__ == "__main__":
    _decode_video(sys.argv[1], sys.stdout.buffer)
