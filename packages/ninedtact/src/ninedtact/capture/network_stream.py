"""Camera backend for the network: MJPEG over HTTP, or RTSP, decoded by OpenCV's FFmpeg."""

import os
from urllib.parse import urlsplit

import cv2

from ninedtact.capture.frame_source import AddressedFrameSource, CameraLost, CameraSettings, SourceNotOpen
from ninedtact.capture.shared_video_capture import ThreadSafeVideoCapture, silence_video_libraries
from ninedtact.errors import CameraError, InputError
from ninedtact.quantities import Frame

_FFMPEG_OPTIONS = "rtsp_transport;tcp|max_redirects;0"
"""OpenCV's own choice of transport, and no redirects: a camera could send its reader to another service of this computer."""
_SCHEMES = ("http", "https", "rtsp", "rtsps", "rtmp", "tcp", "udp")


class NetworkStream(AddressedFrameSource):
    """A frame source of a video stream by URL. Silence longer than `read_timeout_ms` raises `CameraLost`."""

    address_help = "a stream (http://…, rtsp://…)"

    def __init__(self, url: str, open_timeout_ms: float = 5000.0, read_timeout_ms: float = 2000.0) -> None:
        self.name = _url_without_password(url)
        self._url = url
        self._timeouts = [
            *(cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, round(open_timeout_ms)),
            *(cv2.CAP_PROP_READ_TIMEOUT_MSEC, round(read_timeout_ms)),
        ]
        self._grabber: ThreadSafeVideoCapture | None = None

    @classmethod
    def from_address(cls, address: str, settings: CameraSettings) -> "NetworkStream | None":
        """Return the stream of a URL, to which camera settings do not apply; raises `InputError` for another scheme."""
        if "://" not in address:
            return None
        scheme = address.partition("://")[0]
        if scheme.lower() not in _SCHEMES:
            raise InputError(expected=f"one of {', '.join(_SCHEMES)} before ://", got=f"{scheme}", remedy="correct it")
        try:
            urlsplit(address)
        except ValueError as fault:
            raise InputError(
                expected="an address of a stream",
                got=f"one that cannot be read ({fault})",
                remedy="write it as in a browser",
            ) from fault
        return cls(address)

    def open(self) -> None:
        """Connect and read one image; raises `CameraError`."""
        if self._grabber is not None:
            return
        silence_video_libraries()
        os.environ.setdefault("OPENCV_FFMPEG_CAPTURE_OPTIONS", _FFMPEG_OPTIONS)
        grabber = ThreadSafeVideoCapture(self.name, cv2.VideoCapture(self._url, cv2.CAP_FFMPEG, self._timeouts))
        if grabber.read() is None:
            grabber.release()
            raise CameraError(
                expected=f"a video stream at {self.name}",
                got="none",
                remedy="check the address in a browser or VLC; where it redirects to another one, give that",
            )
        grabber.next_index = 0
        self._grabber = grabber

    def read(self) -> Frame:
        """Wait for the next image; raises `CameraLost` when the stream breaks off or falls silent."""
        if self._grabber is None:
            raise SourceNotOpen(self.name)
        frame = self._grabber.read()
        if frame is None:
            raise CameraLost(
                expected=f"an image from {self.name}", got="none", remedy="check the camera and the network"
            )
        return frame

    def close(self) -> None:
        """Close the connection to the camera."""
        grabber, self._grabber = self._grabber, None
        if grabber is not None:
            grabber.release()


def _url_without_password(url: str) -> str:
    parts = urlsplit(url)
    return parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()
