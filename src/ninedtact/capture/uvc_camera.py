"""Which cameras this machine has, read from the kernel's own files (Linux).

What a camera is set to: every setting is read back, and refused where the camera did not take it.

The values are those of Video4Linux (https://docs.kernel.org/userspace-api/media/v4l/ext-ctrls-camera.html): exposure in
steps of 0.1 ms, automatic exposure as 0 auto, 1 manual, 2 shutter priority, 3 aperture priority.

A camera on this machine: UVC and everything else that Video4Linux knows, opened through OpenCV.
"""

import getpass
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2

from ninedtact.capture.chatter import hush_video
from ninedtact.capture.frame_source import (
    DEFAULT_CAMERA,
    CameraLost,
    CameraNotFound,
    CameraSettingRefused,
    CameraSettings,
    FrameSource,
    SourceNotOpen,
)
from ninedtact.capture.opencv_capture import FrameGrabber, OpenCvCapture
from ninedtact.quantities import Frame

KERNEL_LIST = Path("/sys/class/video4linux")
QUERY_CAPABILITIES = 0x80685600
"""VIDIOC_QUERYCAP, https://docs.kernel.org/userspace-api/media/v4l/vidioc-querycap.html."""
DEVICE_CAPABILITIES = slice(88, 92)
VIDEO_CAPTURE = 0x00000001 | 0x00001000
"""Single-planar or multi-planar."""


@dataclass(frozen=True)
class CameraDevice:
    """A camera as the kernel lists it."""

    path: str
    name: str


def list_cameras(kernel_list: Path = KERNEL_LIST, device_folder: Path = Path("/dev")) -> list[CameraDevice]:
    """All devices that can deliver images, in the order of their numbers; none where the system is not Linux."""
    nodes = sorted(kernel_list.glob("video*"), key=lambda node: (len(node.name), node.name))
    found = [CameraDevice(str(device_folder / node.name), _name_of(node)) for node in nodes]
    return [device for device in found if _captures(device.path)]


def why_closed(device: int | str) -> str:
    """Why a device does not open, as words that follow "got"."""
    path = Path(f"/dev/video{device}" if isinstance(device, int) else device)
    if not path.exists():
        others = ", ".join(camera.path for camera in list_cameras()) or "no camera at all"
        return f"no device {path}; plug it in (this machine has {others}), or name it with --source"
    if not os.access(path, os.R_OK | os.W_OK):
        return f"no permission for {path}; {permission_remedy()}"
    return f"a refusal from {path}; close the other program that uses it, or name another device"


def permission_remedy() -> str:
    """How a person gets to open cameras."""
    return f"run `sudo usermod -aG video {_user()}` and log in again"


def _name_of(node: Path) -> str:
    try:
        return (node / "name").read_text().strip()
    except OSError:
        return "unnamed"


def _captures(path: str) -> bool:
    """Whether a device delivers images; a UVC camera also lists one that delivers only metadata.

    A device that may not be asked counts as a camera: the user must hear of the missing permission.
    """
    import fcntl  # not on Windows, where no device gets this far

    answer = bytearray(104)
    try:
        handle = os.open(path, os.O_RDWR | os.O_NONBLOCK)
        try:
            fcntl.ioctl(handle, QUERY_CAPABILITIES, answer)
        finally:
            os.close(handle)
    except OSError:
        return True
    return bool(int.from_bytes(answer[DEVICE_CAPABILITIES], "little") & VIDEO_CAPTURE)


def _user() -> str:
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return "$USER"


V4L2_EXPOSURE_PER_MS = 10
MANUAL, AUTOMATIC = (1.0, 2.0), (3.0, 0.0)


@dataclass(frozen=True)
class Wish:
    """One property to set: any of `accepted` will do, the first is tried first."""

    what: str
    prop: int
    accepted: tuple[float, ...]
    tolerance: float = 0.5
    remedy: str = "ask for a value that the camera has (`v4l2-ctl --list-ctrls` shows them), or leave it out"

    def met(self, capture: OpenCvCapture) -> bool:
        """Whether the camera says that it has one of the accepted values."""
        got = capture.get(self.prop)
        return any(math.isclose(got, value, abs_tol=self.tolerance) for value in self.accepted)

    def ask(self, capture: OpenCvCapture) -> None:
        """Set values until one is taken."""
        for value in self.accepted:
            if capture.set(self.prop, value) and self.met(capture):
                return


