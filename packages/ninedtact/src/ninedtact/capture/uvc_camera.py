"""Camera backend for cameras on this machine: UVC and everything else that Video4Linux supports, opened through OpenCV.

Settings use the values of Video4Linux (https://docs.kernel.org/userspace-api/media/v4l/ext-ctrls-camera.html): exposure in
steps of 0.1 ms, automatic exposure as 0 auto, 1 manual, 2 shutter priority, 3 aperture priority.
"""

import getpass
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2

from ninedtact.capture.driver_stamps import DriverStamps
from ninedtact.capture.frame_source import (
    DEFAULT_CAMERA,
    AddressedFrameSource,
    CameraLost,
    CameraSettings,
    ExposureWithLimits,
    SourceNotOpen,
)
from ninedtact.capture.shared_video_capture import ThreadSafeVideoCapture, VideoCaptureProtocol, silence_video_libraries
from ninedtact.capture.video4linux import (
    VideoMode,
    delivers_images,
    exposure_limits_ms,
    list_modes,
    switch_automatic_controls_off,
)
from ninedtact.errors import CameraError
from ninedtact.quantities import Frame

_SILENCE_LIMIT_S = 2
_DAMAGED_IN_A_ROW = 3
_EXPOSURE_STEPS_PER_MS = 10
_MANUAL, _AUTOMATIC = (1.0, 2.0), (3.0, 0.0)
_MOST_DIGITS = 9
"""Digits of the largest number that OpenCV takes as a camera."""
_USB = "usb:"
_KERNEL_DEVICE_LIST = Path("/sys/class/video4linux")
_USUAL_EXPOSURE_MS = 0.1, 500.0
"""Limits of the exposure of a camera that does not report them; a value that it does not take is refused."""
_COMPRESSED = "MJPG"
_SLOW_HZ = 24.0
"""Rate below which motion JPEG is tried: USB has no room for more uncompressed images of this size."""
_BANDWIDTH = (
    "USB bandwidth: another camera on the same hub? Give it a port of its own, a smaller --size or --pixel-format MJPG"
)


def _open_capture(device: int | str) -> VideoCaptureProtocol:
    """Open a Video4Linux device; on other systems, whatever OpenCV uses there (which often refuses settings)."""
    # OpenCV waits ten seconds for a camera that went silent, unless this is set before its first image.
    os.environ.setdefault("OPENCV_VIDEOIO_V4L_SELECT_TIMEOUT", str(_SILENCE_LIMIT_S))
    silence_video_libraries()
    return cv2.VideoCapture(device, cv2.CAP_V4L2 if sys.platform == "linux" else cv2.CAP_ANY)


