"""A video file as a source of frames. Read directly it delivers every image as fast as it is requested; under `LivePlayback`
it plays at its own times.

OpenCV delivers a damaged video without an error: it leaves out images that cannot be decoded and scales those of another size. So
the stored images (packets) are read beside the decoded ones: their number and their sizes are compared, and those that have a mark
of completeness are checked: the end marker of a JPEG image, the checksums of FFV1. The times of the images and the duration in the
header show what the file lacks. Damage within an image of another format (MPEG-4, H.264) is not found unless the decoder gives up.
"""

import os
import time
import zlib
from collections.abc import Sequence
from pathlib import Path
from shlex import quote
from threading import Lock
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from ninedtact.capture.frame_source import (
    AddressedFrameSource,
    CameraSettings,
    SourceIncomplete,
    SourceNotOpen,
    source_ended,
)
from ninedtact.capture.shared_video_capture import silence_video_libraries
from ninedtact.capture.strict_image_reading import IMAGE_SUFFIXES, has_jpeg_end, jpeg_size
from ninedtact.errors import CameraError, FileFormatError
from ninedtact.quantities import Frame

_DEFAULT_VIDEO_HZ = 30.0
_TIMED_IMAGES = 60
"""Number of images at the beginning of a video whose times show its rate; the header of a stream that was saved states any rate."""
_RATE_TOLERANCE = 0.05
_CODEC_NAMES = {
    "av01": "AV1",
    "hev1": "H.265 (HEVC)",
    "hvc1": "H.265 (HEVC)",
    "hevc": "H.265 (HEVC)",
    "vvc1": "H.266 (VVC)",
}
_JPEG = b"\xff\xd8"
_FFV1 = int.from_bytes(b"ffv1", "little")
"""Four-letter code of the codec whose images carry checksums, and whose entropy coder continues from image to image."""
_FFV1_FOOTER = 8
"""Bytes after each slice of an FFV1 image: its size (3), an error status (1) and a checksum (4) (RFC 9043, section 4.9)."""
_REVERSED_BITS = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


