"""One source examined: does it open, how fast is it really, and is it set as touch needs it."""

from dataclasses import dataclass

from ninedtact.capture.camera import Camera
from ninedtact.capture.rate import FrameRate, measure_rate
from ninedtact.capture.settings import CameraSettings
from ninedtact.capture.source import FrameSource
from ninedtact.errors import NinedtactError

TOLERATED_DUPLICATES = 0.1


@dataclass(frozen=True)
class Checkup:
    """What was found; `trouble` is a sentence where the source could not be opened or measured."""

    name: str
    model: str | None = None
    size_px: tuple[int, int] | None = None
    """Columns and rows."""
    rate: FrameRate | None = None
    recorded_hz: float | None = None
    settings: CameraSettings | None = None
    trouble: str | None = None
    advice: tuple[str, ...] = ()


def examine(source: FrameSource, model: str | None = None, frames: int = 60) -> Checkup:
    """Open, measure and close a source; never raises for what is wrong with the source itself."""
    try:
        with source:
            return _examine_open(source, model, frames)
    except NinedtactError as trouble:
        return Checkup(source.name, model, trouble=str(trouble))


def _examine_open(source: FrameSource, model: str | None, frames: int) -> Checkup:
    rows, cols = source.read().image.shape[:2]
    # A recording comes as fast as the disk; the rate that it tells of is the one at which it was made.
    rate = measure_rate(source, frames) if source.recorded_hz is None else None
    settings = source.settings_in_force if isinstance(source, Camera) else None
    advice = (*advice_on_rate(rate), *advice_on_settings(settings))
    return Checkup(source.name, model, (cols, rows), rate, source.recorded_hz, settings, advice=advice)


def advice_on_rate(rate: FrameRate | None) -> list[str]:
    """What to do about images that come twice."""
    if rate is None or rate.duplicates <= TOLERATED_DUPLICATES * rate.frames:
        return []
    return [
        f"{rate.duplicates} of {rate.frames} images repeat the one before: the camera makes {rate.true_hz:.1f} per "
        f"second, its board sends {rate.delivered_hz:.1f}; ask for a lower rate, a shorter exposure or more light"
    ]


def advice_on_settings(settings: CameraSettings | None) -> list[str]:
    """What to do about a camera that regulates itself, and so answers a press by changing its brightness."""
    advice = []
    if settings is not None and settings.auto_exposure:
        advice.append("automatic exposure is on, a press will change it: `v4l2-ctl -d DEVICE -c auto_exposure=1`")
    if settings is not None and settings.auto_white_balance:
        advice.append("automatic white balance is on: `v4l2-ctl -d DEVICE -c white_balance_automatic=0`")
    return advice
