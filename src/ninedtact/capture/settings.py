"""What a camera is set to: every setting is read back, and refused where the camera did not take it.

The values are those of Video4Linux (https://docs.kernel.org/userspace-api/media/v4l/ext-ctrls-camera.html): exposure in
steps of 0.1 ms, automatic exposure as 0 auto, 1 manual, 2 shutter priority, 3 aperture priority.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import cv2

from ninedtact.capture.grabber import Capture
from ninedtact.errors import NinedtactError

V4L2_EXPOSURE_PER_MS = 10
MANUAL, AUTOMATIC = (1.0, 2.0), (3.0, 0.0)


class SettingRefused(NinedtactError):
    """A setting that the camera did not take."""


@dataclass(frozen=True)
class CameraSettings:
    """What to ask of a camera; None leaves a setting as the camera has it."""

    size_px: tuple[int, int] | None = (640, 480)
    """Columns and rows."""
    rate_hz: float | None = None
    pixel_format: str | None = None
    """Four letters. Over USB 2 the high rates need MJPG."""
    auto_exposure: bool | None = None
    exposure_ms: float | None = None
    """Implies that automatic exposure is off."""
    gain: float | None = None
    """In the camera's own unit."""
    auto_white_balance: bool | None = None
    white_balance_k: float | None = None
    """Implies that automatic white balance is off."""

    def __post_init__(self) -> None:
        if self.exposure_ms is not None and self.auto_exposure:
            raise SettingRefused("expected exposure_ms or auto_exposure, got both; drop one")
        if self.white_balance_k is not None and self.auto_white_balance:
            raise SettingRefused("expected white_balance_k or auto_white_balance, got both; drop one")
        if self.pixel_format is not None and len(self.pixel_format) != 4:
            raise SettingRefused(f"expected pixel_format of four letters, got '{self.pixel_format}'; try MJPG or YUYV")


AS_SENSOR = CameraSettings()
"""Raw images of the size that the published sensor has; all else as the camera has it."""
STEADY = CameraSettings(auto_exposure=False, auto_white_balance=False)
"""What touch needs: a camera that regulates its own brightness answers a press by brightening the image again."""


@dataclass(frozen=True)
class Wish:
    """One property to set: any of `accepted` will do, the first is tried first."""

    what: str
    prop: int
    accepted: tuple[float, ...]
    tolerance: float = 0.5
    remedy: str = "ask for a value that the camera has (`v4l2-ctl --list-ctrls` shows them), or leave it out"

    def met(self, capture: Capture) -> bool:
        """Whether the camera says that it has one of the accepted values."""
        got = capture.get(self.prop)
        return any(math.isclose(got, value, abs_tol=self.tolerance) for value in self.accepted)

    def ask(self, capture: Capture) -> None:
        """Set values until one is taken."""
        for value in self.accepted:
            if capture.set(self.prop, value) and self.met(capture):
                return


def apply(settings: CameraSettings, capture: Capture, name: str) -> None:
    """Set everything, then read everything back, since one setting may undo another; raises `SettingRefused`."""
    wishes = list(wishes_of(settings))
    for wish in wishes:
        wish.ask(capture)
    for wish in wishes:
        if not wish.met(capture):
            got = capture.get(wish.prop)
            raise SettingRefused(
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


def settings_in_force(capture: Capture) -> CameraSettings:
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


def _said(capture: Capture, prop: int) -> float | None:
    value = capture.get(prop)
    return None if value < 0 else value


def _letters(fourcc: float) -> str | None:
    if fourcc <= 0:
        return None
    return int(fourcc).to_bytes(4, "little").decode("ascii", errors="replace")
