"""The catalogue of objects: the families of generated objects, and the indenter for every name that a person can give.

ball:4                          primitives with their dimensions in mm and degrees
gear_07                         generated objects, by family and number
part.stl, part.stl@in@+x        mesh files, with unit, side that faces the skin, scale (@0.5) or size to fit (@fit:16)

A new family is one entry in the table of `solids`, `machine_parts`, `lettering`, `surface_textures` or `household_objects`.
"""

import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from math import radians
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from ninedtact.bounds import checks_arguments
from ninedtact.errors import InputError
from ninedtact.mechanics.height_grid_indenter import HeightGridIndenter, indenter_from_heights
from ninedtact.mechanics.indenter import Ball, Cone, Ellipsoid, FlatPunch, Indenter, LyingCylinder
from ninedtact.simulation.objects.height_fields import CoordinateGrid, DimensionSampler, HeightfieldFunction
from ninedtact.simulation.objects.household_objects import HOUSEHOLD_OBJECTS
from ninedtact.simulation.objects.lettering import LETTERING
from ninedtact.simulation.objects.machine_parts import MACHINE_PARTS
from ninedtact.simulation.objects.mesh_objects import (
    MESH_FILE_SUFFIXES,
    MM_PER_UNIT,
    SIDES,
    MeshObject,
    MeshPlacement,
    load_mesh_object,
)
from ninedtact.simulation.objects.solids import PUNCHES, SOLIDS
from ninedtact.simulation.objects.surface_textures import PATTERNS, ROUGH_SURFACES

FAMILIES_BY_KIND: dict[str, dict[str, HeightfieldFunction]] = {
    "solids": SOLIDS,
    "punches": PUNCHES,
    "machine parts": MACHINE_PARTS,
    "lettering": LETTERING,
    "patterns": PATTERNS,
    "rough surfaces": ROUGH_SURFACES,
    "household objects": HOUSEHOLD_OBJECTS,
}

FAMILIES: dict[str, HeightfieldFunction] = {
    name: family for kind in FAMILIES_BY_KIND.values() for name, family in kind.items()
}
"""All families by name, in the order in which `generated_object_names` lists them; an object does not depend on the order."""


PAPER_COUNT = 175
"""Number of objects that the paper pressed (docs/references.md)."""
OBJECT_GRID = CoordinateGrid()


def generated_object_names(count: int = PAPER_COUNT) -> list[str]:
    """Return the first names: the first object of each family, then the second of each, and so on."""
    families = list(FAMILIES)
    return [f"{families[k % len(families)]}_{k // len(families) + 1:02d}" for k in range(count)]


def generate_objects(count: int = PAPER_COUNT, seed: int = 0) -> Iterator[HeightGridIndenter]:
    """Yield the first objects of a seed, each generated when it is needed."""
    return (generate_object(name, seed) for name in generated_object_names(count))


@lru_cache(maxsize=256)
@checks_arguments
def generate_object(name: str, seed: Annotated[int, Meta(ge=0)] = 0) -> HeightGridIndenter:
    """Return one generated object, for example the seventh gear of a seed for `gear_07`; raises `InputError`.

    An object does not depend on which other objects are generated.
    """
    found = re.fullmatch(r"([a-z_]+?)_?(\d{1,9})", name)
    if found is None or found[1] not in FAMILIES or int(found[2]) < 1:
        raise InputError(
            expected="a family and a number from 1, as gear_07",
            got=f"{name!r}",
            remedy=f"the families are {', '.join(FAMILIES)}",
        )
    heights = FAMILIES[found[1]](DimensionSampler(seed, found[1], int(found[2])), OBJECT_GRID)
    return indenter_from_heights(f"{found[1]}_{int(found[2]):02d}", OBJECT_GRID.smooth(heights), OBJECT_GRID.pitch_mm)


PRIMITIVES: dict[str, tuple[str, Callable[..., Indenter]]] = {
    "ball": ("RADIUS", Ball),
    "cylinder": ("RADIUS,LENGTH", LyingCylinder),
    "cone": ("SLOPE_DEG,TIP_RADIUS,BASE_RADIUS", lambda slope=30.0, *rest: Cone(radians(slope), *rest)),
    "punch": ("RADIUS,EDGE", FlatPunch),
    "ellipsoid": ("HALF_LENGTH,HALF_WIDTH,HALF_HEIGHT", Ellipsoid),
}