class UvcCamera(AddressedFrameSource):
    """A camera by number or path (`0`, `/dev/video0`), or by what stays the same after a restart of the computer.

    `usb:1-2` is whatever camera is plugged into this USB port, `usb:SERIAL` the camera with this serial number.
    """

    address_help = "a camera (0, /dev/video0, usb:PORT, usb:SERIAL)"

    def __init__(
        self,
        device: int | str = 0,
        settings: CameraSettings = DEFAULT_CAMERA,
        opener: Callable[[int | str], VideoCaptureProtocol] = _open_capture,
        list_devices: "Callable[[], list[CameraDevice]]" = lambda: list_cameras(),
    ) -> None:
        """opener: turns a device into a capture, opened or not; the one place where the package accesses a camera.
        list_devices: returns the cameras among which one is found by its USB port or serial number.
        """
        self.device = device
        self.settings = settings
        self.name = f"camera {device}"
        self._opener, self._list_devices = opener, list_devices
        self._grabber: ThreadSafeVideoCapture | None = None
        self._device_path = Path()
        self._stamps = DriverStamps(self.name)

    @classmethod
    def from_address(cls, address: str, settings: CameraSettings) -> "UvcCamera | None":
        """Return the camera of a number, of a path in /dev, or of a USB port or serial number."""
        if address.isdecimal() and len(address) <= _MOST_DIGITS:
            return cls(int(address), settings)
        return cls(address, settings) if address.startswith(("/dev/", _USB)) else None

    @property
    def current_settings(self) -> CameraSettings:
        """The settings that the open camera reports."""
        return self._open_grabber().query(_read_settings)

    @property
    def notices(self) -> tuple[str, ...]:
        """What was wrong with the driver's stamps since the camera was opened and was corrected."""
        return self._stamps.notices

    @property
    def exposure(self) -> ExposureWithLimits | None:
        """The exposure of the open camera; None where it is automatic or where the camera does not report it."""
        now_ms = self.current_settings.exposure_ms
        limits_ms = exposure_limits_ms(self._device_path) or _USUAL_EXPOSURE_MS
        return None if now_ms is None else ExposureWithLimits(now_ms, *limits_ms)

    @property
    def modes(self) -> list[VideoMode]:
        """The modes of the open camera; empty where its driver does not list them."""
        return list_modes(self._device_path)

    def set_exposure(self, exposure_ms: float) -> None:
        """Set the exposure of the open camera and read it back; raises `CameraError`."""
        settings = CameraSettings(None, exposure_ms=exposure_ms)
        self._open_grabber().query(lambda capture: _apply_settings(settings, capture, self.name, self._device_path))

    def open(self) -> None:
        """Open the camera, apply and read back the settings, and read one image.

        Where no pixel format is asked for, motion JPEG is taken if uncompressed images do not arrive, lack the size or are slow.
        Raises `CameraError`.
        """
        if self._grabber is None:
            device = self._find_device()
            self._grabber, self._device_path = self._start_in_best_format(device), _device_path(device)

    def read(self) -> Frame:
        """Wait for the next image; raises `CameraLost` after two seconds of silence."""
        frame = _read_past_damaged_images(self._open_grabber())
        if frame is None:
            raise CameraLost(
                expected=f"an image from {self.name}", got="none", remedy=f"{_silence_remedy(self.device)}"
            )
        return frame

    def close(self) -> None:
        """Release the device after a read in progress."""
        grabber, self._grabber = self._grabber, None
        if grabber is not None:
            grabber.release()

    def _open_grabber(self) -> ThreadSafeVideoCapture:
        if self._grabber is None:
            raise SourceNotOpen(self.name)
        return self._grabber

    def _find_device(self) -> int | str:
        """Return number or path of the camera; raises `CameraError` unless one alone has the USB port or serial number."""
        if not isinstance(self.device, str) or not self.device.startswith(_USB):
            return self.device
        devices = self._list_devices()
        found = [device.path for device in devices if self.device in device.usb_addresses]
        if len(found) != 1:
            others = ", ".join(f"{' or '.join(device.usb_addresses)} ({device.name})" for device in devices) or "none"
            raise CameraError(
                expected=f"one camera at {self.device}",
                got=f"{len(found) or 'none'}",
                remedy=f"plug it in or name another (this machine has {others})",
            )
        return found[0]

    def _stamp_ns(self, capture: VideoCaptureProtocol) -> int:
        """Return when the image that was just read reached the driver, as far as the driver tells it.

        A driver queues a few images: one that is read late was taken earlier, and its stamp must say so.
        """
        driver_ns = int(capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)
        return self._stamps.stamp_ns(driver_ns, time.monotonic_ns())

    def _start_in_best_format(self, device: int | str) -> ThreadSafeVideoCapture:
        """Return the camera, open; raises `CameraError`."""
        compressed = replace(self.settings, pixel_format=_COMPRESSED)
        try:
            grabber = self._start(device, self.settings)
        except CameraError as refusal:
            if self.settings.pixel_format is not None or isinstance(refusal, _CameraDoesNotOpen):
                raise
            try:
                return self._start(device, compressed)
            except CameraError:
                raise refusal from None
        rate_hz = _reported_rate_hz(grabber)
        if self.settings.pixel_format is not None or not 0 < rate_hz < _SLOW_HZ:
            return grabber
        grabber.release()
        try:
            grabber = self._start(device, compressed)
        except CameraError:
            return self._start(device, self.settings)
        if _reported_rate_hz(grabber) > rate_hz:
            return grabber
        grabber.release()
        return self._start(device, self.settings)

    def _start(self, device: int | str, settings: CameraSettings) -> ThreadSafeVideoCapture:
        capture = self._opener(device)
        try:
            if not capture.isOpened():
                raise _CameraDoesNotOpen(f"expected {self.name} to open, got {_open_failure(device)}")
            _apply_settings(settings, capture, self.name, _device_path(device))
            self._stamps = DriverStamps(self.name)
            grabber = ThreadSafeVideoCapture(self.name, capture, self._stamp_ns)
            first = _read_past_damaged_images(grabber)
            if first is None:
                raise CameraError(
                    expected=f"an image from {self.name}", got="none", remedy=f"plug it in again. {_BANDWIDTH}"
                )
            _require_size(settings, first.image.shape[1::-1], self.name, _device_path(device))
        except BaseException:
            capture.release()
            raise
        grabber.next_index = 0  # the first image after opening is often half exposed and is not counted
        return grabber


