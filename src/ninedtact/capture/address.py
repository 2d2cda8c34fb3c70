"""What a person writes after --source, turned into the member of the family that it names."""

import re
from pathlib import Path

from ninedtact.capture.camera import Camera
from ninedtact.capture.files import IMAGE_SUFFIXES, ImageFolder, VideoFile
from ninedtact.capture.raspberry_pi import RaspberryPi
from ninedtact.capture.settings import AS_SENSOR, CameraSettings
from ninedtact.capture.source import FrameSource
from ninedtact.capture.stream import SCHEMES, Stream, without_password
from ninedtact.errors import NinedtactError

ACCEPTED = (
    "a camera (0, /dev/video0, csi:0 on a Raspberry Pi), a stream (http://…, rtsp://…), a video file or a folder of "
    "images"
)


class SourceUnknown(NinedtactError):
    """Text that names no source."""


def source_for(text: str, settings: CameraSettings = AS_SENSOR) -> FrameSource:
    """The source that `text` names, not yet opened; `settings` are for cameras on this machine.

    Raises `SourceUnknown`, which says what is accepted.
    """
    if text.isdecimal():
        return Camera(int(text), settings)
    if csi := re.fullmatch(r"csi(?::(\d+))?", text):
        return RaspberryPi(int(csi[1] or 0), settings)
    if "://" in text:
        return stream_for(text)
    if text.startswith("/dev/"):
        return Camera(text, settings)
    return recording_for(text)


def stream_for(url: str) -> Stream:
    """A stream of a kind that FFmpeg plays; raises `SourceUnknown`."""
    scheme = url.partition("://")[0].lower()
    if scheme not in SCHEMES:
        raise SourceUnknown(f"expected one of {', '.join(SCHEMES)} before ://, got {without_password(url)}; correct it")
    return Stream(url)


def recording_for(text: str) -> FrameSource:
    """A folder of images or a video file that exists; raises `SourceUnknown`."""
    path = Path(text).expanduser()
    if text and path.is_dir():
        return ImageFolder(path)
    if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file():
        raise SourceUnknown(f"expected a source of many images, got the single image {text}; name its folder")
    if path.is_file():
        return VideoFile(path)
    raise SourceUnknown(f"expected {ACCEPTED}, got '{text}', which is none of these; correct it")
