"""Irregular surfaces, from filtered noise and scattered places."""

import numpy as np

from ninedtact.simulation.objects.outline import prism, raised
from ninedtact.simulation.objects.patterns import plate
from ninedtact.simulation.objects.sheet import Draw, Heights, Sheet


def noise(draw: Draw, sheet: Sheet, gain: np.ndarray) -> Heights:
    """Gaussian noise with this gain over its wave numbers, mean zero and standard deviation one."""
    white = draw.random.standard_normal(sheet.x.shape)
    shaped = np.fft.irfft2(np.fft.rfft2(white) * gain, s=sheet.x.shape)
    return (shaped - shaped.mean()) / shaped.std()


def frequency(sheet: Sheet) -> np.ndarray:
    """Of the entries of the transform, 1/mm."""
    samples = sheet.x.shape[0]
    first, second = np.fft.fftfreq(samples, sheet.pitch_mm), np.fft.rfftfreq(samples, sheet.pitch_mm)
    return np.hypot(first[:, None], second)


def fractal(draw: Draw, sheet: Sheet) -> Heights:
    """Self-affine: gain f^−(1 + H) with the Hurst exponent H, from a roll-off of 8 mm down to waves of 0.5 mm."""
    hurst, height = draw.between(0.3, 0.9), draw.between(0.15, 0.4)
    wave = frequency(sheet)
    gain = np.hypot(wave, 1 / 8) ** -(1 + hurst) * np.exp(-((0.5 * wave) ** 2))
    return height * noise(draw, sheet, gain) + plate(draw, sheet)


def bands(draw: Draw, sheet: Sheet, length_mm: float) -> Heights:
    """Noise of nearly one wavelength: stripes that branch and end."""
    return noise(draw, sheet, np.exp(-(((frequency(sheet) * length_mm - 1) / 0.15) ** 2)))


def coral(draw: Draw, sheet: Sheet) -> Heights:
    """Winding flat-topped walls."""
    length, relief = draw.between(2, 5), draw.between(0.5, 1.2)
    walls = (bands(draw, sheet, length) - draw.between(-0.4, 0.4)) * length / 6
    return raised(walls, relief, 0.4) + plate(draw, sheet)


def fingerprint(draw: Draw, sheet: Sheet) -> Heights:
    """Ridges around a core, on a soft dome."""
    pitch, relief, twist = draw.between(1, 1.8), draw.between(0.25, 0.5), draw.whole(-2, 3)
    bend = noise(draw, sheet, np.exp(-((6 * frequency(sheet)) ** 2)))
    phase = (
        np.hypot(sheet.x, 0.7 * sheet.y) / pitch + 0.5 * bend + twist * np.arctan2(sheet.y + 3, sheet.x) / (2 * np.pi)
    )
    oval = np.hypot(sheet.x / 0.75, sheet.y) - 8.5
    return relief * (1 + np.cos(2 * np.pi * phase)) + 0.012 * sheet.r**2 + prism(oval, 0.4)


def nearest_two(draw: Draw, sheet: Sheet, count: int) -> tuple[Heights, Heights]:
    """Distances to the nearest and the second nearest of scattered places."""
    places = draw.scatter(count, 10).tolist()
    far = np.sort(np.stack([np.hypot(sheet.x - x, sheet.y - y) for x, y in places]), axis=0)
    return far[0], far[1]


def cells(draw: Draw, sheet: Sheet) -> Heights:
    """Dry mud: plates with cracks."""
    near, next_near = nearest_two(draw, sheet, draw.whole(15, 45))
    crack = next_near - near - draw.between(0.5, 1.1)
    return raised(-crack, draw.between(0.4, 1), 0.35) + plate(draw, sheet)


def foam(draw: Draw, sheet: Sheet) -> Heights:
    """Walls between bubbles."""
    near, next_near = nearest_two(draw, sheet, draw.whole(12, 36))
    return raised(next_near - near - 0.5, draw.between(0.6, 1.4), draw.between(0.6, 1.4)) + plate(draw, sheet)


def bark(draw: Draw, sheet: Sheet) -> Heights:
    """Long furrows."""
    length, relief = draw.between(1.5, 3), draw.between(0.25, 0.5)
    samples = sheet.x.shape[0]
    along, across = np.fft.fftfreq(samples, sheet.pitch_mm)[:, None], np.fft.rfftfreq(samples, sheet.pitch_mm)
    gain = np.exp(-((5 * along) ** 2)) * across * length * np.exp(-((across * length) ** 2))
    return relief * np.abs(noise(draw, sheet, gain)) + 0.03 * sheet.x**2 + plate(draw, sheet)


def terrain(draw: Draw, sheet: Sheet) -> Heights:
    """Hills in terraces, as a map made of layers."""
    layer, hill = draw.between(0.3, 0.6), draw.between(4, 8)
    heights = 0.8 * noise(draw, sheet, np.exp(-((hill * frequency(sheet) / 2) ** 2)))
    step = np.floor(heights / layer)
    part = np.clip((heights / layer - step) * 3, 0, 1)
    return layer * (step + part**2 * (3 - 2 * part)) + plate(draw, sheet)


ROUGH = (fractal, coral, fingerprint, cells, foam, bark, terrain)