def apply(settings: CameraSettings, capture: OpenCvCapture, name: str) -> None:
    """Set everything, then read everything back, since one setting may undo another; raises `CameraSettingRefused`."""
    wishes = list(wishes_of(settings))
    for wish in wishes:
        wish.ask(capture)
    for wish in wishes:
        if not wish.met(capture):
            got = capture.get(wish.prop)
            raise CameraSettingRefused(
                f"expected {name} to take {wish.what} {wish.accepted[0]:g}, got {got:g}; {wish.remedy}"
            )


def wishes_of(settings: CameraSettings) -> Iterator[Wish]:
    """The properties to set, in the order in which a driver takes them: format, size, rate, then controls."""
    modes = "ask for one that it has (`v4l2-ctl --list-formats-ext` shows them)"
    if settings.pixel_format is not None:
        fourcc = cv2.VideoWriter.fourcc(*settings.pixel_format)
        yield Wish(f"pixel format {settings.pixel_format}", cv2.CAP_PROP_FOURCC, (float(fourcc),), remedy=modes)
    if settings.size_px is not None:
        yield Wish("image width", cv2.CAP_PROP_FRAME_WIDTH, (float(settings.size_px[0]),), remedy=modes)
        yield Wish("image height", cv2.CAP_PROP_FRAME_HEIGHT, (float(settings.size_px[1]),), remedy=modes)
    if settings.rate_hz is not None:
        tolerance = 0.02 * settings.rate_hz  # 29.97 answers a wish for 30
        yield Wish("images per second", cv2.CAP_PROP_FPS, (settings.rate_hz,), tolerance, modes)
    yield from _controls_of(settings)


def _controls_of(settings: CameraSettings) -> Iterator[Wish]:
    if settings.auto_exposure is not None or settings.exposure_ms is not None:
        accepted = AUTOMATIC if settings.auto_exposure else MANUAL
        yield Wish("exposure mode (1 manual, 3 automatic)", cv2.CAP_PROP_AUTO_EXPOSURE, accepted)
    if settings.exposure_ms is not None:
        steps = float(round(settings.exposure_ms * V4L2_EXPOSURE_PER_MS))
        yield Wish("exposure (in steps of 0.1 ms)", cv2.CAP_PROP_EXPOSURE, (steps,))
    if settings.gain is not None:
        yield Wish("gain", cv2.CAP_PROP_GAIN, (settings.gain,))
    if settings.auto_white_balance is not None or settings.white_balance_k is not None:
        on = 1.0 if settings.auto_white_balance else 0.0
        yield Wish("automatic white balance (0 off, 1 on)", cv2.CAP_PROP_AUTO_WB, (on,))
    if settings.white_balance_k is not None:
        kelvin = settings.white_balance_k
        yield Wish("white balance in kelvin", cv2.CAP_PROP_WB_TEMPERATURE, (kelvin,), 0.01 * kelvin)


def settings_in_force(capture: OpenCvCapture) -> CameraSettings:
    """What the camera says it is set to; None where it does not say (V4L2 then answers −1)."""
    exposure_mode, exposure = _said(capture, cv2.CAP_PROP_AUTO_EXPOSURE), _said(capture, cv2.CAP_PROP_EXPOSURE)
    by_hand = exposure_mode is None or exposure_mode in MANUAL
    auto_wb, kelvin = _said(capture, cv2.CAP_PROP_AUTO_WB), _said(capture, cv2.CAP_PROP_WB_TEMPERATURE)
    return CameraSettings(
        size_px=(int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))),
        rate_hz=_said(capture, cv2.CAP_PROP_FPS),
        pixel_format=_letters(capture.get(cv2.CAP_PROP_FOURCC)),
        auto_exposure=None if exposure_mode is None else not by_hand,
        exposure_ms=exposure / V4L2_EXPOSURE_PER_MS if exposure is not None and by_hand else None,
        gain=_said(capture, cv2.CAP_PROP_GAIN),
        auto_white_balance=None if auto_wb is None else bool(auto_wb),
        white_balance_k=None if auto_wb else kelvin,
    )


