"""Source backends for files that any program wrote: a video file, a folder of images, or a list of image files.

Read directly they deliver every image as fast as it is requested; under `LatestFrameSource` they play at `recorded_hz`.
"""

import re
import time
from collections.abc import Sequence
from pathlib import Path
from threading import Lock

from ninedtact.capture.frame_source import (
    AddressedFrameSource,
    CameraNotFound,
    CameraSettings,
    FrameSource,
    SourceEnded,
    SourceIncomplete,
    SourceNotOpen,
)
from ninedtact.capture.strict_image_reading import (
    ImageSizeWrong,
    ImageUnreadable,
    read_image,
    require_image_size,
)
from ninedtact.capture.video_decoding import DecodedVideoImage, MissingImageCounter, VideoFileDecoder
from ninedtact.quantities import Frame

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
_DEFAULT_VIDEO_HZ = 30.0


class VideoDamaged(SourceIncomplete):
    """Raised, once, at the end of a video of which images are missing or damaged; every other image was delivered before."""


class VideoFile(AddressedFrameSource):
    """A frame source of every undamaged image of a video file. The stamp of an image is the time at which it was read."""

    address_help = "a video file"
    is_live = False

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.name = f"video {path}"
        self.damaged = 0
        """Images left out since the file was opened because they are damaged; they count in the indices of the frames."""
        self._decoder: VideoFileDecoder | None = None
        self._size: tuple[int, int] | None = None
        self._next_index = 0
        self._is_over = False

    @classmethod
    def from_address(cls, address: str, settings: CameraSettings) -> "VideoFile | None":
        """Return the video of a file that exists and is no image; camera settings do not apply to it."""
        path = Path(address).expanduser()
        return cls(path) if path.is_file() and path.suffix.lower() not in IMAGE_SUFFIXES else None

    def open(self) -> None:
        """Open the file at its first image; raises `CameraNotFound` or `ImageUnreadable`."""
        if self._decoder is not None:
            return
        if not self.path.is_file():
            raise CameraNotFound(f"expected a video file at {self.path}, got none; check the path")
        decoder = VideoFileDecoder(self.path)
        if not decoder.is_video:
            decoder.close()
            raise ImageUnreadable(
                f"expected a video in {self.path}, got something else or half a file; record it again"
            )
        self.recorded_hz = decoder.rate_hz if 0 < decoder.rate_hz <= 1000 else _DEFAULT_VIDEO_HZ
        self._timeline = MissingImageCounter(decoder.rate_hz, decoder.announced_images)
        self._next_index, self.damaged, self._is_over, self._size = 0, 0, False, None
        self._next_undelivered = 0
        self._decoder = decoder

    def read(self) -> Frame:
        """Return the next undamaged image; raises `SourceEnded` after the last.

        Raises `VideoDamaged` instead, once, where images are missing or damaged, and `ImageSizeWrong` where their size changes.
        """
        decoder = self._decoder
        if decoder is None:
            raise SourceNotOpen(self.name)
        while not self._is_over and (decoded := decoder.read()) is not None:
            self._timeline.add(decoded.position_ms)
            self._require_same_size(decoded)
            self._next_index += 1
            if not decoded.is_damaged:
                self._next_undelivered = self._next_index
                return Frame(decoded.image, time.monotonic_ns(), self._next_index - 1)
            self.damaged += 1
        if self._decoder is None:
            raise SourceNotOpen(self.name)
        if not self._is_over:
            self._is_over = True
            self._require_all_images(decoder)
        raise _ended(self.name, self._next_index - self.damaged)

    def _require_same_size(self, decoded: DecodedVideoImage) -> None:
        """Raise `ImageSizeWrong` and end the video where an image was stored in another size than those before."""
        got_rows, got_cols = decoded.stored_size or decoded.image.shape[:2]
        self._size = self._size or (got_rows, got_cols)
        rows, cols = self._size
        if (got_rows, got_cols) != self._size:
            self._is_over = True
            raise ImageSizeWrong(
                f"expected all images of {self.path} to be {cols} x {rows} pixels, got {got_cols} x {got_rows} after "
                f"{self._next_index} images; use what was read before, or record it again at one size"
            )

    def _require_all_images(self, decoder: VideoFileDecoder) -> None:
        """Raise `VideoDamaged` where images are missing or damaged."""
        missing = max(decoder.undecoded or 0, self._timeline.missing_count())
        lost = self.damaged + missing
        if decoder.undecoded is None:
            trouble = "the decoder failed"
        elif lost:
            trouble = f"{_count(lost)} missing or damaged"
        else:
            return
        whole = _count(self._next_index - self.damaged)
        raise VideoDamaged(
            f"expected every image of {self.path}, got a file that is cut or damaged: {whole} whole, {trouble}; use what was "
            "read, or record it again",
            uncounted=missing + self._next_index - self._next_undelivered,
        )

    def close(self) -> None:
        """Close the file; opening it again starts from the first image."""
        decoder, self._decoder = self._decoder, None
        if decoder is not None:
            decoder.close()


