"""Whether an image shows the skin untouched: places of 8 x 8 pixels, held against the reference.

Noise averages out in a place. What the whole image gained or lost (a lamp that warms up) is taken off first.

The untouched skin of a stretch of the session: how it looks, and what it weighs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8
from numpy import ndarray as Array

from ninedtact.capture.force_torque.tare import TareRefused, compute_tare
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.collecting.settings import CollectSettings

PLACE_PX = 8


class ContactImageDetector:
    """The untouched skin, and how far an image is from it."""

    def __init__(self, untouched: Sequence[UInt8[Array, "rows cols 3"]]) -> None:
        self._reference = np.mean([places(image) for image in untouched], axis=0)
        self._median = float(np.median(self._reference))

    def change(self, image: UInt8[Array, "rows cols 3"]) -> float:
        """Grey levels by which the most changed place differs."""
        seen = places(image)
        if seen.shape != self._reference.shape:
            return float("inf")
        gain = self._median / max(float(np.median(seen)), 1.0)
        return float(np.abs(gain * seen - self._reference).max())


def places(image: UInt8[Array, "rows cols 3"]) -> Float32[Array, "_ _"]:
    """Mean grey level of each place."""
    rows, cols = (max(side // PLACE_PX, 1) for side in image.shape[:2])
    small = cv2.resize(image.astype(np.float32), (cols, rows), interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(small, cv2.COLOR_BGR2GRAY)


LEAVE_IT = "leave the skin untouched"
NO_SAMPLES = "no samples from the force/torque sensor yet"


@dataclass(frozen=True)
class TareReference:
    """What a tare found."""

    number: int
    frames: tuple[Frame, ...]
    zero: Float64[Array, "6"]
    """N and N·m about the skin's centre."""
    seen: ContactImageDetector

    def taken_off(self, wrench: Wrench) -> Wrench:
        """A wrench about the skin's centre without what nothing weighs."""
        force_n, torque_nm = (wrench.six - self.zero).reshape(2, 3)
        return Wrench(force_n, torque_nm, stamp_ns=wrench.stamp_ns)


@dataclass
class TareInProgress:
    """Gathers images and samples until they are enough and still; begins anew when something moves."""

    number: int
    settings: CollectSettings
    last: TareReference | None = None
    """What the skin was before."""
    frames: list[Frame] = field(default_factory=list)
    wrenches: list[Wrench] = field(default_factory=list)
    advice: str = LEAVE_IT
    """For a person, while it goes on."""

    def see(self, frame: Frame) -> None:
        """An image; only as many as are wanted are kept."""
        self.frames.append(frame)
        del self.frames[: -self.settings.untouched_images]
        if not self.wrenches:
            self.advice = NO_SAMPLES

    def feel(self, wrench: Wrench) -> None:
        """A sample about the skin's centre."""
        self.wrenches.append(wrench)
        if self.advice == NO_SAMPLES:
            self.advice = LEAVE_IT

    @property
    def is_enough(self) -> bool:
        """Whether there are as many images, and samples for as long, as were asked for."""
        long_ns = self.wrenches[-1].stamp_ns - self.wrenches[0].stamp_ns if self.wrenches else 0
        return len(self.frames) >= self.settings.untouched_images and long_ns >= self.settings.tare.seconds * 1e9

    def untouched(self) -> TareReference | None:
        """What was found, when it is enough and still."""
        if not self.is_enough:
            return None
        try:
            found = self.found()
        except TareRefused as refusal:
            self.advice = str(refusal)
        else:
            self.advice = self.objection(found)
            if not self.advice:
                return found
        self.frames.clear()
        self.wrenches.clear()
        return None

    def found(self) -> TareReference:
        """The skin as it was gathered; raises `TareRefused`."""
        zero = compute_tare(self.wrenches, self.settings.tare).mean
        return TareReference(
            self.number, tuple(self.frames), zero, ContactImageDetector([frame.image for frame in self.frames])
        )

    def objection(self, found: TareReference) -> str:
        """Why this cannot be untouched skin; empty when it can."""
        most = self.settings.touched_levels
        if any(found.seen.change(frame.image) > most for frame in found.frames):
            return f"{LEAVE_IT}: it moves"
        if self.last is None or self.last.seen.change(found.frames[-1].image) <= most:
            return ""
        weighs = (np.abs(found.zero - self.last.zero) > self.settings.rest).any()
        return f"{LEAVE_IT}: something presses on it" if weighs else ""