class _CameraDoesNotOpen(CameraError):
    """Raised where a device does not open, whatever its settings."""


def _reported_rate_hz(grabber: ThreadSafeVideoCapture) -> float:
    return grabber.query(lambda capture: capture.get(cv2.CAP_PROP_FPS))


def _read_past_damaged_images(grabber: ThreadSafeVideoCapture) -> Frame | None:
    """Skip a few damaged images, which a cheap USB board delivers now and then; None where nothing arrives."""
    give_up_at = time.monotonic() + _SILENCE_LIMIT_S
    for _ in range(_DAMAGED_IN_A_ROW):
        frame = grabber.read()
        if frame is not None or time.monotonic() > give_up_at:
            return frame
    return None


@dataclass(frozen=True)
class _PropertySetting:
    """One camera property to set: any of `accepted` will do, the first is tried first."""

    label: str
    prop: int
    accepted: tuple[float, ...]
    tolerance: float = 0.5
    remedy: str = "ask for a value that the camera has (`v4l2-ctl --list-ctrls` shows them), or leave it out"
    can_be_absent: bool = False
    """Whether a camera without the property has what is asked for: one without autofocus has none to switch off."""

    def is_in_force(self, capture: VideoCaptureProtocol) -> bool:
        got = capture.get(self.prop)
        if got < 0 and self.can_be_absent:
            return True
        return any(math.isclose(got, value, abs_tol=self.tolerance) for value in self.accepted)

    def text(self, value: float) -> str:
        """Return a value as a person reads it."""
        return _four_letters(value) if self.prop == cv2.CAP_PROP_FOURCC else f"{value:g}"

    def try_values(self, capture: VideoCaptureProtocol) -> None:
        for value in self.accepted:
            if capture.set(self.prop, value) and self.is_in_force(capture):
                return


def _apply_settings(settings: CameraSettings, capture: VideoCaptureProtocol, name: str, path: Path) -> None:
    """Set everything, then read everything back, since one setting may undo another; raises `CameraError`."""
    wanted = [*_video_mode(settings), *_image_controls(settings)]
    for setting in wanted:
        setting.try_values(capture)
    _require_size(settings, _image_size_px(capture), name, path)
    for setting in wanted:
        if not setting.is_in_force(capture):
            raise CameraError(
                expected=f"{name} to take {setting.label} {setting.text(setting.accepted[0])}",
                got=setting.text(capture.get(setting.prop)),
                remedy=f"{setting.remedy}",
            )
    if settings.other_automatics is False:
        switch_automatic_controls_off(path, name)


