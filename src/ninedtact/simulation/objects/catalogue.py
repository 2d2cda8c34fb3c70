"""All families of generated objects by name.

Object k of a seed: the same whichever others are asked for.

What a person types → an object.

ball:4                          simple solids with their dimensions in mm and degrees
gear_07                         generated objects, by family and number
part.stl, part.stl@in@+x        mesh files, with unit, side that faces the skin, scale (@0.5) or size to fit (@fit:16)
thingi10k:32770                 models of Thingi10K, with the same additions; made to fit 16 mm
"""

import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from math import isfinite, radians
from pathlib import Path

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.height_grid_indenter import HeightGridIndenter, indenter_from_heights
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.indenter_primitives import Ball, Cone, Cylinder, Ellipsoid, FlatPunch
from ninedtact.simulation.objects.height_grid import DimensionSampler, HeightfieldFunction, HeightGrid
from ninedtact.simulation.objects.household_objects import HOUSEHOLD_OBJECTS
from ninedtact.simulation.objects.lettering import LETTERING
from ninedtact.simulation.objects.machine_parts import MACHINE_PARTS
from ninedtact.simulation.objects.mesh_objects import (
    FITTING,
    MESH_FILE_SUFFIXES,
    MM_PER_UNIT,
    SIDES,
    MeshObject,
    MeshPlacement,
    load_mesh_object,
    load_thingi10k_object,
)
from ninedtact.simulation.objects.punches import PUNCHES
from ninedtact.simulation.objects.solids import SOLIDS
from ninedtact.simulation.objects.surface_textures import PATTERNS, ROUGH_SURFACES

FAMILIES_BY_KIND: dict[str, dict[str, HeightfieldFunction]] = {
    "solids": SOLIDS,
    "punches": PUNCHES,
    "machine parts": MACHINE_PARTS,
    "lettering": LETTERING,
    "patterns": PATTERNS,
    "rough surfaces": ROUGH_SURFACES,
    "things": HOUSEHOLD_OBJECTS,
}

FAMILIES: dict[str, HeightfieldFunction] = {
    name: family for kind in FAMILIES_BY_KIND.values() for name, family in kind.items()
}
"""In the order in which objects are counted out; an object does not depend on it."""


PAPER_COUNT = 175
"""Objects that the paper pressed (docs/references.md)."""
OBJECT_GRID = HeightGrid()


class UnknownObject(NinedtactError):
    """No object goes by this name."""


def generated_object_names(count: int = PAPER_COUNT) -> list[str]:
    """The first names: one of each family, then the second of each, and so on."""
    families = list(FAMILIES)
    return [f"{families[k % len(families)]}_{k // len(families) + 1:02d}" for k in range(count)]


def generate_objects(count: int = PAPER_COUNT, seed: int = 0) -> Iterator[HeightGridIndenter]:
    """The first objects of a seed, each made when its turn comes."""
    return (generate_object(name, seed) for name in generated_object_names(count))


@lru_cache(maxsize=256)
def generate_object(name: str, seed: int = 0) -> HeightGridIndenter:
    """`gear_07`: the seventh gear of this seed; raises `UnknownObject`."""
    found = re.fullmatch(r"([a-z_]+?)_?(\d+)", name)
    if found is None or found[1] not in FAMILIES or int(found[2]) < 1:
        raise UnknownObject(
            f"expected a family and a number from 1, as gear_07, got {name!r}; the families are {', '.join(FAMILIES)}"
        )
    heights = FAMILIES[found[1]](DimensionSampler(seed, found[1], int(found[2])), OBJECT_GRID)
    return indenter_from_heights(f"{found[1]}_{int(found[2]):02d}", OBJECT_GRID.smooth(heights), OBJECT_GRID.pitch_mm)


PRIMITIVES: dict[str, tuple[str, Callable[..., Indenter]]] = {
    "ball": ("RADIUS", Ball),
    "cylinder": ("RADIUS,LENGTH", Cylinder),
    "cone": ("SLOPE_DEG,TIP_RADIUS,BASE_RADIUS", lambda slope=30.0, *rest: Cone(radians(slope), *rest)),
    "punch": ("RADIUS,EDGE", FlatPunch),
    "ellipsoid": ("HALF_LENGTH,HALF_WIDTH,HALF_HEIGHT", Ellipsoid),
}