_LARGEST_MM = 1000.0
"""Largest dimension of a primitive."""


class MeshNotClosedWarning(UserWarning):
    """A warning for a mesh with holes: it is usable, but its inside may count where a hole faces the skin."""


@checks_arguments
def indenter_from_name(text: str, seed: Annotated[int, Meta(ge=0)] = 0) -> Indenter:
    """Return the indenter with this name; the seed is that of generated objects.

    Raises `InputError` with a list of what is accepted, or what the named kind of object raises.

    >>> ninedtact.indenter_from_name("ball:4").name, ninedtact.indenter_from_name("cylinder:3,11").name
    ('ball_8mm', 'cylinder_6x11mm')
    """
    kind, _, rest = text.partition(":")
    if kind in PRIMITIVES:
        return _primitive_from_name(kind, rest)
    if re.sub(r"_?\d+$", "", text) in FAMILIES:
        return generate_object(text, seed)
    path, *additions = _split_mesh_options(text)
    if Path(path).suffix.lower() in MESH_FILE_SUFFIXES:
        return _warn_if_not_closed(load_mesh_object(Path(path), _parse_mesh_placement(additions)))
    raise InputError(expected=f"{_accepted_names()}", got=f"{text!r}", remedy="give one of these")


def mesh_file_of_name(text: str) -> Path | None:
    """Return the mesh file that an object's name refers to; None for all other objects."""
    is_other = text.partition(":")[0] in PRIMITIVES or re.sub(r"_?\d+$", "", text) in FAMILIES
    path = Path(_split_mesh_options(text)[0])
    return path if not is_other and path.suffix.lower() in MESH_FILE_SUFFIXES else None


def _accepted_names() -> str:
    """Return one sentence about all names that are accepted."""
    solids = ", ".join(f"{kind}:{dimensions}" for kind, (dimensions, _) in PRIMITIVES.items())
    return (
        f"a solid ({solids}, in mm), a generated object (gear_07; families: {', '.join(FAMILIES)}) or a mesh file "
        f"({', '.join(MESH_FILE_SUFFIXES)}; part.stl@in@+x@fit:16)"
    )


def _primitive_from_name(kind: str, dimensions: str) -> Indenter:
    """Return a primitive; dimensions that are left out have the defaults of its class."""
    names, make = PRIMITIVES[kind]
    try:
        numbers = [float(number) for number in dimensions.split(",")] if dimensions else []
    except ValueError:
        numbers = [float("nan")]
    if len(numbers) > names.count(",") + 1 or not all(0 < number <= _LARGEST_MM for number in numbers):
        raise InputError(
            expected=f"{kind}:{names} with numbers above zero and at most {_LARGEST_MM:g}",
            got=f"{kind}:{dimensions}",
            remedy="correct it",
        )
    return make(*numbers)


def _split_mesh_options(text: str) -> list[str]:
    """Split a mesh name into its path, which may itself contain @, and its options."""
    parts = text.split("@")
    ends = [end for end in range(len(parts), 0, -1) if Path("@".join(parts[:end])).is_file()]
    end = ends[0] if ends else 1
    return ["@".join(parts[:end]), *parts[end:]]


def _parse_mesh_placement(additions: Sequence[str]) -> MeshPlacement:
    """Read unit, side, scale and size to fit, in any order."""
    placing = MeshPlacement()
    for addition in additions:
        if addition in SIDES:
            placing = replace(placing, side=addition)
        elif addition in MM_PER_UNIT:
            placing = replace(placing, unit=addition)
        elif fit := re.fullmatch(r"fit:(\d*\.?\d+)", addition):
            placing = replace(placing, fit_mm=float(fit[1]))
        elif re.fullmatch(r"\d*\.?\d+", addition):
            placing = replace(placing, scale=float(addition))
        else:
            raise InputError(
                expected=f"@unit ({', '.join(MM_PER_UNIT)}), @side ({', '.join(SIDES)}), @scale (@0.5) or @fit:MM "
                "after a mesh",
                got=f"@{addition}",
                remedy="correct it",
            )
    return placing


def _warn_if_not_closed(mesh: MeshObject) -> Indenter:
    """Return the underside of a mesh, with a warning where the mesh has holes."""
    if not mesh.closed:
        warnings.warn(
            f"{mesh.relief.name} is not closed: where a hole faces the skin, the inside of the mesh is used",
            MeshNotClosedWarning,
            stacklevel=3,
        )
    return mesh.relief