def _require_size(settings: CameraSettings, got: tuple[int, int], name: str, path: Path) -> None:
    """Raise `CameraError` with the sizes that the camera has, unless the size that it got (columns, rows) is the wanted one."""
    if settings.size_px in (None, got):
        return
    cols, rows = settings.size_px or got
    sizes = dict.fromkeys(mode.size_px for mode in list_modes(path))
    listed = ", ".join(f"{width}x{height}" for width, height in sizes) or "`ninedtact doctor` lists those that it has"
    raise CameraError(
        expected=f"{name} to take images of {cols}x{rows} pixels",
        got=f"{got[0]}x{got[1]}",
        remedy=f"use the camera that has this size, or calibrate with --size at one that this one has ({listed})",
    )


def _image_size_px(capture: VideoCaptureProtocol) -> tuple[int, int]:
    return int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT))


def _video_mode(settings: CameraSettings) -> Iterator[_PropertySetting]:
    """Yield format, size and rate, in the order in which a driver takes them; they precede the controls."""
    modes = "ask for one that it has (`ninedtact doctor` lists them)"
    if settings.pixel_format is not None:
        fourcc = cv2.VideoWriter.fourcc(*settings.pixel_format)
        yield _PropertySetting("pixel format", cv2.CAP_PROP_FOURCC, (float(fourcc),), remedy=modes)
    if settings.size_px is not None:
        cols, rows = map(float, settings.size_px)
        yield _PropertySetting("image width", cv2.CAP_PROP_FRAME_WIDTH, (cols,), remedy=modes)
        yield _PropertySetting("image height", cv2.CAP_PROP_FRAME_HEIGHT, (rows,), remedy=modes)
    if settings.rate_hz is not None:
        tolerance = 0.02 * settings.rate_hz  # 29.97 satisfies a request for 30
        yield _PropertySetting("images per second", cv2.CAP_PROP_FPS, (settings.rate_hz,), tolerance, modes)


_KEEP_AUTOMATIC = "switch it off with `v4l2-ctl`, or keep it with --automatic (heights then drift)"


def _image_controls(settings: CameraSettings) -> Iterator[_PropertySetting]:
    if settings.auto_exposure is not None or settings.exposure_ms is not None:
        accepted = _AUTOMATIC if settings.auto_exposure else _MANUAL
        label = "exposure mode (1 manual, 3 automatic)"
        yield _PropertySetting(label, cv2.CAP_PROP_AUTO_EXPOSURE, accepted, remedy=_KEEP_AUTOMATIC)
    if settings.exposure_ms is not None:
        steps = float(round(settings.exposure_ms * _EXPOSURE_STEPS_PER_MS))
        yield _PropertySetting("exposure (in steps of 0.1 ms)", cv2.CAP_PROP_EXPOSURE, (steps,))
    if settings.gain is not None:
        yield _PropertySetting("gain", cv2.CAP_PROP_GAIN, (settings.gain,))
    kelvin, focus = settings.white_balance_k, settings.focus
    for label, prop, is_on, fixed in (
        ("automatic white balance (0 off, 1 on)", cv2.CAP_PROP_AUTO_WB, settings.auto_white_balance, kelvin),
        ("autofocus (0 off, 1 on)", cv2.CAP_PROP_AUTOFOCUS, settings.autofocus, focus),
    ):
        if is_on is not None or fixed is not None:
            # A grey camera has no white balance, and a fixed lens no autofocus: nothing there regulates itself.
            absent = not is_on
            yield _PropertySetting(label, prop, (float(bool(is_on)),), 0.5, _KEEP_AUTOMATIC, can_be_absent=absent)
    if kelvin is not None:
        yield _PropertySetting("white balance in kelvin", cv2.CAP_PROP_WB_TEMPERATURE, (kelvin,), 0.01 * kelvin)
    if focus is not None:
        yield _PropertySetting("focus", cv2.CAP_PROP_FOCUS, (focus,))


def _four_letters(fourcc: float) -> str:
    """Return the code of a pixel format."""
    return (int(fourcc) % 2**32).to_bytes(4, "little").decode("ascii", errors="replace")


