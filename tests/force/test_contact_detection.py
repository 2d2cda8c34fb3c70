"""The gate: noise and lamps are no touch, whatever the image's size; a shallow dent is one, with or without a reference."""

import numpy as np
import pytest

from ninedtact.force.contact_detection import detect_contact
from ninedtact.quantities import Frame, HeightMap, HeightSource, Rectified
from ninedtact.reading import Reading

FULL = (345, 460), 0.0522


def reading(
    shape: tuple[int, int], mm_per_px: float, seed: int, *, lamp: float = 1.0, noise: float = 1.0, dent: float = 0.0
) -> Reading:
    """An image that is dimmer at its rim, with noise in grey levels, another brightness of the lamp, a dent that darkens."""
    rng = np.random.default_rng(seed)
    y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in shape), indexing="ij")
    untouched = 150 * (1 - 0.4 * (x**2 + y**2) / 2)
    dark = dent * np.exp(-(x**2 + y**2) / 0.02)
    seen = untouched * lamp * (1 - dark) + rng.normal(0, noise, shape)
    reference = untouched + rng.normal(0, noise / 3, shape)
    height = HeightMap(
        (-dark + rng.normal(0, 0.005, shape)).astype(np.float32),
        np.full(shape, HeightSource.MEASURED, np.uint8), mm_per_px, 0.005,
    )  # fmt: skip
    images = (Rectified(one.astype(np.float32), mm_per_px) for one in (seen, reference))
    rectified, kept = images
    return Reading(Frame(np.zeros((1, 1, 3), np.uint8)), rectified, height, reference=kept)


@pytest.mark.parametrize("lamp", [0.95, 1.0, 1.06])
@pytest.mark.parametrize("noise", [0.2, 1.0, 3.0])
@pytest.mark.parametrize(("shape", "mm_per_px"), [FULL, ((180, 240), 0.1)])
def test_noise_and_lamps_are_no_touch(shape: tuple[int, int], mm_per_px: float, noise: float, lamp: float) -> None:
    assert not any(detect_contact(reading(shape, mm_per_px, seed, lamp=lamp, noise=noise)) for seed in range(20))


@pytest.mark.parametrize("lamp", [0.95, 1.06])
def test_a_dent_of_a_hundredth_is_a_touch(lamp: float) -> None:
    assert all(detect_contact(reading(*FULL, seed, lamp=lamp, dent=0.01)) for seed in range(10))


def test_without_a_reference_heights_decide() -> None:
    from dataclasses import replace

    for dent, touched in ((0.0, False), (0.1, True)):
        assert detect_contact(replace(reading(*FULL, 1, dent=dent), reference=None)) == touched
