"""Darker and brighter: signed, at any size, and the original project's channels to the last bit."""

import cv2
import numpy as np
import pytest
import torch

from ninedtact.errors import InputError
from ninedtact.force.brightness_channels import (
    ChannelLayout,
    DeformationBuilder,
    NotAMixedImage,
    compute_image_deformation,
    deformation_from_mixed_image,
    deformation_network_input,
    encode_mixed_image,
    split_darker_brighter,
    stack_deformation_channels,
    to_whole_grey_levels,
)
from ninedtact.quantities import Rectified

EVERY_PAIR = np.meshgrid(np.arange(256, dtype=np.uint8), np.arange(256, dtype=np.uint8))
"""Image and reference in which every grey level meets every other."""


def noise(seed: int, shape: tuple[int, int] = (345, 460), mm_per_px: float = 0.0522) -> Rectified:
    grey = np.random.default_rng(seed).normal(150, 20, shape).clip(0, 255)
    return Rectified(grey.astype(np.float32), mm_per_px)


def test_the_original_channels_are_those_of_a_float32_put_into_a_byte() -> None:
    image, reference = EVERY_PAIR
    made = encode_mixed_image(
        compute_image_deformation(to_whole_grey_levels(image, 0.05), to_whole_grey_levels(reference, 0.05))
    )
    change = reference.astype(np.float32) - image.astype(np.float32)
    expected = np.zeros((256, 256, 3), np.uint8)
    expected[:, :, 0] = reference
    # The original assigns numbers up to 765 to bytes and leaves the rest to the machine; this is such a machine.
    expected[:, :, 1] = np.maximum(-change, 0) * 3
    expected[:, :, 2] = np.maximum(change, 0) * 3
    assert made.dtype == np.uint8 and (made == expected).all()
    assert made[200, 100, 2] == 300 - 256, "three times 100 begins again at zero"


def test_what_the_original_channels_were_made_of_comes_back_exactly() -> None:
    image, reference = (to_whole_grey_levels(grey, 0.05) for grey in EVERY_PAIR)
    made = compute_image_deformation(image, reference)
    back = deformation_from_mixed_image(encode_mixed_image(made), 0.05, stamp_ns=7)
    for name in ("darker", "brighter", "reference"):
        assert (getattr(back, name) == getattr(made, name)).all()
    assert (back.mm_per_px, back.stamp_ns) == (0.05, 7)
    assert (back.reference - back.darker + back.brighter == image.grey).all()


def test_a_image_that_lost_bits_is_no_mixed_image() -> None:
    image, reference = (cv2.GaussianBlur(grey, (5, 5), 0) for grey in EVERY_PAIR)
    made = encode_mixed_image(
        compute_image_deformation(to_whole_grey_levels(image, 0.05), to_whole_grey_levels(reference, 0.05))
    )
    squeezed = cv2.imdecode(cv2.imencode(".jpg", made)[1], cv2.IMREAD_COLOR)
    with pytest.raises(NotAMixedImage, match=r"expected blue the reference.*got \d+\.\d% of the pixels.*give the PNG"):
        deformation_from_mixed_image(np.asarray(squeezed), 0.05)


@pytest.mark.parametrize("library", [np.asarray, torch.from_numpy])
def test_a_darkening_of_a_hundred_levels_is_one_even_between_bytes(library) -> None:
    image, reference = library(np.full((1, 2, 2), 60, np.uint8)), library(np.full((1, 2, 2), 160, np.uint8))
    darker, brighter = split_darker_brighter(image, reference)
    assert (darker == 100).all() and (brighter == 0).all()
    assert (split_darker_brighter(reference, image)[1] == 100).all()


@pytest.mark.parametrize("layout", ChannelLayout)
def test_a_batch_in_torch_is_what_one_live_image_is(layout: ChannelLayout) -> None:
    images, reference = np.stack([noise(seed).grey for seed in (1, 2)]), noise(0)
    live = [
        deformation_network_input(compute_image_deformation(Rectified(grey, 0.0522), reference), layout)
        for grey in images
    ]
    untouched = torch.from_numpy(reference.grey).expand(2, -1, -1)
    batch = stack_deformation_channels(*split_darker_brighter(torch.from_numpy(images), untouched), untouched, layout)
    assert batch.dtype == torch.float32 and batch.shape == (2, 3, 345, 460)
    assert (batch.numpy() == np.stack(live)).all()


def test_nothing_changed_is_exactly_nothing_at_every_size() -> None:
    for shape in (None, (120, 160), (60, 80), (690, 920)):
        same = compute_image_deformation(noise(0), noise(0), shape)
        assert not same.darker.any() and not same.brighter.any()


def test_results_share_no_memory() -> None:
    read = DeformationBuilder(noise(0), (120, 160))
    first = read(noise(1))
    first.reference[:] = first.darker[:] = 0
    assert read(noise(1)).reference.min() > 0 and read(noise(1)).darker.any()


def test_images_that_do_not_belong_together_are_refused() -> None:
    with pytest.raises(InputError, match=r"got 460 x 345 pixels at 0\.0522 and 40 x 30 pixels at 0\.0522"):
        compute_image_deformation(noise(1), noise(0, (30, 40)))
    with pytest.raises(InputError, match="take the reference from the same sensor"):
        compute_image_deformation(noise(1), noise(0, mm_per_px=0.06))
    with pytest.raises(InputError, match="got 224 x 224; ask for 224 x 168"):
        compute_image_deformation(noise(1), noise(0), (224, 224))
    with pytest.raises(InputError, match="got 0 x 0; ask for 1 x 1"):
        compute_image_deformation(noise(1), noise(0), (0, 0))