def _read_settings(capture: VideoCaptureProtocol) -> CameraSettings:
    """Return the settings that the camera reports; None where it reports none (V4L2 then answers −1)."""

    def reported(prop: int) -> float | None:
        value = capture.get(prop)
        return None if value < 0 else value

    exposure_mode, exposure = reported(cv2.CAP_PROP_AUTO_EXPOSURE), reported(cv2.CAP_PROP_EXPOSURE)
    is_manual = exposure_mode is None or exposure_mode in _MANUAL
    auto_wb, kelvin = reported(cv2.CAP_PROP_AUTO_WB), reported(cv2.CAP_PROP_WB_TEMPERATURE)
    autofocus = reported(cv2.CAP_PROP_AUTOFOCUS)
    fourcc = capture.get(cv2.CAP_PROP_FOURCC)
    return CameraSettings(
        size_px=_image_size_px(capture),
        rate_hz=reported(cv2.CAP_PROP_FPS),
        pixel_format=_four_letters(fourcc) if fourcc > 0 else None,
        auto_exposure=None if exposure_mode is None else not is_manual,
        exposure_ms=exposure / _EXPOSURE_STEPS_PER_MS if exposure is not None and is_manual else None,
        gain=reported(cv2.CAP_PROP_GAIN),
        auto_white_balance=None if auto_wb is None else bool(auto_wb),
        white_balance_k=None if auto_wb else kelvin,
        autofocus=None if autofocus is None else bool(autofocus),
        focus=None if autofocus else reported(cv2.CAP_PROP_FOCUS),
    )


@dataclass(frozen=True)
class CameraDevice:
    """A camera as the Linux kernel lists it."""

    path: str
    name: str
    usb_addresses: tuple[str, ...] = ()
    """Addresses by its USB port (`usb:1-2`) and by its serial number, as far as it has them; they outlast a restart."""


def list_cameras(kernel_list: Path = _KERNEL_DEVICE_LIST, device_folder: Path = Path("/dev")) -> list[CameraDevice]:
    """Return all devices that can deliver images, in the order of their numbers; none where the system is not Linux."""
    nodes = sorted(kernel_list.glob("video*"), key=lambda node: (len(node.name), node.name))
    found = [
        CameraDevice(str(device_folder / node.name), _read_text(node / "name", "unnamed"), _usb_addresses(node))
        for node in nodes
    ]
    return [device for device in found if delivers_images(Path(device.path))]


def _read_text(path: Path, default: str) -> str:
    try:
        return path.read_text().strip()
    except OSError:
        return default


def _usb_addresses(node: Path) -> tuple[str, ...]:
    """Return the addresses of a camera by USB port and serial number; none where it is not a USB camera.

    The node's device is a USB interface, named by its port and a colon (https://docs.kernel.org/driver-api/usb/usb.html).
    """
    interface = (node / "device").resolve()
    port, colon, _ = interface.name.partition(":")
    if not colon or "-" not in port:
        return ()
    serial = _read_text(interface.parent / "serial", "")
    return (_USB + port, _USB + serial) if serial else (_USB + port,)


def _silence_remedy(device: int | str) -> str:
    """Return what to do about a camera that stopped: whether it is unplugged, or something keeps its images from arriving."""
    path = _device_path(device)
    if not path.exists():
        return "check that it is plugged in"
    return "it is still plugged in: end other programs that load the computer or the USB bus, then plug it in again"


def _device_path(device: int | str) -> Path:
    return Path(f"/dev/video{device}" if isinstance(device, int) else device)


def _open_failure(device: int | str) -> str:
    """Return why a device does not open, as words that follow "got"."""
    path = _device_path(device)
    if not path.exists():
        others = ", ".join(camera.path for camera in list_cameras()) or "no camera at all"
        return f"no device {path}; plug it in, or name another (this machine has {others})"
    if not os.access(path, os.R_OK | os.W_OK):
        try:
            user = getpass.getuser()
        except (KeyError, OSError):
            user = "$USER"
        return f"no permission for {path}; run `sudo usermod -aG video {user}` and log in again"
    return f"a refusal from {path}; close the other program that uses it, or name another device"
