"""The tare of a collection: reference images (no contact), and the zero of the force/torque sensor.

Whether an image shows contact is decided on blocks of 8 x 8 pixels, in which noise averages out. The change of brightness of the
whole image (a lamp that warms up) is removed first.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8
from numpy import ndarray as Array

from ninedtact.capture.force_torque.tare import TareRefused, compute_tare
from ninedtact.quantities import Frame, Wrench
from ninedtact_train.collecting.pair_selection import CollectSettings

_BLOCK_PX = 8
_KEEP_OFF = "do not touch the gel"
_NO_SAMPLES = "no samples from the force/torque sensor yet"


class ReferenceImageDifference:
    """Measures how much an image differs from the reference images."""

    def __init__(self, references: Sequence[UInt8[Array, "rows cols 3"]]) -> None:
        self._reference = np.mean([_block_means(image) for image in references], axis=0)
        self._median = float(np.median(self._reference))

    def change_levels(self, image: UInt8[Array, "rows cols 3"]) -> float:
        """Return the grey levels by which the most changed block differs; infinite for an image of another size."""
        blocks = _block_means(image)
        if blocks.shape != self._reference.shape:
            return float("inf")
        gain = self._median / max(float(np.median(blocks)), 1.0)
        return float(np.abs(gain * blocks - self._reference).max())


def _block_means(image: UInt8[Array, "rows cols 3"]) -> Float32[Array, "_ _"]:
    rows, cols = (max(side // _BLOCK_PX, 1) for side in image.shape[:2])
    small = cv2.resize(image.astype(np.float32), (cols, rows), interpolation=cv2.INTER_AREA)
    return cv2.cvtColor(small, cv2.COLOR_BGR2GRAY)


@dataclass(frozen=True)
class TareResult:
    """The result of a tare."""

    number: int
    frames: tuple[Frame, ...]
    zero: Float64[Array, "6"]
    """The reading without contact, N and N·m about the skin centre."""
    detector: ReferenceImageDifference

    def remove_zero(self, wrench: Wrench) -> Wrench:
        """Return a wrench about the skin centre minus the reading without contact."""
        force_n, torque_nm = (wrench.six - self.zero).reshape(2, 3)
        return Wrench(force_n, torque_nm, stamp_ns=wrench.stamp_ns)


@dataclass
class TareInProgress:
    """Collects images and samples until there are enough of them at rest; it starts over when something moves."""

    number: int
    settings: CollectSettings
    last: TareResult | None = None
    """The previous tare."""
    frames: list[Frame] = field(default_factory=list)
    wrenches: list[Wrench] = field(default_factory=list)
    advice: str = _KEEP_OFF
    """What a person should do during the tare."""

    def add_frame(self, frame: Frame) -> None:
        """Add an image; at most as many as the settings require are kept."""
        self.frames.append(frame)
        del self.frames[: -self.settings.reference_images]
        if not self.wrenches:
            self.advice = _NO_SAMPLES

    def add_wrench(self, wrench: Wrench) -> None:
        """Add a sample about the skin centre."""
        self.wrenches.append(wrench)
        if self.advice == _NO_SAMPLES:
            self.advice = _KEEP_OFF

    def finish(self) -> TareResult | None:
        """Return the tare when there are enough samples at rest, else None; start over if something moved."""
        duration_ns = self.wrenches[-1].stamp_ns - self.wrenches[0].stamp_ns if self.wrenches else 0
        if len(self.frames) < self.settings.reference_images or duration_ns < self.settings.tare.seconds * 1e9:
            return None
        try:
            zero = compute_tare(self.wrenches, self.settings.tare).mean
        except TareRefused as refusal:
            self.advice = str(refusal)
        else:
            detector = ReferenceImageDifference([frame.image for frame in self.frames])
            tare = TareResult(self.number, tuple(self.frames), zero, detector)
            self.advice = self._objection(tare)
            if not self.advice:
                return tare
        self.frames.clear()
        self.wrenches.clear()
        return None

    def _objection(self, tare: TareResult) -> str:
        """Return why this cannot be a tare without contact; empty if it can."""
        limit = self.settings.contact_levels
        if any(tare.detector.change_levels(frame.image) > limit for frame in tare.frames):
            return f"{_KEEP_OFF}: it moves"
        if self.last is None or self.last.detector.change_levels(tare.frames[-1].image) <= limit:
            return ""
        is_loaded = (np.abs(tare.zero - self.last.zero) > self.settings.rest).any()
        return f"{_KEEP_OFF}: something presses on it" if is_loaded else ""