def _said(capture: OpenCvCapture, prop: int) -> float | None:
    value = capture.get(prop)
    return None if value < 0 else value


def _letters(fourcc: float) -> str | None:
    if fourcc <= 0:
        return None
    return int(fourcc).to_bytes(4, "little").decode("ascii", errors="replace")


SILENCE_LIMIT_S = 2
DAMAGED_IN_A_ROW = 3
OLDEST_DRIVER_STAMP_NS = 10_000_000_000

Opener = Callable[[int | str], OpenCvCapture]
"""Turns a device into a capture, opened or not; the one place where the package touches a camera."""


def open_capture(device: int | str) -> OpenCvCapture:
    """Open a Video4Linux device; on other systems, whatever OpenCV uses there (settings are then often refused)."""
    # OpenCV waits ten seconds for a camera that went silent, unless told otherwise before its first image.
    os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", str(SILENCE_LIMIT_S))
    hush_video()
    return cv2.VideoCapture(device, cv2.CAP_V4L2 if sys.platform == "linux" else cv2.CAP_ANY)


class UvcCamera(FrameSource):
    """A camera by number or path (`0`, `/dev/video0`; `/dev/v4l/by-id/…` stays the same in another socket)."""

    def __init__(
        self, device: int | str = 0, settings: CameraSettings = DEFAULT_CAMERA, opener: Opener = open_capture
    ) -> None:
        self.device = device
        self.settings = settings
        self.name = f"camera {device}"
        self._opener = opener
        self._grabber: FrameGrabber | None = None

    @property
    def settings_in_force(self) -> CameraSettings:
        """What the open camera says it is set to."""
        return self._open_grabber().ask(settings_in_force)

    def open(self) -> None:
        """Open, set, read back, and see one image; raises `CameraNotFound` or `CameraSettingRefused`."""
        if self._grabber is None:
            capture = self._opener(self.device)
            try:
                self._grabber = self._proven(capture)
            except BaseException:
                capture.release()
                raise

    def read(self) -> Frame:
        """Wait for the next image; `CameraLost` after two seconds of silence."""
        frame = patiently(self._open_grabber())
        if frame is None:
            raise CameraLost(f"expected an image from {self.name}, got none; see that it is plugged in")
        return frame

    def close(self) -> None:
        """Release the device."""
        grabber, self._grabber = self._grabber, None
        if grabber is not None:
            grabber.release()

    def _open_grabber(self) -> FrameGrabber:
        if self._grabber is None:
            raise SourceNotOpen(self.name)
        return self._grabber

    def _proven(self, capture: OpenCvCapture) -> FrameGrabber:
        if not capture.isOpened():
            raise CameraNotFound(f"expected {self.name} to open, got {why_closed(self.device)}")
        apply(self.settings, capture, self.name)
        grabber = FrameGrabber(self.name, capture, arrival_ns)
        if patiently(grabber) is None:
            raise CameraNotFound(f"expected an image from {self.name}, got none; plug it in again, or try another one")
        grabber.next_index = 0  # the first image after opening is often half exposed and is not counted
        return grabber


def patiently(grabber: FrameGrabber) -> Frame | None:
    """Read over a few damaged images, which a cheap USB board delivers now and then; None where nothing comes."""
    give_up_at = time.monotonic() + SILENCE_LIMIT_S
    for _ in range(DAMAGED_IN_A_ROW):
        frame = grabber.read()
        if frame is not None or time.monotonic() > give_up_at:
            return frame
    return None


def arrival_ns(capture: OpenCvCapture) -> int:
    """When the image reached the driver, if it says so on the monotonic clock; otherwise now.

    A driver queues a few images: one that is read late was taken earlier, and its stamp must say so.
    """
    now = time.monotonic_ns()
    driver = int(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
    return driver if 0 <= now - driver < OLDEST_DRIVER_STAMP_NS else now