class VideoFile(AddressedFrameSource):
    """A frame source of every undamaged image of a video file.

    The stamps of the images are as far apart as their times in the file, and the file ends when it is opened.
    """

    address_help = "a video file"
    is_live = False

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.name = f"video {path}"
        self.damaged = 0
        """Images left out since the file was opened because they are damaged; they count in the indices of the frames."""
        self._lock = Lock()
        self._images: cv2.VideoCapture | None = None

    @classmethod
    def from_address(cls, address: str, settings: CameraSettings) -> "VideoFile | None":
        """Return the video of a file that exists and is no image; camera settings do not apply to it."""
        path = Path(address).expanduser()
        return cls(path) if path.is_file() and path.suffix.lower() not in IMAGE_SUFFIXES else None

    def open(self) -> None:
        """Open the file at its first image; raises `CameraError` or `FileFormatError`."""
        with self._lock:
            if self._images is not None:
                return
            if not self.path.is_file():
                raise CameraError(expected=f"a video file at {self.path}", got="none", remedy="check the path")
            silence_video_libraries()
            images = self._capture()
            if not images.isOpened():
                raise FileFormatError(
                    expected=f"a video in {self.path}", got="something else or half a file", remedy="record it again"
                )
            self._packets = self._capture(cv2.CAP_PROP_FORMAT, -1)  # its images as they are stored
            self._rate_hz, self._announced = images.get(cv2.CAP_PROP_FPS), images.get(cv2.CAP_PROP_FRAME_COUNT)
            self.recorded_hz = self._measure_rate_hz()
            self._began_ns = time.monotonic_ns() - round(1e9 * max(self._announced, 0.0) / (self._rate_hz or 1.0))
            self._first: tuple[bool, Any] | None = images.read()
            if self._first is not None and not self._first[0] and self._packets.grab():
                raise self._undecodable(images)
            self._positions_ms: list[float] = []
            self._size: tuple[int, int] | None = None
            self._has_marks = self._was_damaged = self._is_over = False
            self.damaged, self._next_undelivered = 0, 0
            self._images = images

    def read(self) -> Frame:
        """Return the next undamaged image; raises `SourceEnded` after the last.

        Raises `SourceIncomplete` instead, once, where images are missing or damaged, and `FileFormatError` where their size
        changes.
        """
        with self._lock:
            if self._images is None:
                raise SourceNotOpen(self.name)
            while not self._is_over:
                (delivered, image), self._first = self._first or self._images.read(), None
                if not delivered:
                    self._is_over = True
                    self._require_all_images()
                    break
                packet_delivered, packet = self._packets.read()
                is_damaged = self._is_damaged(packet.tobytes() if packet_delivered else b"", image, self._images)
                self._positions_ms.append(self._next_position_ms(self._images.get(cv2.CAP_PROP_POS_MSEC)))
                if not is_damaged:
                    self._next_undelivered = len(self._positions_ms)
                    stamp_ns = self._began_ns + round(1e6 * self._positions_ms[-1])
                    return Frame(np.asarray(image, np.uint8), stamp_ns, self._next_undelivered - 1)
                self.damaged += 1
            raise source_ended(self.name, len(self._positions_ms) - self.damaged)

    def close(self) -> None:
        """Close the file; opening it again starts from the first image."""
        with self._lock:
            if self._images is not None:
                self._images.release()
                self._packets.release()
            self._images = None

    def _capture(self, *settings: int) -> cv2.VideoCapture:
        """Return OpenCV's reader of the file, which ends the process at a text that is not Unicode, as names of files may be."""
        return cv2.VideoCapture(os.fsencode(self.path), cv2.CAP_FFMPEG, settings)  # type: ignore[call-overload]

    def _measure_rate_hz(self) -> float:
        """Return the rate that the header states where the times of the first images confirm it, otherwise theirs."""
        packets, positions_ms = self._capture(cv2.CAP_PROP_FORMAT, -1), list[float]()
        while len(positions_ms) < _TIMED_IMAGES and packets.grab():
            positions_ms.append(packets.get(cv2.CAP_PROP_POS_MSEC))
        packets.release()
        period_ms = float(np.median(np.diff(np.sort(positions_ms)))) if len(positions_ms) > 1 else 0.0
        if period_ms <= 0:
            return self._rate_hz if 0 < self._rate_hz <= 1000 else _DEFAULT_VIDEO_HZ
        return self._rate_hz if abs(self._rate_hz * period_ms / 1000 - 1) < _RATE_TOLERANCE else 1000 / period_ms

    def _next_position_ms(self, stated_ms: float) -> float:
        """Return the time of an image in the file; one period after the last where it states none, as raw H.264."""
        if not self._positions_ms or stated_ms > self._positions_ms[-1]:
            return stated_ms
        assert self.recorded_hz is not None
        return self._positions_ms[-1] + 1000 / self.recorded_hz

    def _undecodable(self, images: cv2.VideoCapture) -> FileFormatError:
        """Return the error for a video of which no image can be decoded."""
        code = round(images.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little").decode("ascii", "replace").strip("\0 ")
        images.release()
        self._packets.release()
        return FileFormatError(
            expected=f"a video in {self.path} that OpenCV {cv2.__version__} can decode",
            got=f"the codec {_CODEC_NAMES.get(code.lower(), code)}, for which it has no decoder, or damaged images alone",
            remedy=f"convert it without loss: ffmpeg -i {quote(str(self.path))} -c:v ffv1 video.mkv",
        )

    def _is_damaged(self, packet: bytes, image: UInt8[Array, "rows cols 3"], images: cv2.VideoCapture) -> bool:
        """Return whether a stored image lacks its mark of completeness, or is predicted from one that does.

        Some cameras never send the marker that ends a JPEG image, and old versions of FFV1 have no checksum: the first image of a
        video shows whether the others have one. Raises `FileFormatError` for another size than that of the first image.
        """
        is_first, is_lossless = not self._positions_ms, images.get(cv2.CAP_PROP_FOURCC) == _FFV1
        is_jpeg = packet.startswith(_JPEG)
        self._require_same_size((is_jpeg and jpeg_size(packet)) or image.shape[:2])
        is_marked = (is_jpeg and has_jpeg_end(packet)) or (is_lossless and _has_ffv1_checksums(packet))
        self._has_marks = is_marked if is_first else self._has_marks
        is_predicted = is_lossless and not self._packets.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME)
        self._was_damaged = (self._has_marks and not is_marked) or (self._was_damaged and is_predicted)
        return self._was_damaged

    def _require_same_size(self, size: tuple[int, ...]) -> None:
        """Raise `FileFormatError` and end the video where an image was stored in another size than those before."""
        rows, cols = self._size = self._size or (size[0], size[1])
        if size != (rows, cols):
            self._is_over = True
            raise FileFormatError(
                expected=f"all images of {self.path} to be {cols} x {rows} pixels",
                got=f"{size[1]} x {size[0]} after {len(self._positions_ms)} images",
                remedy="use what was read before, or record it again at one size",
            )

    def _require_all_images(self) -> None:
        count, undecoded = len(self._positions_ms), 0
        while self._packets.grab():
            undecoded += 1
        missing = max(undecoded, count_missing_images(self._positions_ms, self._rate_hz, self._announced))
        lost = self.damaged + missing
        if lost:
            raise SourceIncomplete(
                f"expected every image of {self.path}, got a file that is cut or damaged: {_count(count - self.damaged)} whole, "
                f"{_count(lost)} missing or damaged; use what was read, or record it again",
                uncounted=missing + count - self._next_undelivered,
            )


