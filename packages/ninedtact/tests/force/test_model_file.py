"""A force model says all about itself, and what is none is refused in one sentence."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from linear_model import SMALL, a_card, linear_model, written
from onnx import helper

from ninedtact.force.network_input import NetworkInputSettings
from ninedtact.force.onnx_model import (
    CHECKSUM_METADATA_KEY,
    CHECKSUM_PLACEHOLDER,
    METADATA_KEY,
    ForceModelUnusable,
    ModelCard,
    parse_force_model,
    read_force_model,
    stamp_checksum,
)


def test_a_card_comes_back_as_it_was_and_the_graph_answers_any_number_of_images(tmp_path: Path) -> None:
    per_input = np.random.default_rng(0).normal(size=(48, 6))
    model = read_force_model(written(tmp_path / "model.onnx", linear_model(a_card(), per_input, np.arange(1, 7))))
    assert model.card == a_card()
    inputs = np.random.default_rng(1).normal(size=(5, *SMALL.shape)).astype(np.float32)
    found = model(inputs)
    np.testing.assert_allclose(found.wrench, inputs.reshape(5, -1) @ per_input, atol=1e-4)
    np.testing.assert_array_equal(found.scale, np.tile(np.arange(1.0, 7.0), (5, 1)))


def told(content: bytes) -> str:
    with pytest.raises(ForceModelUnusable) as refusal:
        parse_force_model(content, "some.onnx")
    sentence = str(refusal.value)
    assert "some.onnx" in sentence and sentence.startswith("expected") and "\n" not in sentence
    return sentence


def test_a_model_cut_off_anywhere_is_refused() -> None:
    content = linear_model(a_card()).SerializeToString()
    for part in (0.0, 0.1, 0.5, 0.9, 0.999):
        told(content[: int(part * len(content))])
    told(content[:-1])


def with_card(card: ModelCard | bytes) -> bytes:
    model = linear_model(a_card(), keyed=False)
    text = card if isinstance(card, bytes) else msgspec.json.encode(card)
    helper.set_model_props(model, {METADATA_KEY: text.decode(), "note": "of somebody"})
    return model.SerializeToString()


def test_what_is_another_thing_is_refused() -> None:
    assert "whole ONNX" in told(b"this is no model")
    assert "readable text" in told(with_card(a_card()).replace(b"of somebody", b"of\xf1somebody"))
    assert "without its card" in told(linear_model(a_card(), keyed=False).SerializeToString())
    assert "format 1" in told(with_card(msgspec.structs.replace(a_card(), format=1)))
    assert "(1, 60, 80)" in told(
        with_card(msgspec.structs.replace(a_card(), input=NetworkInputSettings(SMALL.channels)))
    )
    other_order = msgspec.json.encode(a_card()).replace(b"height / gel thickness", b"thickness / height")
    assert "thickness / height" in told(with_card(other_order))
    assert "card" in told(with_card(b"[1, 2]")) and "card" in told(with_card(b'{"format": 2}'))


def test_a_network_with_weights_that_are_no_numbers_is_refused() -> None:
    per_input = np.full((48, 6), np.nan)
    assert "not a number" in told(linear_model(a_card(), per_input).SerializeToString())


def test_an_edited_model_runs_with_a_notice() -> None:
    model = linear_model(a_card())
    assert (
        "edited or damaged" in parse_force_model(model.SerializeToString(), "old.onnx").notices[0]
    )  # without a checksum
    model.metadata_props.add(key=CHECKSUM_METADATA_KEY, value=CHECKSUM_PLACEHOLDER)
    content = stamp_checksum(model.SerializeToString())
    assert parse_force_model(content, "own.onnx").notices == ()
    edited = content.replace(b'"modulus_mpa":0.093', b'"modulus_mpa":0.083')
    assert edited != content and "other.onnx was edited" in parse_force_model(edited, "other.onnx").notices[0]


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (b'"modulus_mpa":0.093', b'"modulus_mpa":1e9', r"modulus_mpa = 1000000000.0 \(Expected `float` <= 3.0\)"),
        (b'"wrench_min":[-9.0', b'"wrench_min":[9.5', "wrench_min from 9.5 to 9, a range that falls"),
        (
            b'"max_indentation":[0.0,0.1',
            b'"max_indentation":[0.0,1e300',
            r"input_ranges.max_indentation\[1\] = 1e\+300",
        ),
    ],
)
def test_a_number_of_the_card_beyond_its_bounds_is_refused_by_name(old: bytes, new: bytes, sentence: str) -> None:
    card = msgspec.json.encode(a_card())
    assert old in card
    with pytest.raises(ForceModelUnusable, match=sentence):
        parse_force_model(with_card(card.replace(old, new)), "some.onnx")