class ImageFileList(FrameSource):
    """A frame source of the given image files in this order, all of one size."""

    is_live = False

    def __init__(self, images: Sequence[Path], name: str = "images", recorded_hz: float | None = 10.0) -> None:
        self.images = tuple(images)
        self.name = name
        self.recorded_hz = recorded_hz
        self._lock = Lock()
        self._next_index: int | None = None
        self._size: tuple[int, int] | None = None

    def open(self) -> None:
        """Start with the first image."""
        if self._next_index is None:
            self._next_index, self._size = 0, None

    def read(self) -> Frame:
        """Return the next image; raises `SourceEnded`, or `ImageUnreadable` or `ImageSizeWrong` for a bad file.

        A bad image is reported once and counts as read, so that the next call continues after it.
        """
        with self._lock:
            if self._next_index is None:
                raise SourceNotOpen(self.name)
            index = self._next_index
            if index == len(self.images):
                raise _ended(self.name, index)
            self._next_index += 1
            path = self.images[index]
            image = read_image(path)
            self._size = self._size or image.shape[:2]
            require_image_size(image, *self._size, str(path))
            return Frame(image, time.monotonic_ns(), index)

    def close(self) -> None:
        """Close the list; opening it again starts from the first image."""
        with self._lock:
            self._next_index = None


class ImageFolder(ImageFileList, AddressedFrameSource):
    """A frame source of the images of a folder in the order of their names (2 before 10), all of one size."""

    address_help = "a folder of images"
    is_live = False

    def __init__(self, folder: str | Path, recorded_hz: float = 10.0) -> None:
        super().__init__((), f"folder {folder}", recorded_hz)
        self.folder = Path(folder)

    @classmethod
    def from_address(cls, address: str, settings: CameraSettings) -> "ImageFolder | None":
        """Return the source of a folder that exists; camera settings do not apply to it."""
        folder = Path(address).expanduser()
        return cls(folder) if address and folder.is_dir() else None

    def open(self) -> None:
        """List the images, anew at every opening; raises `CameraNotFound` where there are none."""
        if self._next_index is not None:
            return
        self.images = tuple(_list_images(self.folder))
        if not self.images:
            kinds = ", ".join(IMAGE_SUFFIXES)
            raise CameraNotFound(f"expected a folder of images ({kinds}), got none in {self.folder}; check the path")
        super().open()


def _list_images(folder: Path) -> list[Path]:
    """Return the image files of a folder without hidden ones, numbers in their names in counting order."""
    if not folder.is_dir():
        return []
    images = (path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    return sorted((path for path in images if not path.name.startswith(".")), key=natural_sort_key)


def natural_sort_key(path: Path) -> list[tuple[int, str]]:
    """Return a sorting key that puts img_2 before img_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]


def _count(images: int) -> str:
    return f"{images} {'is' if images == 1 else 'are'}"


def _ended(name: str, count: int) -> SourceEnded:
    return SourceEnded(f"expected another image, got the end of {name} after {count}; stop here")
