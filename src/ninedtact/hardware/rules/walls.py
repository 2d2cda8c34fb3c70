"""Walls, posts and floors that a printer can make and that hold."""

from collections.abc import Iterator
from math import radians, sqrt, tan

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.rules.rule import Broken

THINNEST_MM = 0.8
"""Two lines of a 0.4 mm nozzle; nylon by laser sintering needs 0.7."""


def walls_too_thin(design: HardwareDesign) -> Iterator[Broken]:
    """Every wall below the thinnest."""
    for name, thick in walls(design):
        if thick < THINNEST_MM - 1e-9:
            yield Broken(
                "wall_too_thin", f"expected {name} of at least {THINNEST_MM:g} mm, got {thick:.2f} mm; make it thicker"
            )


def walls(design: HardwareDesign) -> Iterator[tuple[str, float]]:
    """Names and thicknesses."""
    shell, base = design.shell, design.base
    yield "shell.wall_mm", shell.wall_mm
    yield "shell.frame_wall_mm", shell.frame_wall_mm
    yield "the shell's corner beside the gel", corner_wall(design)
    yield "the screw bosses' wall (shell.boss_mm less shell.bore_mm, halved)", (shell.boss_mm - shell.bore_mm) / 2
    yield "the insert bosses' wall (base.boss_mm less base.bore_mm, halved)", (base.boss_mm - base.bore_mm) / 2
    yield "base.floor_mm", base.floor_mm
    yield "the base under its counterbores", base.plate_mm - base.counterbore_deep_mm
    yield "the ring's wall", (design.plan.ring_side - design.ring.bore_mm) / 2
    if shell.relief_deep_mm:
        yield "shell.relief_left_mm", shell.relief_left_mm


def ring_has_no_mouth(design: HardwareDesign) -> Iterator[Broken]:
    """The isolation ring's cone opens from its bore to its land, within its height."""
    ring, levels = design.ring, design.levels
    wider = (design.plan.ring_side - ring.bore_mm) / 2 - ring.land_mm
    deep, tall = wider / tan(radians(ring.cone_deg)), levels.floor_top - levels.ring_bottom
    if not 0 < deep < tall:
        yield Broken(
            "ring_has_no_mouth",
            f"expected a cone of more than zero and less than the ring's {tall:.2f} mm deep, got {deep:.2f} mm; change "
            "ring.land_mm, ring.bore_mm or ring.cone_deg",
        )


def corner_wall(design: HardwareDesign) -> float:
    """Thickness of the shell along the diagonal of a corner of the gel cavity."""
    shell, plan = design.shell, design.plan
    outer, inner = shell.corner_radius_mm, shell.opening_radius_mm
    apart = [(plan.outer[axis] / 2 - outer) - (plan.opening[axis] / 2 - inner) for axis in (0, 1)]
    return outer - inner + sqrt(2) * min(apart)
