"""Camera backend for the ribbon cable (CSI) of a Raspberry Pi, through picamera2, which only that machine needs."""

import math
import re
import time
from collections.abc import Callable, Iterator
from threading import Lock
from typing import Any

import numpy as np

from ninedtact._version import installation_command
from ninedtact.capture.frame_source import (
    DEFAULT_CAMERA,
    AddressedFrameSource,
    CameraLost,
    CameraSettings,
    SourceNotOpen,
)
from ninedtact.errors import CameraError
from ninedtact.quantities import Frame

_SILENCE_LIMIT_S = 2.0
_IMAGES_TO_SETTLE = 30
_RELATIVE_TOLERANCE = 0.05
_Control = float | int | bool
_CAN_BE_ABSENT = {"AwbEnable", "AfMode"}
"""Controls that a camera without them has off."""
_INSTALL_HINT = (
    "on Raspberry Pi OS run `sudo apt install python3-picamera2` and make the environment with "
    f"`python3 -m venv --system-site-packages`; elsewhere `{installation_command('raspberry-pi')}`"
)


def _open_picamera(number: int) -> Any:
    """Open a camera exclusively; raises `CameraError` without picamera2 or without a camera."""
    try:
        from picamera2 import Picamera2
    except ImportError as absence:
        raise CameraError(
            expected=f"picamera2 for csi:{number}", got="no such package", remedy=f"{_INSTALL_HINT}"
        ) from absence
    try:
        return Picamera2(number)
    except (IndexError, RuntimeError) as trouble:
        raise CameraError(
            f"expected a camera at csi:{number}, got: {trouble}; check the ribbon cable and close other programs"
        ) from trouble


class RaspberryPiCamera(AddressedFrameSource):
    """A CSI camera by its number; settings are given to libcamera and read back from the metadata of the images."""

    address_help = "a Raspberry Pi camera (csi:0)"

    def __init__(
        self,
        number: int = 0,
        settings: CameraSettings = DEFAULT_CAMERA,
        opener: Callable[[int], Any] = _open_picamera,
    ) -> None:
        self.name = f"csi:{number}"
        self.settings = settings
        self._number = number
        self._opener = opener
        self._lock = Lock()
        self._camera: Any = None
        self._next_index = 0

    @classmethod
    def from_address(cls, address: str, settings: CameraSettings) -> "RaspberryPiCamera | None":
        """Return the camera of `csi` or `csi:NUMBER`."""
        found = re.fullmatch(r"csi(?::(\d+))?", address)
        return cls(int(found[1] or 0), settings) if found else None

    def open(self) -> None:
        """Open the camera, apply the settings and read them back; raises `CameraError`."""
        if self._camera is not None:
            return
        camera = self._opener(self._number)
        try:
            self._start(camera)
        except BaseException:
            camera.close()
            raise
        self._camera, self._next_index = camera, 0

    def read(self) -> Frame:
        """Wait for the next image; raises `CameraLost` after two seconds of silence."""
        with self._lock:
            if self._camera is None:
                raise SourceNotOpen(self.name)
            image, _ = self._capture(self._camera)
            self._next_index += 1
            return Frame(image, time.monotonic_ns(), self._next_index - 1)

    def close(self) -> None:
        """Stop and release the camera."""
        with self._lock:
            camera, self._camera = self._camera, None
        if camera is not None:
            camera.close()

    def _start(self, camera: Any) -> None:
        controls = dict(_libcamera_controls(self.settings))
        for name in _CAN_BE_ABSENT - {*camera.camera_controls}:  # a grey sensor, a fixed lens
            if not controls.get(name, True):
                del controls[name]
        if unknown := [name for name in controls if name not in camera.camera_controls]:
            raise CameraError(
                expected=f"{self.name} to take {unknown[0]}", got="no such control", remedy="leave it out"
            )
        # The format "RGB888" of picamera2 lies in memory as blue, green, red. Without a queue an image is never older
        # than the request for it.
        main = {"format": "RGB888", "size": self.settings.size_px or (640, 480)}
        camera.configure(camera.create_video_configuration(main=main, controls=controls, queue=False))
        camera.start()
        self._read_back(camera, controls)

    def _read_back(self, camera: Any, controls: dict[str, _Control]) -> None:
        """Wait for the controls, which libcamera applies a few images late; raises `CameraError`."""
        wanted = {name: controls[name] for name in ("ExposureTime", "AnalogueGain") if name in controls}
        got: dict[str, _Control] = {}
        for _ in range(_IMAGES_TO_SETTLE):
            _, got = self._capture(camera)
            if all(math.isclose(got[name], value, rel_tol=_RELATIVE_TOLERANCE) for name, value in wanted.items()):
                return
        raise CameraError(
            expected=f"{self.name} to take {wanted}",
            got=f"{ {name: got[name] for name in wanted} }",
            remedy="ask for other values",
        )

    def _capture(self, camera: Any) -> tuple[Any, dict[str, Any]]:
        job = camera.capture_arrays(["main"], wait=False)
        try:
            (image,), metadata = job.get_result(timeout=_SILENCE_LIMIT_S)
        except TimeoutError as silence:
            raise CameraLost(
                expected=f"an image from {self.name}", got="none", remedy="check the ribbon cable"
            ) from silence
        return np.array(image, order="C"), metadata


def _libcamera_controls(settings: CameraSettings) -> Iterator[tuple[str, _Control]]:
    """Yield the settings as controls of libcamera; raises `CameraError` for those that it does not have."""
    if any(value is not None for value in (settings.pixel_format, settings.white_balance_k, settings.focus)):
        raise CameraError(
            expected="no pixel_format, no white_balance_k and no focus on a Raspberry Pi",
            got="one",
            remedy="leave it out",
        )
    if settings.rate_hz is not None:
        yield "FrameRate", settings.rate_hz
    if settings.auto_exposure is not None or settings.exposure_ms is not None:
        yield "AeEnable", bool(settings.auto_exposure)
    if settings.exposure_ms is not None:
        yield "ExposureTime", round(settings.exposure_ms * 1000)
    if settings.gain is not None:
        yield "AnalogueGain", settings.gain
    if settings.auto_white_balance is not None:
        yield "AwbEnable", settings.auto_white_balance
    if settings.autofocus is not None:
        yield "AfMode", 2 if settings.autofocus else 0  # continuous, manual
