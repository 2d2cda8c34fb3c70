"""Every part by its name: how it is made, how it is built, where it goes."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

from build123d import Part

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.parts.base import sensor_base
from ninedtact.hardware.parts.bought import camera, led_board
from ninedtact.hardware.parts.gels import black_gel, translucent_gel, transparent_gel
from ninedtact.hardware.parts.moulds import base_board, first_mould, second_mould
from ninedtact.hardware.parts.pin_frame import calibration_board
from ninedtact.hardware.parts.ring import acrylic_window, isolation_ring
from ninedtact.hardware.parts.shell import sensor_shell

Way = Literal["printed", "cut", "cast", "bought"]


@dataclass(frozen=True)
class Made:
    """One part: its name, how it is made, and its builder."""

    name: str
    way: Way
    build: Callable[[HardwareDesign], Part]


CATALOGUE = (
    Made("sensor_base", "printed", sensor_base),
    Made("sensor_shell", "printed", sensor_shell),
    Made("isolation_ring", "printed", isolation_ring),
    Made("calibration_board", "printed", calibration_board),
    Made("acrylic_window", "cut", acrylic_window),
    Made("base_board", "cut", base_board),
    Made("first_mould", "cut", first_mould),
    Made("second_mould", "cut", second_mould),
    Made("transparent_gel", "cast", transparent_gel),
    Made("translucent_gel", "cast", translucent_gel),
    Made("black_gel", "cast", black_gel),
    Made("camera", "bought", camera),
    Made("led_board", "bought", led_board),
)
TO_MAKE = ("printed", "cut")
"""Ways of making that need files; gels come from moulds, bought parts from shops."""


@dataclass(frozen=True)
class BuiltPart:
    """One part of one design as a solid."""

    name: str
    way: Way
    solid: Part

    @property
    def size_mm(self) -> tuple[float, float, float]:
        """Of its box."""
        size = self.solid.bounding_box().size
        return float(size.X), float(size.Y), float(size.Z)

    @property
    def volume_mm3(self) -> float:
        """What it displaces."""
        return float(self.solid.volume)


def built(design: HardwareDesign) -> dict[str, BuiltPart]:
    """All of them by name. The design must be buildable: see `rules`."""
    return {part.name: part for part in parts_of(design)}


def parts_of(design: HardwareDesign) -> Iterator[BuiltPart]:
    """One after the other."""
    for made in CATALOGUE:
        yield BuiltPart(made.name, made.way, made.build(design))
