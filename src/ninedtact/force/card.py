"""What a force model says about itself; it is kept in the model's own file."""

from typing import Any

from msgspec import Struct

from ninedtact.force.inputs import InputSettings
from ninedtact.force.likeness import Range

FORMAT = 1
"""Rises when an older program could no longer use the file."""
SixNumbers = tuple[float, float, float, float, float, float]


class TrainingSummary(Struct, frozen=True, forbid_unknown_fields=True):
    """Where a model comes from."""

    pairs: int
    validation_pairs: int
    objects: int
    sensors: int
    epochs: int
    best_epoch: int
    seconds: float
    settings: dict[str, Any]
    versions: dict[str, str]


class Card(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a user of the model must know."""

    format: int
    name: str
    network: str
    input: InputSettings
    about_mm: tuple[float, float, float]
    """The point that the graph's torques are about."""
    modulus_mpa: float
    """Shear modulus of the gel that the graph's wrench is for; the wrench grows in proportion to a sensor's."""
    lowest: SixNumbers
    highest: SixNumbers
    """Of the wrenches that it was trained with, about the skin's centre."""
    likeness: dict[str, Range]
    """Numbers of the images that it was trained with (`likeness.py`)."""
    training: TrainingSummary
    evaluation: dict[str, Any]
    """Tables of `Evaluation.as_table`, by the name of what was evaluated on."""
    licence: str
