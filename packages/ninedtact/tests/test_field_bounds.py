"""Bounds beside a field: an object and a file are refused for the same values."""

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import pytest
from msgspec import Meta, ValidationError

from ninedtact.bounds import require_within_bounds
from ninedtact.checked_reading import convert_tables_to_class
from ninedtact.errors import InputError

_Weight = Annotated[float, Meta(ge=0, le=1)]


@dataclass(frozen=True)
class Settings:
    """Every kind of declaration."""

    length_mm: Annotated[float, Meta(gt=0, lt=10)] = 1.0
    count: Annotated[int, Meta(ge=1)] = 1
    weights: tuple[_Weight, ...] = (0.0, 1.0)
    method: Literal["physics", "ratio"] = "physics"
    range_n: tuple[_Weight, _Weight] | None = None
    delay_ms: Annotated[float, Meta(ge=-1000, le=5000)] | Literal["saved"] = 0.0
    name: str = ""


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("length_mm", 0.0),
        ("length_mm", 10.0),
        ("length_mm", math.nan),
        ("count", 0),
        ("weights", (0.5, 1.5)),
        ("method", "paper"),
        ("range_n", (0.0, math.inf)),
        ("delay_ms", 5001.0),
        ("delay_ms", "kept"),
    ],
)
def test_an_object_and_a_file_are_refused_for_the_same_values(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=rf"expected press.{name} .*, got .*; correct it"):
        require_within_bounds(Settings(**{name: value}), "press")
    with pytest.raises(ValidationError, match=name):
        convert_tables_to_class({name: value}, Settings)


@pytest.mark.parametrize(
    "values",
    [{}, {"delay_ms": "saved"}, {"delay_ms": -1000}, {"range_n": (0, 1)}, {"length_mm": 9.99}, {"weights": ()}],
)
def test_values_within_bounds_are_taken_by_both(values: dict[str, Any]) -> None:
    require_within_bounds(Settings(**values))
    assert convert_tables_to_class(values, Settings) == Settings(**values)
