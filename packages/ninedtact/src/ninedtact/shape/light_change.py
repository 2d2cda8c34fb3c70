"""What changed in the light between an image and its reference image, measured on skin that does not move, and taken out.

    ratio of image to reference ──▶ bands of a rolling shutter ──▶ gradient ──▶ gain and gamma ──▶ dirt ──▶ corrected image

A dimmed LED under a rolling shutter puts *bands* on the raw rows: one profile over the whole width, periodic over the whole height,
which no contact makes unless it covers the view. A *gradient* (`light_gradient`) is smooth over the view. *Gain* is the median of
the ratio, and *gamma* the slope of log brightness, over skin where the ratio is flat. Gel keeps its volume: what a wide press
displaces rises elsewhere and brightens the median by a hundredth and more, which is no change of the light. *Dirt* (`dirt`) is
replaced by its surroundings.

An image whose light has not changed is returned as it is. What is smaller than the dead zones below is not taken out, so that the
same press gives the same answer in steady light.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray as Array

from ninedtact.quantities import EstimateWarning, HeightSource, Rectified
from ninedtact.shape.deblurring import block_means
from ninedtact.shape.dirt import MIN_DIRT_CONTRAST, Cells, Grey, replace_dirt
from ninedtact.shape.lens_and_rectification import Rectification
from ninedtact.shape.light_gradient import LightGradient, find_flat_skin, find_light_gradient

_CELL_PX = 8
"""Side of the cells on which gain and bands are measured, rectified pixels."""

_MIN_GAIN_CHANGE = 0.004
"""Change of the median below which the gain is left as it is."""
_BRIGHTENED_PER_BULGE, _MOST_BRIGHTENED = 1.1, 0.011
"""Largest rise of the median that a press makes, per mean brightening of bulges above the median, and the most of it: 504 presses
of up to 12 N on six twins of real sensors and on bases that yield."""
_DIMMED_PER_CHANGE = 0.5
"""Largest fall of the median that a press makes, per mean deviation from the median: dragged skin sinks on one side over most of
the view. 98 of 100 presses of up to 45 N, dragged by 2 mm and turned, stay below 0.42."""
_GAIN_SPREADS = 0.5
"""Standard deviations of flat skin within which the level is not certain, under deep and wide presses."""
_MIN_FLAT_SHARE = 0.05
"""Share of flat skin below which no gain is known, as under a pin board."""
_GAIN_RANGE = 0.8, 1.25
"""Gains that are taken out. Beyond them images are refused (`image_plausibility`)."""
_REPORTED_GAIN_CHANGE = 0.01
"""Change of the gain from which readings carry a warning."""
_MIN_GAMMA_CHANGE, _MAX_GAMMA_ERROR = 0.03, 0.03
"""Change of gamma that is taken out, where its standard error is at most this."""
_GAMMA_RANGE = 0.7, 1.4
_CELLS_PER_SAMPLE = 60
"""Neighbouring cells whose residuals are alike."""
_MIN_DIRT_RANGE = MIN_DIRT_CONTRAST / 4
"""Range of the ratio over the view below which no dirt is looked for: a cell shows part of the contrast of a small spot."""

_CYCLES = np.arange(0.75, 12.01, 0.0625)
"""Bands over the image that are looked for. Finer ones are averaged out; coarser ones are a gradient."""
_PROFILE_BINS, _PROFILE_SAMPLES = 48, 40
_MIN_BAND_AMPLITUDE = 0.0012
_MIN_EXPLAINED, _FEW_CYCLES, _MIN_EXPLAINED_OF_FEW, _MAX_AMPLITUDE_OF_FEW = 0.75, 2.5, 0.92, 0.1
"""Share of a profile's variance that bands of one period explain. A rod across the whole view may look like a few cycles:
pressed in by a millimetre, like bands of ±0.3."""
_MAX_SIDE_DIFFERENCE = 0.35
"""Largest difference between the bands of one side of the view and those of the whole, as a fraction."""
_WIDE_CYCLES, _STRIPS = 1.5, 5
"""Fewer cycles than that have to leave this many strips of the view even, up to the same fraction, which no press does, and half of
what a parabola leaves of the profile, or they are a gradient."""
_HARMONICS = 3


@dataclass(frozen=True)
class LightBands:
    """Bands that a rolling shutter makes of a light that is dimmed by pulses."""

    amplitude: float
    """Half of the difference between bright and dark, relative to the brightness."""
    period_px: float
    """Period on the raw image, px."""
    along_rows: bool
    """Whether the bands run along the raw rows; otherwise along the columns, of a camera whose driver rotates its images."""
    factor: Float32[Array, " lines"] = field(repr=False, compare=False)
    """Brightness of every raw row, or column, relative to the mean."""

    def factor_over(self, shape: tuple[int, ...]) -> Float32[Array, "rows cols 1"]:
        """Return the brightness of every raw pixel relative to the mean."""
        lines = self.factor[:, None] if self.along_rows else self.factor[None]
        return np.broadcast_to(lines, shape[:2])[..., None]

    @property
    def sentence(self) -> str:
        """The bands in words."""
        lines = "rows" if self.along_rows else "columns"
        return f"bands of ±{self.amplitude:.1%} with a period of {self.period_px:.0f} {lines} (dimmed light, rolling shutter)"


@dataclass(frozen=True)
class LightChange:
    """The light of an image relative to that of its reference image. All of it is taken out of the image but where said."""

    level: float = 1.0
    """Brightness of the skin without contact, relative to the reference image."""
    gain: float = 1.0
    """Gain that was taken out, one where none was."""
    gamma: float = 1.0
    """Exponent that was taken out together with the gain, one where none was."""
    bands: LightBands | None = None
    gradient: LightGradient | None = None
    """Smooth gradient over the view that was taken out; None where there was none."""
    dirt_spots: int = 0
    """Number of spots that gel cannot make; they are replaced by their surroundings."""
    dirt_mm2: float = 0.0
    """Their area."""
    is_level_known: bool = True
    """Whether enough skin is flat for the level to be known; otherwise no gain is taken out."""

    @property
    def warnings(self) -> tuple[EstimateWarning, ...]:
        """The changes of the light of which a reader should know."""
        found = {
            EstimateWarning.LIGHT_CHANGED: self._has_level_changed
            or (self.gradient is not None and self.gradient.amplitude >= _REPORTED_GAIN_CHANGE),
            EstimateWarning.LIGHT_BANDED: self.bands is not None,
            EstimateWarning.DIRT: self.dirt_spots > 0,
        }
        return tuple(warning for warning, holds in found.items() if holds)

    @property
    def _has_level_changed(self) -> bool:
        is_unknown = not self.is_level_known and abs(self.level - 1) >= 3 * _REPORTED_GAIN_CHANGE
        return abs(self.gain - 1) >= _REPORTED_GAIN_CHANGE or self.gamma != 1 or is_unknown

    @property
    def sentences(self) -> tuple[str, ...]:
        """The same in words, with figures."""
        found = []
        if self.gradient is not None:
            size, error = self.gradient.amplitude, self.gradient.error
            found.append(
                f"the light has changed unevenly, by ±{size:.1%} over the view: taken out to {error:.1%} of the brightness"
            )
        if self._has_level_changed:
            done = "taken out" if self.gain != 1 else "not taken out, because hardly any skin is flat"
            gamma = f", gamma {self.gamma:.2f}" if self.gamma != 1 else ""
            side = "brighter" if self.level > 1 else "dimmer"
            found.append(f"the light is {abs(self.level - 1):.1%} {side} than in the reference image{gamma}: {done}")
        if self.bands is not None:
            found.append(f"{self.bands.sentence}: taken out")
        if self.dirt_spots:
            count = "one spot" if self.dirt_spots == 1 else f"{self.dirt_spots} spots"
            found.append(f"{count} of dirt, {self.dirt_mm2:.2f} mm² in all, on lens or window: masked")
        return tuple(found)

    def restore(self, grey: Grey) -> Grey:
        """Return a corrected image in its own light again, without bands and dirt."""
        if self.gain != 1 or self.gamma != 1:
            grey = _apply_gain(grey, self.gain, self.gamma)
        return grey if self.gradient is None else grey * self.gradient.factor(grey.shape)


def _apply_gain(grey: Grey, gain: float, gamma: float) -> Grey:
    """Return the image in a light of this gain and gamma. The gain is that of mid grey."""
    if gamma != 1:
        grey = _MID_GREY * np.power(np.maximum(grey, 1) / np.float32(_MID_GREY), np.float32(gamma))
    return np.asarray(grey * np.float32(gain), np.float32)


def _remove_gain(grey: Grey, gain: float, gamma: float) -> Grey:
    """Return the image without this gain and gamma, itself where both are one."""
    if gamma != 1:
        return _apply_gain(grey / np.float32(gain), 1.0, 1 / gamma)
    return grey if gain == 1 else _apply_gain(grey, 1 / gain, 1.0)


_MID_GREY = 150.0
"""Grey level at which gain and gamma are separated."""


@dataclass(frozen=True)
class LightCorrection:
    """Measures the change of the light of rectified images of one sensor, and takes it out."""

    rectify: Rectification
    _reference: list[tuple[Rectified, Cells]] = field(default_factory=list, init=False, repr=False, compare=False)
    """The last reference averaged over the cells."""

    def __call__(self, image: Rectified, reference: Rectified) -> tuple[Rectified, LightChange]:
        """Return the image in the light of its reference, and what changed; the same image where nothing did."""
        ratio = self._ratio_on_cells(image.grey, reference)
        level = _median(ratio[self._seen]) if self._seen.any() else 0.0
        if level <= 0:
            return image, LightChange()
        grey, bands = image.grey, self._find_bands(ratio / np.float32(level))
        if bands is not None:
            grey = grey / bands.factor[self._lines(bands.along_rows)]
            ratio = self._ratio_on_cells(grey, reference)
            level = _median(ratio[self._seen])
        gradient = find_light_gradient(
            ratio / np.float32(level), self._reference_on_cells(reference), self._seen, _CELL_PX * reference.mm_per_px
        )
        if gradient is not None:
            grey = grey / gradient.factor(grey.shape)
            ratio = ratio / gradient.factor(ratio.shape)
            level *= gradient.level
        gain, gamma, is_known = self._find_gain(ratio, level, reference, is_certain=gradient is not None)
        grey = _remove_gain(grey, gain, gamma)
        spots, area_px = 0, 0
        if np.ptp(ratio[self._seen]) > _MIN_DIRT_RANGE:
            grey, spots, area_px = replace_dirt(grey, reference.grey)
        dirt_mm2 = area_px * image.mm_per_px**2
        change = LightChange(level, gain, gamma, bands, gradient, spots, dirt_mm2, is_known)
        return (image if grey is image.grey else Rectified(grey, image.mm_per_px, image.stamp_ns)), change

    def _ratio_on_cells(self, grey: Grey, reference: Rectified) -> Cells:
        return block_means(grey, _CELL_PX) / self._reference_on_cells(reference)

    def _reference_on_cells(self, reference: Rectified) -> Cells:
        # Another thread may replace the cached reference at any moment.
        cached = self._reference[0] if self._reference else None
        if cached is None or cached[0] is not reference:
            cached = reference, np.maximum(block_means(reference.grey, _CELL_PX), np.float32(1))
            self._reference[:] = [cached]
        return cached[1]

    @cached_property
    def _seen(self) -> Bool[Array, "few_rows few_cols"]:
        seen = (self.rectify.height_source != HeightSource.OUT_OF_VIEW).astype(np.float32)
        return np.asarray(block_means(seen, _CELL_PX) > 0.99)

    def _find_gain(
        self, ratio: Cells, level: float, reference: Rectified, is_certain: bool
    ) -> tuple[float, float, bool]:
        """Return gain and gamma of the skin that does not move, ones where they hardly changed, and whether they are known.

        is_certain: whether the level is that of undisplaced skin; otherwise a press may have made some of its change.
        """
        if not is_certain and abs(level - 1) < self._least_gain_change(ratio, level):
            return 1.0, 1.0, True
        flat = find_flat_skin(ratio / np.float32(level), self._seen, _CELL_PX * reference.mm_per_px)
        if flat.sum() < _MIN_FLAT_SHARE * self._seen.sum():
            return 1.0, 1.0, False
        spread = float(ratio[flat].std()) / level
        least = 0.0 if is_certain else self._least_gain_change(ratio, level, spread)
        if abs(level - 1) < least or not _GAIN_RANGE[0] < level < _GAIN_RANGE[1]:
            return 1.0, 1.0, True
        fit = fit_gamma(ratio[flat], self._reference_on_cells(reference)[flat])
        if fit is None or not (fit.is_certain and _GAMMA_RANGE[0] < fit.gamma < _GAMMA_RANGE[1]):
            return level, 1.0, True
        return fit.gain, fit.gamma, True

    def _least_gain_change(self, ratio: Cells, level: float, spread: float = 0.0) -> float:
        """Return the change of the median up to which the press itself may have made it; spread: that of flat skin."""
        deviation = ratio[self._seen] / np.float32(level) - 1
        if level > 1:
            by_press = min(_BRIGHTENED_PER_BULGE * float(np.maximum(deviation, 0).mean()), _MOST_BRIGHTENED)
        else:
            by_press = _DIMMED_PER_CHANGE * float(np.abs(deviation).mean())
        return _MIN_GAIN_CHANGE + max(by_press, _GAIN_SPREADS * spread)

    def _find_bands(self, ratio: Cells) -> LightBands | None:
        """Return the bands on the raw rows or columns, whichever are stronger; None where there are none."""
        found = [self._bands_along(ratio, along_rows) for along_rows in (True, False)]
        return max((bands for bands in found if bands is not None), key=lambda bands: bands.amplitude, default=None)

    def _bands_along(self, ratio: Cells, along_rows: bool) -> LightBands | None:
        grid = self._row_grid if along_rows else self._col_grid
        samples = ratio.ravel()[grid.cell]
        profile = _median(samples, axis=1)
        deviation = profile - profile.mean()
        total = float(deviation @ deviation)
        if total < 0.25 * len(profile) * _MIN_BAND_AMPLITUDE**2:
            return None
        parts = grid.waves @ deviation
        power = (parts**2).sum(axis=1)
        best = int(power.argmax())
        amplitude = float(np.sqrt(2 * power[best] / len(profile)))
        is_few = _CYCLES[best] <= _FEW_CYCLES
        least, most = (_MIN_EXPLAINED_OF_FEW, _MAX_AMPLITUDE_OF_FEW) if is_few else (_MIN_EXPLAINED, np.inf)
        if (
            power[best] < least * total
            or _CYCLES[best] > grid.most_cycles
            or not _MIN_BAND_AMPLITUDE <= amplitude <= most
        ):
            return None
        is_wide = _CYCLES[best] < _WIDE_CYCLES
        if is_wide and total - power[best] > 0.5 * (total - float(((grid.parabola @ deviation) ** 2).sum())):
            return None
        third = samples.shape[1] // 3
        for side in (samples[:, :third], samples[:, -third:]):
            line = _median(side, axis=1)
            if np.linalg.norm(grid.waves[best] @ (line - line.mean()) - parts[best]) > _MAX_SIDE_DIFFERENCE * np.sqrt(
                power[best]
            ):
                return None
        bands = grid.fit_bands(deviation, _peak_of_parabola(power, best), along_rows)
        return bands if not is_wide or self._are_alike_over_view(bands, samples, grid) else None

    @staticmethod
    def _are_alike_over_view(bands: LightBands, samples: Float32[Array, "bins samples"], grid: "_ProfileGrid") -> bool:
        """Return whether every strip across the bands is even without them."""
        strips = np.stack([_median(strip, axis=1) for strip in np.array_split(samples, _STRIPS, axis=1)], axis=1)
        even = strips / bands.factor[(grid.line * grid.lines).astype(np.intp)][:, None]
        return bool(even.std() < _MAX_SIDE_DIFFERENCE * bands.amplitude / np.sqrt(2))

    @cached_property
    def _row_grid(self) -> "_ProfileGrid":
        return _profile_grid(self.rectify, along_rows=True)

    @cached_property
    def _col_grid(self) -> "_ProfileGrid":
        return _profile_grid(self.rectify, along_rows=False)

    def _lines(self, along_rows: bool) -> Int[Array, "rows cols"]:
        """Return the raw row, or column, of every rectified pixel."""
        return self._raw_rows if along_rows else self._raw_cols

    @cached_property
    def _raw_rows(self) -> Int[Array, "rows cols"]:
        return np.clip(np.rint(self.rectify.source_px[..., 1]), 0, self.rectify.raw_shape[0] - 1).astype(np.intp)

    @cached_property
    def _raw_cols(self) -> Int[Array, "rows cols"]:
        return np.clip(np.rint(self.rectify.source_px[..., 0]), 0, self.rectify.raw_shape[1] - 1).astype(np.intp)


@dataclass(frozen=True)
class _ProfileGrid:
    """Lines of the raw image, each sampled at several cells of the rectified one."""

    cell: Int[Array, "bins samples"]
    """Index of the cell of each sample."""
    line: Float[Array, " bins"]
    """Raw row, or column, of each bin, as a fraction of their number."""
    cell_lines: float
    """Raw lines over which a cell averages, as a fraction of their number."""
    lines: int

    @property
    def most_cycles(self) -> float:
        """Most cycles that are looked for: three cells or more show one."""
        return min(float(_CYCLES[-1]), 0.35 / self.cell_lines)

    @cached_property
    def waves(self) -> Float[Array, "cycles 2 bins"]:
        """Orthonormal waves of every number of cycles, without a mean."""
        angle = 2 * np.pi * _CYCLES[:, None] * self.line
        pairs = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        return np.asarray(np.linalg.qr(pairs - pairs.mean(axis=1, keepdims=True))[0].transpose(0, 2, 1))

    @cached_property
    def parabola(self) -> Float[Array, "2 bins"]:
        """Orthonormal polynomials of first and second order."""
        return np.asarray(np.linalg.qr(np.vander(self.line - self.line.mean(), 3, increasing=True))[0][:, 1:].T)

    def fit_bands(self, deviation: Float[Array, " bins"], cycles: float, along_rows: bool) -> LightBands:
        """Return the bands of this number of cycles and their harmonics, by least squares with outliers given less weight."""
        orders = [order for order in range(1, _HARMONICS + 1) if order * cycles <= self.most_cycles]

        def basis(at: Float[Array, " n"]) -> Float[Array, "n k"]:
            waves = [wave(2 * np.pi * order * cycles * at) for order in orders for wave in (np.cos, np.sin)]
            return np.stack([np.ones_like(at), *waves], axis=1)

        seen = basis(self.line) * np.concatenate(
            [[1], np.repeat(np.sinc(np.array(orders) * cycles * self.cell_lines), 2)]
        )
        weight = np.ones_like(deviation)
        for _ in range(3):
            root = np.sqrt(weight)
            coefficients = np.linalg.lstsq(seen * root[:, None], deviation * root, rcond=None)[0]
            residual = np.abs(deviation - seen @ coefficients)
            weight = 1 / (1 + (residual / (2 * np.median(residual) + 1e-9)) ** 2)
        coefficients[0] = 0
        factor = 1 + basis((np.arange(self.lines) + 0.5) / self.lines) @ coefficients
        amplitude = float(factor.max() - factor.min()) / 2
        return LightBands(amplitude, self.lines / cycles, along_rows, factor.astype(np.float32))


def _peak_of_parabola(power: Float[Array, " cycles"], best: int) -> float:
    """Return the number of cycles of the most power, between those that were tried."""
    if not 0 < best < len(power) - 1:
        return float(_CYCLES[best])
    before, peak, after = power[best - 1 : best + 2]
    return float(_CYCLES[best] + (_CYCLES[1] - _CYCLES[0]) * (before - after) / (2 * (before - 2 * peak + after)))


def _profile_grid(rectify: Rectification, along_rows: bool) -> _ProfileGrid:
    """Return the lines of a sensor's raw image that its rectified one shows, and the cells that see them."""
    position = [block_means(np.ascontiguousarray(axis), _CELL_PX) for axis in np.moveaxis(rectify.source_px, -1, 0)]
    raw_rows, raw_cols = rectify.raw_shape
    along, across = (
        (position[1] / raw_rows, position[0] / raw_cols)
        if along_rows
        else (position[0] / raw_cols, position[1] / raw_rows)
    )
    low, high = (np.clip(np.quantile(along, share), 0, 1) for share in (0.02, 0.98))
    left, right = (np.clip(np.quantile(across, share), 0, 1) for share in (0.02, 0.98))
    cells = [
        np.argmin((along.ravel() - at) ** 2 + (across.ravel() - side) ** 2)
        for at in np.linspace(low, high, _PROFILE_BINS)
        for side in np.linspace(left, right, _PROFILE_SAMPLES)
    ]
    steps = [float(np.median(np.abs(step))) for step in np.gradient(along)]
    lines = raw_rows if along_rows else raw_cols
    cell = np.array(cells).reshape(_PROFILE_BINS, -1)
    return _ProfileGrid(cell, along.ravel()[cell].mean(axis=1).astype(float), max(steps), lines)


