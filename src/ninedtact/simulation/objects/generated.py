"""Object k of a seed: the same whichever others are asked for."""

import re
from collections.abc import Iterator
from functools import lru_cache

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.height_grid_indenter import HeightGridIndenter, indenter_from_heights
from ninedtact.simulation.objects.families import FAMILIES
from ninedtact.simulation.objects.sheet import Draw, Sheet

PAPER_COUNT = 175
"""Objects that the paper pressed (docs/references.md)."""
SHEET = Sheet()


class ObjectUnknown(NinedtactError):
    """No object goes by this name."""


def object_names(count: int = PAPER_COUNT) -> list[str]:
    """The first names: one of each family, then the second of each, and so on."""
    families = list(FAMILIES)
    return [f"{families[k % len(families)]}_{k // len(families) + 1:02d}" for k in range(count)]


def objects(count: int = PAPER_COUNT, seed: int = 0) -> Iterator[HeightGridIndenter]:
    """The first objects of a seed, each made when its turn comes."""
    return (object_named(name, seed) for name in object_names(count))


@lru_cache(maxsize=256)
def object_named(name: str, seed: int = 0) -> HeightGridIndenter:
    """`gear_07`: the seventh gear of this seed; raises `ObjectUnknown`."""
    found = re.fullmatch(r"([a-z_]+?)_?(\d+)", name)
    if found is None or found[1] not in FAMILIES or int(found[2]) < 1:
        raise ObjectUnknown(
            f"expected a family and a number from 1, as gear_07, got {name!r}; the families are {', '.join(FAMILIES)}"
        )
    heights = FAMILIES[found[1]](Draw(seed, found[1], int(found[2])), SHEET)
    return indenter_from_heights(f"{found[1]}_{int(found[2]):02d}", SHEET.smooth(heights), SHEET.pitch_mm)
