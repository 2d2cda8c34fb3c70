"""Source backends for files that any program wrote: a video file, a folder of images, or a list of image files.

Read directly they deliver every image as fast as it is requested; under `LatestFrameSource` they play at `recorded_hz`.
"""

import re
import time
from collections.abc import Sequence
from pathlib import Path
from threading import Lock

import cv2

from ninedtact.capture.frame_source import (
    CameraBackend,
    CameraNotFound,
    CameraSettings,
    FrameSource,
    SourceEnded,
    SourceNotOpen,
)
from ninedtact.capture.opencv_capture import FrameGrabber, silence_video_libraries
from ninedtact.capture.strict_image_reading import ImageUnreadable, read_image, require_image_size
from ninedtact.quantities import Frame

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
_DEFAULT_VIDEO_HZ = 30.0


class VideoFile(CameraBackend):
    """A frame source of every image of a video file. The stamp of an image is the time at which it was read."""

    address_help = "a video file"
    is_live = False

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.name = f"video {path}"
        self._grabber: FrameGrabber | None = None

    @classmethod
    def from_address(cls, address: str, settings: CameraSettings) -> "VideoFile | None":
        """Return the video of a file that exists and is no image; camera settings do not apply to it."""
        path = Path(address).expanduser()
        return cls(path) if path.is_file() and path.suffix.lower() not in IMAGE_SUFFIXES else None

    def open(self) -> None:
        """Open the file at its first image; raises `CameraNotFound` or `ImageUnreadable`."""
        if self._grabber is not None:
            return
        if not self.path.is_file():
            raise CameraNotFound(f"expected a video file at {self.path}, got none; check the path")
        silence_video_libraries()
        capture = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        if not capture.isOpened():
            raise ImageUnreadable(
                f"expected a video in {self.path}, got something else or half a file; record it again"
            )
        rate_hz = capture.get(cv2.CAP_PROP_FPS)
        self.recorded_hz = rate_hz if 0 < rate_hz <= 1000 else _DEFAULT_VIDEO_HZ
        self._grabber = FrameGrabber(self.name, capture)

    def read(self) -> Frame:
        """Return the next image; raises `SourceEnded` after the last."""
        if self._grabber is None:
            raise SourceNotOpen(self.name)
        frame = self._grabber.read()
        if frame is None:
            raise _ended(self.name, self._grabber.next_index)
        return frame

    def close(self) -> None:
        """Close the file; opening it again starts from the first image."""
        grabber, self._grabber = self._grabber, None
        if grabber is not None:
            grabber.release()


class ImageList(FrameSource):
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


class ImageFolder(ImageList, CameraBackend):
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


def _ended(name: str, count: int) -> SourceEnded:
    return SourceEnded(f"expected another image, got the end of {name} after {count}; stop here")
