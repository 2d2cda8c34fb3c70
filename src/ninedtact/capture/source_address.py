"""What a person writes after --source, turned into the member of the family that it names."""

import re
from pathlib import Path

from ninedtact.capture.frame_source import DEFAULT_CAMERA, CameraSettings, FrameSource
from ninedtact.capture.image_and_video_files import IMAGE_SUFFIXES, ImageFolder, VideoFile
from ninedtact.capture.network_stream import SCHEMES, NetworkStream, without_password
from ninedtact.capture.raspberry_pi_camera import RaspberryPiCamera
from ninedtact.capture.uvc_camera import UvcCamera
from ninedtact.errors import NinedtactError

ACCEPTED = (
    "a camera (0, /dev/video0, csi:0 on a Raspberry Pi), a stream (http://…, rtsp://…), a video file or a folder of "
    "images"
)


class SourceUnknown(NinedtactError):
    """Text that names no source."""


def source_for(text: str, settings: CameraSettings = DEFAULT_CAMERA) -> FrameSource:
    """The source that `text` names, not yet opened; `settings` are for cameras on this machine.

    Raises `SourceUnknown`, which says what is accepted.
    """
    if text.isdecimal():
        return UvcCamera(int(text), settings)
    if csi := re.fullmatch(r"csi(?::(\d+))?", text):
        return RaspberryPiCamera(int(csi[1] or 0), settings)
    if "://" in text:
        return stream_for(text)
    if text.startswith("/dev/"):
        return UvcCamera(text, settings)
    return recording_for(text)


def stream_for(url: str) -> NetworkStream:
    """A stream of a kind that FFmpeg plays; raises `SourceUnknown`."""
    scheme = url.partition("://")[0].lower()
    if scheme not in SCHEMES:
        raise SourceUnknown(f"expected one of {', '.join(SCHEMES)} before ://, got {without_password(url)}; correct it")
    return NetworkStream(url)


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
