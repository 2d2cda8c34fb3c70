"""The path of every frame against its definition: OpenCV is trusted only as far as it computes what was asked for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ninedtact.quantities import HeightSource, Rectified
from ninedtact.shape import depth
from ninedtact.shape.calibrated_shape import DepthReader
from ninedtact.shape.depth import BrightnessSignal, DepthCurve
from ninedtact.shape.lens_and_rectification import Rectification

SIZES = st.tuples(st.integers(2, 40), st.integers(2, 40))


def bilinear(raw: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Between four pixels, the border repeated outside."""
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    right, down = x - left, y - top
    rows = [np.clip(top + step, 0, raw.shape[0] - 1) for step in (0, 1)]
    cols = [np.clip(left + step, 0, raw.shape[1] - 1) for step in (0, 1)]
    upper, lower = (raw[row, cols[0]] * (1 - right) + raw[row, cols[1]] * right for row in rows)
    return upper * (1 - down) + lower * down


@given(raw_size=SIZES, size=SIZES, seed=st.integers(0, 999))
def test_a_pixel_is_what_lies_between_its_four_sources(raw_size, size, seed):
    random = np.random.default_rng(seed)
    raw = random.uniform(0, 255, raw_size).astype(np.float32)
    source_px = (random.uniform(-3, 3, (*size, 2)) + random.uniform(0, 1, (*size, 2)) * raw_size[::-1]).astype(
        np.float32
    )
    rectify = Rectification(source_px, 0.05, raw_size, (-1, 1, -1, 1))
    expected = bilinear(raw.astype(float), *np.moveaxis(source_px.astype(float), -1, 0))
    np.testing.assert_allclose(rectify.resample(raw), expected, atol=1e-3)


@pytest.mark.parametrize("signal", ["difference", "ratio"])
def test_the_index_is_the_signal_in_steps_and_stays_in_the_table(signal: BrightnessSignal):
    reference = np.linspace(0.5, 255, 256, dtype=np.float32).reshape(16, 16)
    grey = np.random.default_rng(0).permutation(reference.ravel()).reshape(16, 16)
    curve = DepthCurve(signal, (0.0, 1.0), (0.0, 1.0), (0.0, 0.0))
    reader = DepthReader(curve, Rectified(reference, 0.05), np.full((16, 16), HeightSource.MEASURED, np.uint8))
    change = grey - reference if signal == "difference" else grey / np.maximum(reference, depth.DIMMEST_REFERENCE) - 1
    expected = np.clip(
        np.rint(depth.ZERO_INDEX + depth.TABLE_STEPS[signal] * change.astype(float)), 0, depth.TABLE_SIZE - 1
    )
    assert np.abs(reader.quantise(grey) - expected).max() <= 1
