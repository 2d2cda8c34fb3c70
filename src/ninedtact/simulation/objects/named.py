"""What a person types → an object.

ball:4                          simple solids with their dimensions in mm and degrees
gear_07                         generated objects, by family and number
part.stl, part.stl@in@+x        mesh files, with unit, side that faces the skin, scale (@0.5) or size to fit (@fit:16)
thingi10k:32770                 models of Thingi10K, with the same additions; made to fit 16 mm
"""

import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import isfinite, radians
from pathlib import Path

from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.indenter_primitives import Ball, Cone, Cylinder, Ellipsoid, FlatPunch
from ninedtact.simulation.objects.families import FAMILIES
from ninedtact.simulation.objects.generated import ObjectUnknown, object_named
from ninedtact.simulation.objects.mesh import MM_PER_UNIT, SIDES, MeshObject, Placing
from ninedtact.simulation.objects.mesh_file import ENDINGS, load_mesh
from ninedtact.simulation.objects.thingi import FITTING, thingi_object

SIMPLE: dict[str, tuple[str, Callable[..., Indenter]]] = {
    "ball": ("RADIUS", Ball),
    "cylinder": ("RADIUS,LENGTH", Cylinder),
    "cone": ("SLOPE_DEG,TIP_RADIUS,BASE_RADIUS", lambda slope=30.0, *rest: Cone(radians(slope), *rest)),
    "punch": ("RADIUS,EDGE", FlatPunch),
    "ellipsoid": ("HALF_LENGTH,HALF_WIDTH,HALF_HEIGHT", Ellipsoid),
}


class MeshNotClosed(UserWarning):
    """A mesh with holes: usable, but an inside may show where a hole looks down."""


def object_for(text: str, seed: int = 0) -> Indenter:
    """The object that this names; the seed is that of generated objects.

    Raises `ObjectUnknown` with a list of what is accepted, or what the named kind of object raises.
    """
    kind, _, rest = text.partition(":")
    if kind in SIMPLE:
        return simple(kind, rest)
    if kind == "thingi10k" and (number := re.match(r"\d+", rest)):
        return told(thingi_object(int(number[0]), placing_of(rest[number.end() :].split("@")[1:], FITTING)))
    if re.sub(r"_?\d+$", "", text) in FAMILIES:
        return object_named(text, seed)
    path, *additions = parts_of(text)
    if Path(path).suffix.lower() in ENDINGS:
        return told(load_mesh(Path(path), placing_of(additions, Placing())))
    raise ObjectUnknown(f"expected {accepted()}, got {text!r}; give one of these")


def accepted() -> str:
    """All that can be named, in one sentence."""
    solids = ", ".join(f"{kind}:{dimensions}" for kind, (dimensions, _) in SIMPLE.items())
    return (
        f"a solid ({solids}, in mm), a generated object (gear_07; families: {', '.join(FAMILIES)}), a mesh file "
        f"({', '.join(ENDINGS)}; part.stl@in@+x@fit:16) or thingi10k:NUMBER"
    )


def simple(kind: str, dimensions: str) -> Indenter:
    """A simple solid; dimensions that are left out are those of its class."""
    names, make = SIMPLE[kind]
    try:
        numbers = [float(number) for number in dimensions.split(",")] if dimensions else []
    except ValueError:
        numbers = [float("nan")]
    if len(numbers) > names.count(",") + 1 or not all(isfinite(number) and number > 0 for number in numbers):
        raise ObjectUnknown(f"expected {kind}:{names} with numbers above zero, got {kind}:{dimensions}; correct it")
    return make(*numbers)


def parts_of(text: str) -> list[str]:
    """A path, which may itself contain @, and what is added to it."""
    parts = text.split("@")
    ends = [end for end in range(len(parts), 0, -1) if Path("@".join(parts[:end])).is_file()]
    end = ends[0] if ends else 1
    return ["@".join(parts[:end]), *parts[end:]]


def placing_of(additions: Sequence[str], start: Placing) -> Placing:
    """Unit, side, scale and size to fit, in any order; a unit or a scale takes back the fit that was the start."""
    placing = start
    for addition in additions:
        if addition in SIDES:
            placing = replace(placing, side=addition)
        elif addition in MM_PER_UNIT:
            placing = replace(placing, unit=addition, fit_mm=unless(start.fit_mm, placing.fit_mm))
        elif fit := re.fullmatch(r"fit:(\d*\.?\d+)", addition):
            placing = replace(placing, fit_mm=float(fit[1]))
        elif re.fullmatch(r"\d*\.?\d+", addition):
            placing = replace(placing, scale=float(addition), fit_mm=unless(start.fit_mm, placing.fit_mm))
        else:
            raise ObjectUnknown(
                f"expected @unit ({', '.join(MM_PER_UNIT)}), @side ({', '.join(SIDES)}), @scale (@0.5) or @fit:MM after a mesh, "
                f"got @{addition}; correct it"
            )
    return placing


def unless(start: float | None, now: float | None) -> float | None:
    """The present value, but none if it is only the one from the start."""
    return None if now == start else now


def told(mesh: MeshObject) -> Indenter:
    """The underside of a mesh; that the mesh has holes is said."""
    if not mesh.closed:
        warnings.warn(
            f"{mesh.relief.name} is not closed: where a hole looks down, its inside is taken",
            MeshNotClosed,
            stacklevel=3,
        )
    return mesh.relief