def count_missing_images(positions_ms: Sequence[float], rate_hz: float, announced_images: float) -> int:
    """Return how many images of a video are missing between the first and the announced end.

    positions_ms: the times of the others, damaged or not. rate_hz, announced_images: as the header of the file states them; not
    positive where it states none. Gaps count only in a video of constant rate; a camera that slows down in the dark leaves gaps of
    its own.
    """
    announced_ms = 1000 * announced_images / rate_hz if rate_hz > 0 and announced_images > 0 else 0.0
    steps_ms = np.diff(positions_ms)
    period_ms = float(np.median(steps_ms)) if len(steps_ms) else 1000 / rate_hz if rate_hz > 0 else 0.0
    if period_ms <= 0:
        return 0
    is_constant = np.mean(np.abs(steps_ms - period_ms) < 0.25 * period_ms) > 0.9 if len(steps_ms) else True
    gaps = sum(round(step / period_ms) - 1 for step in steps_ms if is_constant and step > 1.5 * period_ms)
    reached_ms = positions_ms[-1] + period_ms if len(positions_ms) else 0.0
    early_ms = announced_ms - reached_ms
    tolerance_ms = 0.5 * period_ms if is_constant else max(1.5 * period_ms, 500.0)
    return gaps + (round(early_ms / period_ms) if early_ms > tolerance_ms else 0)


def _has_ffv1_checksums(packet: bytes) -> bool:
    """Return whether every slice of a stored FFV1 image agrees with its checksum, the remainder of which is zero.

    The bits of its polynomial run in the other direction than those of `zlib`, and it starts from zero.
    """
    end = len(packet)
    while end > 0:
        start = end - int.from_bytes(packet[end - _FFV1_FOOTER :][:3]) - _FFV1_FOOTER
        if start < 0 or zlib.crc32(packet[start:end].translate(_REVERSED_BITS), 0xFFFFFFFF) != 0xFFFFFFFF:
            return False
        end = start
    return True


def _count(images: int) -> str:
    return f"{images} {'is' if images == 1 else 'are'}"
