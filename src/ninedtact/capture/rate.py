"""What a source really delivers: some USB boards send every image twice and call it double the rate."""

import time
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.capture.source import FrameSource, SourceEnded
from ninedtact.errors import NinedtactError

SETTLING = 5
"""Images that arrive in a burst after opening, left out."""


class RateUnmeasurable(NinedtactError):
    """Too few different images to speak of a rate."""


@dataclass(frozen=True)
class FrameRate:
    """Rates of one measurement."""

    delivered_hz: float
    """Images per second as they come."""
    true_hz: float
    """Images per second that differ from the one before."""
    jitter_ms: float
    """Standard deviation of the time between two different images."""
    frames: int
    duplicates: int
    """Images identical, byte by byte, to the one before."""


def measure_rate(source: FrameSource, frames: int = 60, limit_s: float = 5.0) -> FrameRate:
    """Time up to `frames` images of an open source, `limit_s` at most; raises `RateUnmeasurable` below three."""
    stamps, is_new = arrivals(source, frames, limit_s)
    fresh = stamps[is_new]
    if len(fresh) < 3:
        raise RateUnmeasurable(
            f"expected at least 3 different images from {source.name} in {limit_s:g} s, got {len(fresh)}; "
            "check the camera, and that its view is not all black"
        )
    return FrameRate(
        delivered_hz=float((len(stamps) - 1) / (stamps[-1] - stamps[0])),
        true_hz=float((len(fresh) - 1) / (fresh[-1] - fresh[0])),
        jitter_ms=float(np.std(np.diff(fresh)) * 1000),
        frames=len(stamps),
        duplicates=int(len(stamps) - len(fresh)),
    )


def arrivals(source: FrameSource, frames: int, limit_s: float) -> tuple[Float[Array, " n"], np.ndarray]:
    """Arrival times in seconds, and which images differ from the one before."""
    stamps: list[float] = []
    is_new: list[bool] = []
    before = None
    give_up_at = time.monotonic() + limit_s
    while len(stamps) < frames + SETTLING and time.monotonic() < give_up_at:
        try:
            frame = source.read()
        except SourceEnded:
            break
        stamps.append(frame.stamp_ns / 1e9)
        is_new.append(before is None or not np.array_equal(frame.image, before))
        before = frame.image
    settled = SETTLING if len(stamps) > 2 * SETTLING else 0
    return np.array(stamps[settled:]), np.array(is_new[settled:], dtype=bool)
