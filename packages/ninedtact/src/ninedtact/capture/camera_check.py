"""Checks a camera: whether it opens, its true frame rate, and whether its settings suit touch measurements.

Some USB boards send every image twice and report twice the rate; the true rate counts only images that differ.
"""

import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.capture.frame_source import CameraSettings, FrameSource, SourceEnded
from ninedtact.capture.uvc_camera import UvcCamera
from ninedtact.capture.video4linux import VideoMode
from ninedtact.errors import CameraError, NinedtactError

_SETTLING_IMAGES = 5
"""Number of images that are ignored after opening, because they arrive in a burst."""


@dataclass(frozen=True)
class FrameRate:
    """Result of one frame rate measurement."""

    delivered_hz: float
    """Images per second as they arrive."""
    true_hz: float
    """Images per second that differ from the one before."""
    jitter_ms: float
    """Standard deviation of the time between two different images."""
    frames: int
    duplicates: int
    """Images identical, byte by byte, to the one before."""


def measure_frame_rate(source: FrameSource, frames: int = 60, limit_s: float = 5.0) -> FrameRate:
    """Return the frame rate over up to `frames` images of an open source, measured for `limit_s` at most.

    Raises `CameraError` for fewer than three different images.
    """
    stamps, is_new = _collect_arrivals(source, frames, limit_s)
    fresh = stamps[is_new]
    if len(fresh) < 3:
        raise CameraError(
            expected=f"at least 3 different images from {source.name} in {limit_s:g} s",
            got=f"{len(fresh)}",
            remedy="check the camera, and that its view is not all black",
        )
    return FrameRate(
        delivered_hz=float((len(stamps) - 1) / (stamps[-1] - stamps[0])),
        true_hz=float((len(fresh) - 1) / (fresh[-1] - fresh[0])),
        jitter_ms=float(np.std(np.diff(fresh)) * 1000),
        frames=len(stamps),
        duplicates=int(len(stamps) - len(fresh)),
    )


def _collect_arrivals(source: FrameSource, frames: int, limit_s: float) -> tuple[Float[Array, " n"], np.ndarray]:
    """Return arrival times in seconds, and which images differ from the one before."""
    stamps: list[float] = []
    is_new: list[bool] = []
    before = None
    give_up_at = time.monotonic() + limit_s
    while len(stamps) < frames + _SETTLING_IMAGES and time.monotonic() < give_up_at:
        try:
            frame = source.read()
        except SourceEnded:
            break
        stamps.append(frame.stamp_ns / 1e9)
        is_new.append(before is None or not np.array_equal(frame.image, before))
        before = frame.image
    settled = _SETTLING_IMAGES if len(stamps) > 2 * _SETTLING_IMAGES else 0
    return np.array(stamps[settled:]), np.array(is_new[settled:], dtype=bool)


_TOLERATED_DUPLICATES = 0.1


@dataclass(frozen=True)
class CameraCheck:
    """The result of a camera check; `trouble` is a sentence where the source could not be opened or measured, or is damaged."""

    name: str
    model: str | None = None
    size_px: tuple[int, int] | None = None
    """Size of the images as columns and rows."""
    rate: FrameRate | None = None
    recorded_hz: float | None = None
    settings: CameraSettings | None = None
    trouble: str | None = None
    advice: tuple[str, ...] = ()
    modes: tuple[VideoMode, ...] = ()
    """The modes that the driver lists; empty where it lists none."""


def check_camera(source: FrameSource, model: str | None = None, frames: int = 60) -> CameraCheck:
    """Open, measure and close a source; a recording is read to its end, which shows whether images are missing or damaged.

    Faults of the source are part of the result and raise nothing.
    """
    try:
        with source:
            return _check_open_camera(source, model, frames)
    except NinedtactError as trouble:
        return CameraCheck(source.name, model, trouble=str(trouble))


def _check_open_camera(source: FrameSource, model: str | None, frames: int) -> CameraCheck:
    rows, cols = source.read().image.shape[:2]
    # A recording is read as fast as the disk delivers it; its true rate is the one at which it was made.
    rate = measure_frame_rate(source, frames) if source.recorded_hz is None else None
    settings = source.current_settings if isinstance(source, UvcCamera) else None
    modes = tuple(source.modes) if isinstance(source, UvcCamera) else ()
    advice = (*duplicate_frame_advice(rate), *camera_settings_advice(settings))
    trouble = None
    if source.recorded_hz is not None:
        try:
            for _ in source:  # to its end, which shows whether images are missing or damaged
                pass
        except NinedtactError as damage:
            trouble = str(damage)
    return CameraCheck(source.name, model, (cols, rows), rate, source.recorded_hz, settings, trouble, advice, modes)


def describe_camera_settings(settings: CameraSettings) -> str:
    """Return exposure, gain, white balance, focus and pixel format as the camera reports them, as text for a person."""
    exposure = "automatic exposure" if settings.auto_exposure else "exposure not reported"
    if settings.exposure_ms is not None:
        exposure = f"exposure {settings.exposure_ms:g} ms, fixed"
    gain = "gain not reported" if settings.gain is None else f"gain {settings.gain:g}"
    balance = "automatic white balance" if settings.auto_white_balance else "white balance not reported"
    if not settings.auto_white_balance and settings.white_balance_k is not None:
        balance = f"white balance {settings.white_balance_k:g} K, fixed"
    focus = {True: "autofocus", False: "focus fixed", None: "focus not reported"}[settings.autofocus]
    if settings.focus is not None:
        focus = f"focus {settings.focus:g}, fixed"
    pixels = f"; pixel format {settings.pixel_format}" if settings.pixel_format else ""
    return f"{exposure}; {gain}; {balance}; {focus}{pixels}"


def duplicate_frame_advice(rate: FrameRate | None) -> list[str]:
    """Return advice about images that arrive twice; nothing where hardly any do."""
    if rate is None or rate.duplicates <= _TOLERATED_DUPLICATES * rate.frames:
        return []
    return [
        f"{rate.duplicates} of {rate.frames} images repeat the one before: the camera makes {rate.true_hz:.1f} per "
        f"second, its board sends {rate.delivered_hz:.1f}; ask for a lower rate, a shorter exposure or more light"
    ]


def camera_settings_advice(settings: CameraSettings | None) -> list[str]:
    """Return advice about what the camera regulates by itself: exposure and white balance change the brightness under a press, and
    autofocus blurs or moves the image. Commands that measure switch all of it off.
    """
    if settings is None:
        return []
    automatic = {
        "automatic exposure is on, a press will change it: `v4l2-ctl -d DEVICE -c auto_exposure=1`": settings.auto_exposure,
        "automatic white balance is on: `v4l2-ctl -d DEVICE -c white_balance_automatic=0`": settings.auto_white_balance,
        "autofocus is on, a press will move it: `v4l2-ctl -d DEVICE -c focus_automatic_continuous=0`": settings.autofocus,
    }
    return [sentence for sentence, is_on in automatic.items() if is_on]
