"""The cameras: a sensor's rectified image, or its heights, as LeRobot expects the images of a camera."""

import time
from abc import abstractmethod
from typing import Any

import cv2
import numpy as np
from lerobot.cameras.camera import Camera
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError
from numpy.typing import NDArray

from lerobot_camera_ninedtact.configuration import (
    NinedtactCameraConfig,
    NinedtactHeightCameraConfig,
    NinedtactRectifiedCameraConfig,
)
from lerobot_camera_ninedtact.sensor_stream import (
    FIRST_READING_S,
    NumberedReading,
    SensorStream,
    connect_stream,
    release_stream,
)
from ninedtact import Reading
from ninedtact.capture.uvc_camera import list_cameras

READ_TIMEOUT_S = 10.0


class _NinedtactCamera(Camera):
    """Images of one sensor's stream. Those of `read` and `async_read` are shared with nobody."""

    def __init__(self, config: NinedtactCameraConfig) -> None:
        super().__init__(config)
        self.config = config
        self._stream: SensorStream | None = None
        self._consumed = -1

    def __str__(self) -> str:
        return f"{type(self).__name__}({self.config.sensor_folder}, {self.config.source})"

    @abstractmethod
    def grey_image(self, reading: Reading) -> NDArray[np.float32]:
        """Return the grey image of a reading, from 0 to 255."""

    @property
    def is_connected(self) -> bool:
        """Whether the sensor is open."""
        return self._stream is not None

    @staticmethod
    def find_cameras() -> list[dict[str, Any]]:
        """Return the cameras of this computer; which of them carries a gel cannot be told."""
        return [{"name": camera.name, "type": "ninedtact", "id": camera.path} for camera in list_cameras()]

    def connect(self, warmup: bool = True) -> None:
        """Open the sensor, which takes the reference image: nothing may touch the gel. Raises `ConnectionError`.

        warmup: whether to wait for a reading, and to refuse a sensor that delivers none.
        """
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is already connected.")
        self._stream, self._consumed = connect_stream(self.config.sensor_folder, self.config.source, self.fps), -1
        if not warmup:
            return
        try:
            first = self._stream.wait_for(lambda _: True, FIRST_READING_S)
        except (ConnectionError, TimeoutError) as error:
            self.disconnect()
            raise ConnectionError(f"{self} delivers no reading: {error}") from error
        self.height, self.width = self._to_lerobot(first).shape[:2]

    def read(self) -> NDArray[np.uint8]:
        """Return the image of the next reading."""
        before = self._require_stream().newest_number
        return self._image(lambda one: one.number > before, READ_TIMEOUT_S)

    def async_read(self, timeout_ms: float = 200) -> NDArray[np.uint8]:
        """Return the newest image that was not returned before; raises `TimeoutError`."""
        return self._image(lambda one: one.number > self._consumed, timeout_ms / 1e3)

    def read_latest(self, max_age_ms: int = 500) -> NDArray[np.uint8]:
        """Return the newest image at once; raises `TimeoutError` where it is older."""
        latest = self._require_stream().latest
        if latest is None:
            raise RuntimeError(f"{self} has not captured any frames yet.")
        age_ms = (time.monotonic() - latest.arrived_s) * 1e3
        if age_ms > max_age_ms:
            raise TimeoutError(f"expected an image of {self} younger than {max_age_ms} ms, got one of {age_ms:.0f} ms")
        return self._to_lerobot(latest)

    def disconnect(self) -> None:
        """Give the sensor back."""
        stream = self._require_stream()
        self._stream = None
        release_stream(stream)

    def _require_stream(self) -> SensorStream:
        if self._stream is None:
            raise DeviceNotConnectedError(f"{self} is not connected. Run `.connect()` first.")
        return self._stream

    def _image(self, accepts: Any, timeout_s: float) -> NDArray[np.uint8]:
        found = self._require_stream().wait_for(accepts, timeout_s)
        self._consumed = found.number
        return self._to_lerobot(found)

    def _to_lerobot(self, found: NumberedReading) -> NDArray[np.uint8]:
        grey = np.clip(np.rint(self.grey_image(found.reading)), 0, 255).astype(np.uint8)
        size = (self.width or grey.shape[1], self.height or grey.shape[0])
        if size != grey.shape[::-1]:
            grey = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
        return np.repeat(grey[..., None], 3, axis=2)


class NinedtactRectifiedCamera(_NinedtactCamera):
    """The brightness on the skin's own grid, without lens distortion."""

    config: NinedtactRectifiedCameraConfig

    def grey_image(self, reading: Reading) -> NDArray[np.float32]:
        """Return the rectified image."""
        return reading.rectified.grey


class NinedtactHeightCamera(_NinedtactCamera):
    """The height of the skin, linear from black at `lowest_mm` to white at `highest_mm`."""

    config: NinedtactHeightCameraConfig

    def grey_image(self, reading: Reading) -> NDArray[np.float32]:
        """Return the heights in grey levels; what the camera does not see has the grey of the untouched skin."""
        low, high = self.config.lowest_mm, self.config.highest_mm
        height = reading.height
        return ((np.where(height.in_view, height.z_mm, 0.0) - low) * (255 / (high - low))).astype(np.float32)
