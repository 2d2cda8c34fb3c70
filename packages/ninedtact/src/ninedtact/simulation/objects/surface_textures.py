"""Surface textures as height grids: regular patterns and rough surfaces on plates.

To add a texture, write its function and list it in `PATTERNS` or `ROUGH_SURFACES`.
"""

import numpy as np

from ninedtact.simulation.objects.height_fields import (
    CoordinateGrid,
    DimensionSampler,
    Heightfield,
    HeightfieldFunction,
    flat_face,
    heights_raised_outside,
    polygon_corners,
    polygon_sdf,
    recess_heights,
    round_bar_heights,
    rounded_rectangle_sdf,
    smooth_abs,
    wrap_to_pitch,
)


def _plate(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of the plate that carries a pattern: a disc, a rectangle or a hexagon."""
    kind, size = sample.integer(0, 2), sample.between(5.5, 8.5)
    if kind == 0:
        return flat_face(grid.r - size)
    if kind == 1:
        return flat_face(rounded_rectangle_sdf(grid.x, grid.y, 2.2 * size, 1.6 * size, 0.6))
    return flat_face(polygon_sdf(grid.x, grid.y, polygon_corners(6, size)))


def _grid(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a grid of crossing bars."""
    pitch, bar, relief = sample.between(1.6, 4), sample.between(0.15, 0.35), sample.between(0.5, 1.5)
    x, y = grid.rotated_axes(sample.between(0, np.pi / 2))
    bars = (
        np.minimum(np.abs(wrap_to_pitch(x, pitch)), np.abs(wrap_to_pitch(y, pitch * sample.between(1, 1.6))))
        - bar * pitch / 2
    )
    return heights_raised_outside(bars, relief, 0.35) + _plate(sample, grid)


def _weave(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a weave: threads over and under each other."""
    pitch, depth = sample.between(1.4, 3.2), sample.between(0.3, 0.7)
    x, y = grid.rotated_axes(sample.between(0, np.pi / 2))
    warp = _over(x, y, pitch, depth)
    return np.minimum(warp, _over(y, x + pitch, pitch, depth)) + _plate(sample, grid)


def _over(x: Heightfield, y: Heightfield, pitch_mm: float, depth_mm: float) -> Heightfield:
    """Return the heights of threads along y that rise and fall."""
    thread = np.round(x / pitch_mm)
    wave = depth_mm * (1 + np.cos(np.pi * (y / pitch_mm + thread)))
    return wave + pitch_mm * 0.8 * (
        1 - np.sqrt(np.maximum(1 - (wrap_to_pitch(x, pitch_mm) / pitch_mm * 1.9) ** 2, 0.01))
    )


def _dots(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of domes on a square or staggered lattice."""
    pitch, relief, stagger = sample.between(1.6, 3.6), sample.between(0.4, 1.2), sample.integer(0, 1)
    row = np.round(grid.y / pitch)
    nearest = np.hypot(wrap_to_pitch(grid.x + stagger * pitch / 2 * (row % 2), pitch), grid.y - pitch * row)
    return relief * np.clip(nearest / (sample.between(0.25, 0.45) * pitch), 0, 1) ** 2 + _plate(sample, grid)


def _ridges(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of parallel ridges, sharp or round."""
    pitch, relief = sample.between(1.2, 3.5), sample.between(0.4, 1.2)
    x, _ = grid.rotated_axes(sample.between(0, np.pi))
    part = np.abs(wrap_to_pitch(x, pitch)) / (pitch / 2)
    return relief * part ** sample.between(1, 2.5) + _plate(sample, grid)


def _waves(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of two crossing wave trains."""
    first, second, relief = sample.between(2, 6), sample.between(2, 6), sample.between(0.3, 0.7)
    (u, _), (v, _) = grid.rotated_axes(sample.between(0, np.pi)), grid.rotated_axes(sample.between(0, np.pi))
    heights = relief * (2 + np.cos(2 * np.pi * u / first) + np.cos(2 * np.pi * v / second))
    return heights + _plate(sample, grid)


def _ripples(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of ripples as on water, from one or two points."""
    length, relief, apart = sample.between(1.5, 3.5), sample.between(0.3, 0.6), sample.between(-5, 5)
    first = np.cos(2 * np.pi * np.hypot(grid.x - apart, grid.y) / length)
    second = np.cos(2 * np.pi * np.hypot(grid.x + apart, grid.y - 1) / length)
    return relief * (2 - first - second) + _plate(sample, grid)


def _knurl(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a knurled roller: crossed grooves."""
    radius, pitch, length = sample.between(3, 8), sample.between(1, 2), sample.between(10, 17)
    along = np.arcsin(np.clip(grid.y / radius, -1, 1)) * radius
    grooves = [np.abs(wrap_to_pitch(grid.x + sign * along, 2 * pitch)) for sign in (-1, 1)]
    relief = 0.45 * np.maximum(*grooves)
    return (
        round_bar_heights(grid.y, radius)
        + relief
        + flat_face(rounded_rectangle_sdf(grid.x, grid.y, length, 2 * radius), 0.4)
    )


def _honeycomb(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a honeycomb of six-sided cells."""
    pitch, wall, depth = sample.between(2.2, 4.5), sample.between(0.25, 0.5), sample.between(0.6, 1.5)
    x, y = _hexagon_frame(*grid.rotated_axes(sample.between(0, np.pi)), pitch)
    border = np.maximum.reduce([np.abs(nx * x + ny * y) for nx, ny in polygon_corners(6, 1.0)[:3].tolist()]) - pitch / 2
    return recess_heights(border + wall, depth, 0.35) + _plate(sample, grid)


def _hexagon_frame(x: Heightfield, y: Heightfield, pitch_mm: float) -> tuple[Heightfield, Heightfield]:
    """Return x and y relative to the middle of the nearest cell of a honeycomb."""
    step = pitch_mm * np.sqrt(3)
    first = wrap_to_pitch(x, pitch_mm), wrap_to_pitch(y, step)
    second = wrap_to_pitch(x - pitch_mm / 2, pitch_mm), wrap_to_pitch(y - step / 2, step)
    nearer = np.hypot(*first) < np.hypot(*second)
    return np.where(nearer, first[0], second[0]), np.where(nearer, first[1], second[1])


def _pyramids(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a field of pyramids on their tips."""
    pitch, relief = sample.between(1.6, 4), sample.between(0.6, 1.6)
    x, y = grid.rotated_axes(sample.between(0, np.pi / 2))
    part = np.maximum(np.abs(wrap_to_pitch(x, pitch)), np.abs(wrap_to_pitch(y, pitch))) / (pitch / 2)
    return relief * smooth_abs(part, 0.15) + _plate(sample, grid)


def _spiral(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a spiral ridge with one to three arms."""
    arms, pitch, relief = sample.integer(1, 3), sample.between(1.6, 3), sample.between(0.5, 1.2)
    turn = grid.r - arms * pitch * grid.angle / (2 * np.pi)
    return heights_raised_outside(np.abs(wrap_to_pitch(turn, pitch)) - 0.2 * pitch, relief, 0.35) + _plate(sample, grid)


def _comb(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a comb: teeth on a back."""
    teeth, width, tooth = sample.integer(4, 9), sample.between(10, 17), sample.between(4, 8)
    pitch = width / teeth
    row = np.maximum(
        np.abs(wrap_to_pitch(grid.x + (0 if teeth % 2 else pitch / 2), pitch)) - 0.28 * pitch,
        np.abs(grid.x) - width / 2,
    )
    tines = np.maximum(row, np.abs(grid.y - tooth / 2) - tooth / 2)
    return flat_face(np.minimum(tines, rounded_rectangle_sdf(grid.x, grid.y + 1, width, 2.6, 0.4)), 0.25)


def _ladder(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a ladder of round bars: two rails with rungs."""
    width, pitch, bar = sample.between(4, 8), sample.between(2, 4), sample.between(0.4, 0.8)
    rails = np.hypot(np.abs(grid.y) - width / 2, 0)
    rungs = np.hypot(wrap_to_pitch(grid.x, pitch), np.maximum(np.abs(grid.y) - width / 2, 0))
    bars = np.minimum(
        round_bar_heights(rails, bar), round_bar_heights(rungs, bar * sample.between(0.7, 1)) + sample.between(0, 0.3)
    )
    return bars + flat_face(np.abs(grid.x) - sample.between(6, 9))


def _bricks(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a brick wall."""
    length, ratio, joint = sample.between(3, 6), sample.between(0.35, 0.6), sample.between(0.18, 0.35)
    row = np.round(grid.y / (length * ratio))
    stone = rounded_rectangle_sdf(
        wrap_to_pitch(grid.x + length / 2 * (row % 2), length),
        wrap_to_pitch(grid.y, length * ratio),
        length,
        length * ratio,
    )
    return heights_raised_outside(stone + joint, sample.between(0.4, 0.9), 0.3) + _plate(sample, grid)


def _scales(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of overlapping scales."""
    size, tilt = sample.between(2.2, 4.5), sample.between(0.2, 0.4)
    layers = []
    for shift in (0.0, 1.0):
        x, row = wrap_to_pitch(grid.x + shift * size / 2, size), np.floor((grid.y - shift * size / 2) / size)
        y = grid.y - shift * size / 2 - row * size
        layers.append(np.where(np.hypot(x, y) < 0.72 * size, tilt * (size - y), tilt * 2 * size))
    return np.minimum(*layers) + _plate(sample, grid)


def _checker(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a checkerboard whose fields have different heights."""
    pitch, turn = sample.between(1.8, 4), sample.between(0, np.pi / 2)
    x, y = grid.rotated_axes(turn)
    heights = sample.random.uniform(0, sample.between(0.6, 1.3), (40, 40))
    field = heights[np.round(x / pitch).astype(int) % 40, np.round(y / pitch).astype(int) % 40]
    return grid.smooth(field, 0.15) + _plate(sample, grid)


def _tread(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a tyre tread: slanted blocks and grooves."""
    pitch, slant, depth = sample.between(2, 4), sample.between(0.4, 1.2), sample.between(0.7, 1.4)
    sideways = np.abs(wrap_to_pitch(grid.x + slant * np.abs(grid.y), pitch)) - 0.13 * pitch
    grooves = np.minimum(sideways, np.abs(np.abs(grid.y) - sample.between(1.5, 3.5)) - 0.35)
    return (
        recess_heights(grooves, depth)
        + 0.02 * grid.y**2
        + flat_face(rounded_rectangle_sdf(grid.x, grid.y, 17, sample.between(9, 14), 0.5))
    )


PATTERNS: dict[str, HeightfieldFunction] = {
    "grid": _grid,
    "weave": _weave,
    "dots": _dots,
    "ridges": _ridges,
    "waves": _waves,
    "ripples": _ripples,
    "knurl": _knurl,
    "honeycomb": _honeycomb,
    "pyramids": _pyramids,
    "spiral": _spiral,
    "comb": _comb,
    "ladder": _ladder,
    "bricks": _bricks,
    "scales": _scales,
    "checker": _checker,
    "tread": _tread,
}


def _noise(sample: DimensionSampler, grid: CoordinateGrid, gain: np.ndarray) -> Heightfield:
    """Return Gaussian noise with this gain over its wave numbers, with mean zero and standard deviation one."""
    white = sample.random.standard_normal(grid.x.shape)
    shaped = np.fft.irfft2(np.fft.rfft2(white) * gain, s=grid.x.shape)
    return (shaped - shaped.mean()) / shaped.std()


def _frequency(grid: CoordinateGrid) -> np.ndarray:
    """Return the spatial frequency of each entry of the transform in 1/mm."""
    samples = grid.x.shape[0]
    first, second = np.fft.fftfreq(samples, grid.pitch_mm), np.fft.rfftfreq(samples, grid.pitch_mm)
    return np.hypot(first[:, None], second)


def _fractal(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a self-affine rough surface on a plate.

    The gain is f^−(1 + H) with the Hurst exponent H, from a roll-off of 8 mm down to waves of 0.5 mm.
    """
    hurst, height = sample.between(0.3, 0.9), sample.between(0.15, 0.4)
    wave = _frequency(grid)
    gain = np.hypot(wave, 1 / 8) ** -(1 + hurst) * np.exp(-((0.5 * wave) ** 2))
    return height * _noise(sample, grid, gain) + _plate(sample, grid)


def _coral(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of winding walls with flat tops."""
    length, relief = sample.between(2, 5), sample.between(0.5, 1.2)
    # Noise of nearly one wavelength: stripes that branch and end.
    bands = _noise(sample, grid, np.exp(-(((_frequency(grid) * length - 1) / 0.15) ** 2)))
    walls = (bands - sample.between(-0.4, 0.4)) * length / 6
    return heights_raised_outside(walls, relief, 0.4) + _plate(sample, grid)


def _fingerprint(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of a fingerprint: ridges around a core, on a soft dome."""
    pitch, relief, twist = sample.between(1, 1.8), sample.between(0.25, 0.5), sample.integer(-2, 3)
    bend = _noise(sample, grid, np.exp(-((6 * _frequency(grid)) ** 2)))
    phase = np.hypot(grid.x, 0.7 * grid.y) / pitch + 0.5 * bend + twist * np.arctan2(grid.y + 3, grid.x) / (2 * np.pi)
    oval = np.hypot(grid.x / 0.75, grid.y) - 8.5
    return relief * (1 + np.cos(2 * np.pi * phase)) + 0.012 * grid.r**2 + flat_face(oval, 0.4)


def _nearest_two(sample: DimensionSampler, grid: CoordinateGrid, count: int) -> tuple[Heightfield, Heightfield]:
    """Return the distances to the nearest and the second nearest of scattered points."""
    places = sample.scatter(count, 10).tolist()
    far = np.sort(np.stack([np.hypot(grid.x - x, grid.y - y) for x, y in places]), axis=0)
    return far[0], far[1]


def _cells(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of dry mud: plates with cracks."""
    near, next_near = _nearest_two(sample, grid, sample.integer(15, 45))
    crack = next_near - near - sample.between(0.5, 1.1)
    return heights_raised_outside(-crack, sample.between(0.4, 1), 0.35) + _plate(sample, grid)


def _foam(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of foam: walls between bubbles."""
    near, next_near = _nearest_two(sample, grid, sample.integer(12, 36))
    return heights_raised_outside(next_near - near - 0.5, sample.between(0.6, 1.4), sample.between(0.6, 1.4)) + _plate(
        sample, grid
    )


def _bark(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of bark: long furrows."""
    length, relief = sample.between(1.5, 3), sample.between(0.25, 0.5)
    samples = grid.x.shape[0]
    along, across = np.fft.fftfreq(samples, grid.pitch_mm)[:, None], np.fft.rfftfreq(samples, grid.pitch_mm)
    gain = np.exp(-((5 * along) ** 2)) * across * length * np.exp(-((across * length) ** 2))
    return relief * np.abs(_noise(sample, grid, gain)) + 0.03 * grid.x**2 + _plate(sample, grid)


def _terrain(sample: DimensionSampler, grid: CoordinateGrid) -> Heightfield:
    """Return the heights of terraced hills, as in a map made of layers."""
    layer, hill = sample.between(0.3, 0.6), sample.between(4, 8)
    heights = 0.8 * _noise(sample, grid, np.exp(-((hill * _frequency(grid) / 2) ** 2)))
    step = np.floor(heights / layer)
    part = np.clip((heights / layer - step) * 3, 0, 1)
    return layer * (step + part**2 * (3 - 2 * part)) + _plate(sample, grid)


ROUGH_SURFACES: dict[str, HeightfieldFunction] = {
    "fractal": _fractal,
    "coral": _coral,
    "fingerprint": _fingerprint,
    "cells": _cells,
    "foam": _foam,
    "bark": _bark,
    "terrain": _terrain,
}
