"""A camera on the network: MJPEG over HTTP, or RTSP, read by OpenCV's FFmpeg."""

from urllib.parse import urlsplit

import cv2

from ninedtact.capture.chatter import hush_video
from ninedtact.capture.frame_source import CameraLost, CameraNotFound, FrameSource, SourceNotOpen
from ninedtact.capture.opencv_capture import FrameGrabber
from ninedtact.quantities import Frame

SCHEMES = ("http", "https", "rtsp", "rtsps", "rtmp", "tcp", "udp")


class NetworkStream(FrameSource):
    """A video stream by URL. Silence longer than `read_timeout_ms` is `CameraLost`."""

    def __init__(self, url: str, open_timeout_ms: float = 5000.0, read_timeout_ms: float = 2000.0) -> None:
        self.name = without_password(url)
        self._url = url
        self._limits = [
            *(cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, round(open_timeout_ms)),
            *(cv2.CAP_PROP_READ_TIMEOUT_MSEC, round(read_timeout_ms)),
        ]
        self._grabber: FrameGrabber | None = None

    def open(self) -> None:
        """Connect and see one image; raises `CameraNotFound`."""
        if self._grabber is not None:
            return
        hush_video()
        grabber = FrameGrabber(self.name, cv2.VideoCapture(self._url, cv2.CAP_FFMPEG, self._limits))
        if grabber.read() is None:
            grabber.release()
            raise CameraNotFound(
                f"expected a video stream at {self.name}, got none; check the address, and open it in a browser or VLC"
            )
        grabber.next_index = 0
        self._grabber = grabber

    def read(self) -> Frame:
        """Wait for the next image; `CameraLost` when the stream breaks off or falls silent."""
        if self._grabber is None:
            raise SourceNotOpen(self.name)
        frame = self._grabber.read()
        if frame is None:
            raise CameraLost(f"expected an image from {self.name}, got none; check the camera and the network")
        return frame

    def close(self) -> None:
        """Hang up."""
        grabber, self._grabber = self._grabber, None
        if grabber is not None:
            grabber.release()


def without_password(url: str) -> str:
    """The URL as it may be shown and logged."""
    parts = urlsplit(url)
    return parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()