@dataclass(frozen=True)
class GammaFit:
    """A gamma and a gain, fitted to the brightness of an image relative to its reference image."""

    gamma: float
    error: float
    """Standard error of gamma."""
    gain: float
    """Gain of mid grey."""
    effect: float
    """Standard deviation of the change of brightness that gamma makes over the view."""
    spread: float
    """Median of what is left of the logarithm of the ratio."""

    @property
    def is_certain(self) -> bool:
        """Whether gamma is known well enough, and differs from one."""
        return self.error <= _MAX_GAMMA_ERROR and abs(self.gamma - 1) >= max(_MIN_GAMMA_CHANGE, 3 * self.error)


def fit_gamma(ratio: Float32[Array, " n"], reference: Float32[Array, " n"]) -> GammaFit | None:
    """Fit gamma and gain to the ratio of an image to its reference image; None where the reference has one brightness."""
    logarithm, structure = np.log(np.maximum(ratio, 1e-3)), np.log(reference / np.float32(_MID_GREY))
    weight = np.ones_like(ratio)
    for _ in range(3):
        middle = float(np.average(structure, weights=weight))
        centred = structure - middle
        mean = float(np.average(logarithm, weights=weight))
        variance = float(np.average(centred**2, weights=weight))
        if variance <= 0:
            return None
        slope = float(np.average(centred * (logarithm - mean), weights=weight)) / variance
        residual = np.abs(logarithm - mean - slope * centred)
        weight = 1 / (1 + (residual / (2 * np.median(residual) + np.float32(1e-6))) ** 2)
    spread = float(np.sqrt(np.mean(residual**2)))
    error = spread / np.sqrt(variance * max(len(ratio) / _CELLS_PER_SAMPLE, 1))
    return GammaFit(
        1 + slope,
        float(error),
        float(np.exp(mean - slope * middle)),
        float(abs(slope) * np.sqrt(variance)),
        float(np.median(residual)),
    )


def _median(values: Float32[Array, "*shape"], axis: int | None = None) -> Any:
    """Return the upper median, which is quicker than NumPy's."""
    flat = values.ravel() if axis is None else values
    middle = flat.shape[-1] // 2
    found = np.partition(flat, middle, axis=-1)[..., middle]
    return float(found) if axis is None else found
