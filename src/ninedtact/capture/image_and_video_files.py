"""Images that were named one by one, as a source.

Recordings that any program wrote: a video file, or a folder of images. They are sources like a camera.

Read directly they deliver every image as fast as it is asked for; under `Freshest` they play at `recorded_hz`.
"""

import re
import time
from collections.abc import Sequence
from pathlib import Path
from threading import Lock

import cv2

from ninedtact.capture.chatter import hush_video
from ninedtact.capture.frame_source import CameraNotFound, FrameSource, SourceEnded, SourceNotOpen
from ninedtact.capture.image_file import ImageUnreadable, average_images, read_image, require_image_size
from ninedtact.capture.opencv_capture import FrameGrabber
from ninedtact.quantities import Frame


class ImageList(FrameSource):
    """These images in this order, all of one size, then `SourceEnded`."""

    def __init__(self, images: Sequence[Path], name: str = "images", recorded_hz: float | None = 10.0) -> None:
        self.images = tuple(images)
        self.name = name
        self.recorded_hz = recorded_hz
        self._lock = Lock()
        self._next_index: int | None = None
        self._size: tuple[int, int] | None = None

    def open(self) -> None:
        """Begin with the first."""
        if self._next_index is None:
            self._next_index, self._size = 0, None

    def read(self) -> Frame:
        """The next image; `SourceEnded` after the last, `ImageUnreadable` or `ImageSizeWrong` for a bad one.

        A bad image is told once and counts as read, so that the reader may go on.
        """
        with self._lock:
            index = self._counted()
            path = self.images[index]
            image = read_image(path)
            self._size = self._size or image.shape[:2]
            require_image_size(image, *self._size, str(path))
            return Frame(image, time.monotonic_ns(), index)

    def close(self) -> None:
        """Opening again starts over."""
        with self._lock:
            self._next_index = None

    def _counted(self) -> int:
        if self._next_index is None:
            raise SourceNotOpen(self.name)
        if self._next_index == len(self.images):
            raise SourceEnded(f"expected another image, got the end of {self.name} after {self._next_index}; stop here")
        self._next_index += 1
        return self._next_index - 1


IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp")
RATE_WHERE_UNSAID_HZ = 30.0

__all__ = ["ImageFolder", "VideoFile", "average_images", "read_image"]


class VideoFile(FrameSource):
    """Every image of a video file, then `SourceEnded`. An image's stamp is the time at which it was read."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.name = f"video {path}"
        self._grabber: FrameGrabber | None = None

    def open(self) -> None:
        """Open at the first image; raises `CameraNotFound` or `ImageUnreadable`."""
        if self._grabber is not None:
            return
        if not self.path.is_file():
            raise CameraNotFound(f"expected a video file at {self.path}, got none; check the path")
        hush_video()
        capture = cv2.VideoCapture(str(self.path), cv2.CAP_FFMPEG)
        if not capture.isOpened():
            raise ImageUnreadable(
                f"expected a video in {self.path}, got something else or half a file; record it again"
            )
        rate_hz = capture.get(cv2.CAP_PROP_FPS)
        self.recorded_hz = rate_hz if 0 < rate_hz <= 1000 else RATE_WHERE_UNSAID_HZ
        self._grabber = FrameGrabber(self.name, capture)

    def read(self) -> Frame:
        """The next image; `SourceEnded` after the last."""
        if self._grabber is None:
            raise SourceNotOpen(self.name)
        frame = self._grabber.read()
        if frame is None:
            read = self._grabber.next_index
            raise SourceEnded(f"expected another image, got the end of {self.name} after {read}; stop here")
        return frame

    def close(self) -> None:
        """Close the file; opening it again starts over."""
        grabber, self._grabber = self._grabber, None
        if grabber is not None:
            grabber.release()


class ImageFolder(FrameSource):
    """The images of a folder in the order of their names (2 before 10), all of one size, then `SourceEnded`."""

    def __init__(self, folder: str | Path, recorded_hz: float = 10.0) -> None:
        self.folder = Path(folder)
        self.name = f"folder {folder}"
        self.recorded_hz = recorded_hz
        self._listed: ImageList | None = None

    def open(self) -> None:
        """List the images; raises `CameraNotFound` where there are none."""
        if self._listed is not None:
            return
        images = images_in(self.folder)
        if not images:
            kinds = ", ".join(IMAGE_SUFFIXES)
            raise CameraNotFound(f"expected a folder of images ({kinds}), got none in {self.folder}; check the path")
        listed = ImageList(images, self.name, self.recorded_hz)
        listed.open()
        self._listed = listed

    def read(self) -> Frame:
        """The next image; raises what `ImageList` raises."""
        listed = self._listed
        if listed is None:
            raise SourceNotOpen(self.name)
        return listed.read()

    def close(self) -> None:
        """Forget the list; opening again starts over."""
        listed, self._listed = self._listed, None
        if listed is not None:
            listed.close()


def images_in(folder: Path) -> list[Path]:
    """The image files of a folder, hidden ones left out, numbers in their names in counting order."""
    if not folder.is_dir():
        return []
    images = (path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    return sorted((path for path in images if not path.name.startswith(".")), key=natural_sort_key)


def natural_sort_key(path: Path) -> list[tuple[int, str]]:
    """A sorting key that puts img_2 before img_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", path.name)]
