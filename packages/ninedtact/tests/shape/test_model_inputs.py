"""Inputs of published models: numbers that their own code gives, worked out by hand; and pairs that do not fit are refused."""

from dataclasses import replace

import numpy as np
import pytest

from ninedtact.errors import InputError
from ninedtact.quantities import Rectified
from ninedtact.shape.model_inputs import prepare_model_input

MS = 1_000_000
REFERENCE = Rectified(np.full((345, 460), 100, np.float32), 0.0522)
DARK = replace(REFERENCE, grey=np.full((345, 460), 49, np.float32), stamp_ns=200 * MS)
"""51 levels darker, which is 0.2."""


def test_sparsh_takes_the_present_image_and_then_the_earlier_one_as_differences_about_one_half() -> None:
    corner = DARK.grey.copy()
    corner[:100, :100] = 100
    now, before = replace(DARK, grey=corner), replace(REFERENCE, stamp_ns=117 * MS)
    found = prepare_model_input("sparsh", now, REFERENCE, before)
    assert found.shape == (6, 320, 240) and found.dtype == np.float32
    assert (found[3:] == np.float32(127 / 255)).all(), "(0 + 0.5) of 255, cut to whole levels"
    assert found[0, -1, 0] == np.float32(76 / 255) and (found[0] == found[2]).all()
    assert found[0, 0, -1] == np.float32(127 / 255), "turned clockwise, the upper left corner is the upper right one"


def test_htt_takes_the_image_before_first_over_the_deviations_of_its_pretraining_stretched_to_a_square() -> None:
    half = DARK.grey.copy()
    half[:, 230:] = 100
    found = prepare_model_input("htt", replace(DARK, grey=half), REFERENCE, replace(REFERENCE, stamp_ns=167 * MS))
    assert found.shape == (2, 3, 224, 224) and found.dtype == np.float32
    assert not found[0].any() and not found[1, :, :, 112:].any()
    expected = -0.2 / np.array([0.0111722, 0.0102013, 0.0094375])
    for row in (0, 223):
        assert found[1, :, row, 0] == pytest.approx(expected, rel=1e-4) == found[1, :, row, 111]
    again = prepare_model_input("htt", DARK, REFERENCE, None)
    assert (again[0] == again[1]).all() and again[1].any()


def test_anytouch_takes_one_image_as_imagenet_does() -> None:
    found = prepare_model_input("anytouch", DARK, REFERENCE, None)
    assert found.shape == (3, 224, 224)
    assert found[:, 0, 0] == pytest.approx(
        (49 / 255 - np.array([0.485, 0.456, 0.406])) / [0.229, 0.224, 0.225], rel=1e-5
    )


@pytest.mark.usefixtures("without_type_checks")
@pytest.mark.parametrize(
    ("model", "earlier_ms", "sentence"),
    [
        ("sparsh", 183, "83 ± 25 ms earlier for sparsh, got one 17 ms earlier"),
        ("htt", 233, "the image before for htt, got one 33 ms later"),
        ("anytouch", 167, "no earlier image"),
    ],
)
def test_what_is_no_pair_of_the_model_is_refused(model: str, earlier_ms: int, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        prepare_model_input(model, DARK, REFERENCE, replace(DARK, stamp_ns=earlier_ms * MS))  # type: ignore[arg-type]
