"""What a stream without contact teaches: the noise that a contact must exceed, and the flicker of its light.

The noise of one image is that of its smoothed brightness (`measure_smooth_noise`), whatever causes it: compression, bands,
unsteady light. The largest of the images without contact is remembered, and fades within hours. It begins with the images of the
reference, each beside their mean. A contact that is too light to be detected is dark in few places and teaches almost nothing.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.force.contact_detection import (
    FAINT_IMAGES,
    measure_darkening_and_limit,
    measure_darkening_on_cells,
    measure_smooth_noise,
)
from ninedtact.quantities import Frame
from ninedtact.reading import CellNoise, Flicker, Reading, StreamMemory, read_frame
from ninedtact.shape.calibrated_shape import CalibratedShape, DepthReader

_FADING_S = 3600.0
"""Time constant with which the largest noise fades."""
_FLICKER_WINDOW_S, _FLICKER_EVERY_S = 8.0, 1.0
_MIN_FLICKER_IMAGES = 24
_MIN_FLICKER = 0.002
"""Amplitude below which flicker is not mentioned; it does not matter."""
_MIN_EXPLAINED = 0.6
"""Share of the variance of the brightness that one period explains."""
_FREQUENCIES_PER_WINDOW = 2
_CELL_NOISE_IMAGES = 600
"""Images over which the noise of every cell is averaged."""
_NS_PER_S = 1e9


def learn_from_references(frames: Sequence[Frame], shape: CalibratedShape, reader: DepthReader) -> StreamMemory:
    """Return the memory with which a stream begins: the noise of the images that are its reference; one image teaches nothing."""
    if len(frames) < 2:
        return StreamMemory()
    return StreamMemory(max(measure_smooth_noise(read_frame(frame, shape, reader)) for frame in frames))


@dataclass
class StreamLearner:
    """Learns from the readings of a stream, one after another."""

    memory: StreamMemory = StreamMemory()
    _noise_ns: int | None = field(default=None, init=False)
    """Stamp of the last image without contact."""
    _noise_of_last: float = field(default=-1.0, init=False)
    _levels: deque[tuple[int, float]] = field(default_factory=deque, init=False, repr=False)
    """Stamps and levels of the light of the last seconds."""
    _fitted_ns: int | None = field(default=None, init=False)

    def learn_noise(self, reading: Reading) -> None:
        """Learn from an image without contact."""
        gap_s = 0.0 if self._noise_ns is None else max(reading.stamp_ns - self._noise_ns, 0) / _NS_PER_S
        noise = measure_smooth_noise(reading)
        if noise == self._noise_of_last:
            return  # video codecs repeat an image as long as it changes little, which says nothing of the next one
        darkening, _ = measure_darkening_and_limit(reading)
        left = float(np.exp(-gap_s / _FADING_S))
        self.memory = replace(
            self.memory,
            noise=max(noise, left * self.memory.noise),
            darkening=max(darkening, left * self.memory.darkening),
            learnt_s=self.memory.learnt_s + min(gap_s, 1.0),
            cell_noise=self._learn_cells(),
        )
        self._noise_ns, self._noise_of_last = reading.stamp_ns, noise

    def remember(self, reading: Reading) -> None:
        """Remember the darkening of any image, for the next one."""
        darkening = measure_darkening_on_cells(reading)
        self.memory = replace(
            self.memory, last_darkenings=(*self.memory.last_darkenings, darkening)[1 - FAINT_IMAGES :]
        )

    def _learn_cells(self) -> CellNoise | None:
        """Return the noise of every cell with that of the image that was remembered last."""
        if len(self.memory.last_darkenings) < 2:
            return None
        before, now = self.memory.last_darkenings[-2:]
        known = self.memory.cell_noise or CellNoise(np.zeros_like(now), 0.0, 0)
        share = 1 / min(known.images + 1, _CELL_NOISE_IMAGES)
        step = float(np.mean((now - before) ** 2))
        return CellNoise(
            known.mean_square + np.float32(share) * (now**2 - known.mean_square),
            known.step_square + share * (step - known.step_square),
            known.images + 1,
        )

    def learn_light(self, reading: Reading) -> None:
        """Learn from any image how its light flickers; begin to learn the noise anew where the light changed in a step."""
        gain, (least, most) = reading.light.gain, self.memory.gains
        if not self.memory.knows_light(gain):
            self.memory = replace(self.memory, learnt_s=0.0, cell_noise=None)
        self.memory = replace(self.memory, gains=(min(gain, least), max(gain, most)))
        now_ns = reading.stamp_ns
        reference_level = float(reading.reference.grey[::48].mean())
        self._levels.append((now_ns, reading.light.level * reference_level))
        while self._levels[0][0] < now_ns - _FLICKER_WINDOW_S * _NS_PER_S:
            self._levels.popleft()
        if self._fitted_ns is not None and 0 <= now_ns - self._fitted_ns < _FLICKER_EVERY_S * _NS_PER_S:
            return
        self._fitted_ns = now_ns
        self.memory = replace(self.memory, flicker=find_flicker(np.array(self._levels)))


def find_flicker(levels: Float[Array, "n 2"]) -> Flicker | None:
    """Return the flicker of stamps (ns) and levels, by least squares over all periods that they show; None where there is none."""
    if len(levels) < _MIN_FLICKER_IMAGES:
        return None
    at_s, level = (levels[:, 0] - levels[0, 0]) / _NS_PER_S, levels[:, 1] / levels[:, 1].mean()
    span_s = float(at_s[-1])
    if span_s <= 0 or level.std() < _MIN_FLICKER / 2:
        return None
    trend = np.polynomial.Polynomial.fit(at_s, level, 1)
    deviation = level - trend(at_s)
    highest_hz = 0.5 / float(np.median(np.diff(at_s)))
    # Fewer than three periods within the window are a drift.
    frequency_hz = np.arange(3 / span_s, highest_hz, 1 / (_FREQUENCIES_PER_WINDOW * span_s))
    if not frequency_hz.size:
        return None
    amplitude = 2 * np.abs(np.exp(-2j * np.pi * frequency_hz[:, None] * at_s) @ deviation) / len(deviation)
    best = int(amplitude.argmax())
    explained = amplitude[best] ** 2 / 2 / float(deviation.var())
    if amplitude[best] < _MIN_FLICKER or explained < _MIN_EXPLAINED:
        return None
    return Flicker(float(amplitude[best]), float(1 / frequency_hz[best]))
