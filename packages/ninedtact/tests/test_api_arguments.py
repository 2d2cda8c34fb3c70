"""The doors of the Python API: whatever a program passes by mistake is refused in one sentence that names the argument."""

import inspect
from abc import ABC
from collections.abc import Callable
from enum import Enum
from typing import Any, get_type_hints

import numpy as np
import pytest
from beartype import BeartypeConf
from beartype.door import is_bearable
from hypothesis import given
from hypothesis import strategies as st

import ninedtact
from ninedtact.bounds import _PublicNames
from ninedtact.errors import InputError

NUMBERS = BeartypeConf(is_pep484_tower=True)
WRONG = (None, "text", b"x", -1, object(), [1, 2], {}, np.zeros(0), np.zeros((3, 2, 5)))
METHODS = (
    *(
        ninedtact.HeightMap.points_at,
        ninedtact.Wrench.about,
        ninedtact.WrenchEstimate.about,
        ninedtact.Pose.interpolate,
    ),
    *(
        ninedtact.Reading.with_force,
        ninedtact.Reading.model_input,
        ninedtact.Reading.age_ms,
        ninedtact.Sensor.use_reference,
    ),
    *(ninedtact.SensorFolder.estimator, ninedtact.SensorFolder.stored_image, ninedtact.ScriptedPress.simulate),
    *(ninedtact.Twin.hover, ninedtact.Twin.press, ninedtact.Twin.with_noise_of),
)


def is_door(item: Any) -> bool:
    """Return whether programs call it with values of their own: not an interface, an enumeration or an error."""
    is_plain_class = inspect.isclass(item) and not issubclass(item, Enum | Exception) and ABC not in item.__bases__
    return inspect.isfunction(item) or (is_plain_class and not inspect.isabstract(item))


DOORS = [item for name in ninedtact.__all__ if is_door(item := getattr(ninedtact, name))]


def parameters() -> list[Any]:
    """Return every parameter of every door, with its type."""
    found = []
    for door in (*DOORS, *METHODS):
        function = door.__init__ if inspect.isclass(door) else door
        hints = get_type_hints(function, localns=_PublicNames(), include_extras=True)
        hints.pop("return", None)
        found += [pytest.param(door, name, hint, id=f"{door.__qualname__}-{name}") for name, hint in hints.items()]
    return found


@pytest.mark.parametrize(("door", "name", "hint"), parameters())
def test_an_argument_of_another_type_is_refused_in_one_sentence(door: Callable[..., Any], name: str, hint: Any) -> None:
    takes_list = "tuple" in str(hint)  # a list is taken for a tuple
    wrong = [
        value
        for value in WRONG
        if not is_bearable(value, hint, conf=NUMBERS) and not (takes_list and isinstance(value, list))
    ]
    assert wrong or hint is Any
    for value in wrong:
        with pytest.raises(InputError, match=rf"^expected {name} of \w+ to be .*, got .*; correct it$"):
            door(**{name: value})


@given(st.floats(max_value=0.0) | st.just(float("nan")))
def test_scales_times_and_steps_are_above_zero(value: float) -> None:
    flat = np.zeros((3, 4), np.float32)
    with pytest.raises(InputError, match=r"expected mm_per_px (of Rectified to be a number|above 0), got"):
        ninedtact.Rectified(flat, value)
    with pytest.raises(InputError, match=r"expected speed .*, got"):
        ninedtact.press_trajectory(ninedtact.Pose(depth_mm=0.5), speed=value)
    with pytest.raises(InputError, match=r"expected rate_hz .*, got"):
        ninedtact.CameraSettings(rate_hz=value)


@pytest.mark.parametrize("value", [-1, -1.0, np.float32(-1), np.int64(-1)])
def test_bounds_hold_for_every_kind_of_number_also_where_none_is_allowed(value: float) -> None:
    with pytest.raises(InputError, match=r"expected rate_hz above 0, got -1"):
        ninedtact.CameraSettings(rate_hz=value)


def test_numbers_of_numpy_are_numbers() -> None:
    frame = ninedtact.Frame(np.zeros((1, 1, 3), np.uint8), np.int64(5))
    assert (frame.stamp_ns, ninedtact.Pose(depth_mm=np.float32(0.5)).depth_mm) == (5, 0.5)


def test_axes_of_one_name_have_one_length() -> None:
    with pytest.raises(
        InputError, match=r"source of HeightMap to be UInt8.* \(axes of one name have one length\), got .* \(4, 3\)"
    ):
        ninedtact.HeightMap(np.zeros((3, 4), np.float32), np.zeros((4, 3), np.uint8), 0.05)
