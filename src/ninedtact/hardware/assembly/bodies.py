"""All bodies of the finished sensor, placed."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from build123d import Part

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.materials import MADE_OF, Material
from ninedtact.hardware.parts.bought import insert, screw
from ninedtact.hardware.parts.catalogue import BuiltPart, built

IN_THE_SENSOR = (
    "sensor_base",
    "camera",
    "led_board",
    "isolation_ring",
    "sensor_shell",
    "acrylic_window",
    "transparent_gel",
    "translucent_gel",
    "black_gel",
)
"""From below; tools (moulds, calibration board) are not in it."""


@dataclass(frozen=True)
class Body:
    """One body at its place."""

    name: str
    solid: Part
    material: Material

    @property
    def mass_g(self) -> float:
        """By its volume and its material's density."""
        return float(self.solid.volume) / 1000 * self.material.g_per_cm3


def bodies(design: HardwareDesign, parts: Mapping[str, BuiltPart] | None = None) -> list[Body]:
    """Parts are built where they belong; fasteners are placed. parts: those built already."""
    parts = built(design) if parts is None else parts
    placed = [Body(name, parts[name].solid, MADE_OF[name]) for name in IN_THE_SENSOR]
    return [*placed, *fasteners(design)]


def fasteners(design: HardwareDesign) -> Iterator[Body]:
    """Inserts and screws, each a body of its own."""
    plan, levels = design.plan, design.levels
    long = design.fasteners.insert_mm[1]
    inserts = [insert(design, place, levels.boss_top) for place in plan.mount_inserts]
    inserts += [insert(design, place, levels.plate_top + long) for place in plan.shell_screws]
    yield from numbered("insert", inserts)
    yield from numbered("screw", (screw(design, place) for place in plan.shell_screws))


def numbered(name: str, solids: Iterable[Part]) -> Iterator[Body]:
    """`insert_1`, `insert_2` and so on."""
    for number, solid in enumerate(solids, start=1):
        yield Body(f"{name}_{number}", solid, MADE_OF[name])
