"""The camera, stream or file that a source address (the text after --source) names, as a source that is not yet open."""

from pathlib import Path

from ninedtact.capture.frame_source import (
    DEFAULT_CAMERA,
    AddressedFrameSource,
    CameraSettings,
    FrameSource,
    ImageFolder,
)
from ninedtact.capture.network_stream import NetworkStream
from ninedtact.capture.raspberry_pi_camera import RaspberryPiCamera
from ninedtact.capture.strict_image_reading import IMAGE_SUFFIXES
from ninedtact.capture.uvc_camera import UvcCamera
from ninedtact.capture.video_file import VideoFile
from ninedtact.errors import InputError

SOURCE_TYPES: tuple[type[AddressedFrameSource], ...] = (
    UvcCamera,
    RaspberryPiCamera,
    NetworkStream,
    ImageFolder,
    VideoFile,
)
"""Every kind of source, in the order in which they are tried with an address. A new camera is one more line here."""


def camera_or_file_source(address: str, settings: CameraSettings = DEFAULT_CAMERA) -> FrameSource:
    """Return the source that the address names, not yet opened.

    `settings` apply to cameras on this machine. Raises `InputError` with the addresses that are accepted.

        with camera_or_file_source("/dev/video0") as camera:
            frame = camera.read()
    """
    for kind in SOURCE_TYPES:
        source = kind.from_address(address, settings)
        if source is not None:
            return source
    path = Path(address).expanduser()
    if path.suffix.lower() in IMAGE_SUFFIXES and path.is_file():
        raise InputError(
            expected="a source of many images", got=f"the single image {address}", remedy="name its folder"
        )
    accepted = ", ".join(kind.address_help for kind in SOURCE_TYPES)
    raise InputError(expected=f"{accepted}", got=f"'{address}', which is none of these", remedy="correct it")