class MeshNotClosed(UserWarning):
    """A mesh with holes: usable, but an inside may show where a hole looks down."""


def indenter_from_name(text: str, seed: int = 0) -> Indenter:
    """The object that this names; the seed is that of generated objects.

    Raises `UnknownObject` with a list of what is accepted, or what the named kind of object raises.
    """
    kind, _, rest = text.partition(":")
    if kind in PRIMITIVES:
        return _primitive_from_name(kind, rest)
    if kind == "thingi10k" and (number := re.match(r"\d+", rest)):
        return _warn_if_not_closed(
            load_thingi10k_object(int(number[0]), _parse_mesh_placement(rest[number.end() :].split("@")[1:], FITTING))
        )
    if re.sub(r"_?\d+$", "", text) in FAMILIES:
        return generate_object(text, seed)
    path, *additions = _split_mesh_options(text)
    if Path(path).suffix.lower() in MESH_FILE_SUFFIXES:
        return _warn_if_not_closed(load_mesh_object(Path(path), _parse_mesh_placement(additions, MeshPlacement())))
    raise UnknownObject(f"expected {_accepted_names()}, got {text!r}; give one of these")


def _accepted_names() -> str:
    """All that can be named, in one sentence."""
    solids = ", ".join(f"{kind}:{dimensions}" for kind, (dimensions, _) in PRIMITIVES.items())
    return (
        f"a solid ({solids}, in mm), a generated object (gear_07; families: {', '.join(FAMILIES)}), a mesh file "
        f"({', '.join(MESH_FILE_SUFFIXES)}; part.stl@in@+x@fit:16) or thingi10k:NUMBER"
    )


def _primitive_from_name(kind: str, dimensions: str) -> Indenter:
    """A simple solid; dimensions that are left out are those of its class."""
    names, make = PRIMITIVES[kind]
    try:
        numbers = [float(number) for number in dimensions.split(",")] if dimensions else []
    except ValueError:
        numbers = [float("nan")]
    if len(numbers) > names.count(",") + 1 or not all(isfinite(number) and number > 0 for number in numbers):
        raise UnknownObject(f"expected {kind}:{names} with numbers above zero, got {kind}:{dimensions}; correct it")
    return make(*numbers)


def _split_mesh_options(text: str) -> list[str]:
    """A path, which may itself contain @, and what is added to it."""
    parts = text.split("@")
    ends = [end for end in range(len(parts), 0, -1) if Path("@".join(parts[:end])).is_file()]
    end = ends[0] if ends else 1
    return ["@".join(parts[:end]), *parts[end:]]


def _parse_mesh_placement(additions: Sequence[str], start: MeshPlacement) -> MeshPlacement:
    """Unit, side, scale and size to fit, in any order; a unit or a scale takes back the fit that was the start."""
    placing = start
    for addition in additions:
        if addition in SIDES:
            placing = replace(placing, side=addition)
        elif addition in MM_PER_UNIT:
            placing = replace(placing, unit=addition, fit_mm=_drop_default_fit(start.fit_mm, placing.fit_mm))
        elif fit := re.fullmatch(r"fit:(\d*\.?\d+)", addition):
            placing = replace(placing, fit_mm=float(fit[1]))
        elif re.fullmatch(r"\d*\.?\d+", addition):
            placing = replace(placing, scale=float(addition), fit_mm=_drop_default_fit(start.fit_mm, placing.fit_mm))
        else:
            raise UnknownObject(
                f"expected @unit ({', '.join(MM_PER_UNIT)}), @side ({', '.join(SIDES)}), @scale (@0.5) or @fit:MM after a mesh, "
                f"got @{addition}; correct it"
            )
    return placing


def _drop_default_fit(start: float | None, now: float | None) -> float | None:
    """The present value, but none if it is only the one from the start."""
    return None if now == start else now


def _warn_if_not_closed(mesh: MeshObject) -> Indenter:
    """The underside of a mesh; that the mesh has holes is said."""
    if not mesh.closed:
        warnings.warn(
            f"{mesh.relief.name} is not closed: where a hole looks down, its inside is taken",
            MeshNotClosed,
            stacklevel=3,
        )
    return mesh.relief
