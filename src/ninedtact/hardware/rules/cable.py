"""The way of the camera's flat cable out of the sensor."""

from collections.abc import Iterator
from math import atan2, hypot, tan

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.rules.rule import Broken


def ramp_has_no_room(design: HardwareDesign) -> Iterator[Broken]:
    """The ramp climbs outwards, behind the camera's pocket, and its two blends fit on it."""
    base = design.base
    run, rise = base.ramp_foot_mm - base.ramp_head_mm, design.levels.plate_top - base.ramp_gap_mm - base.floor_mm
    if min(run, rise) <= 0:
        yield Broken(
            "ramp_too_short",
            f"expected a ramp that climbs outwards, got {run:.2f} mm out and {rise:.2f} mm up; take base.ramp_foot_mm above "
            "base.ramp_head_mm, and a thicker base.plate_mm",
        )
        return
    # A blend of radius R at a bend by an angle begins R tan(angle / 2) before it.
    bend = tan(atan2(rise, run) / 2)
    blends, slope = bend * (base.ramp_foot_round_mm + base.ramp_head_round_mm), hypot(run, rise)
    if blends >= slope:
        yield Broken(
            "ramp_too_short",
            f"expected the ramp's slope of at least {blends:.2f} mm for its two blends, got {slope:.2f} mm; raise "
            "base.ramp_foot_mm, or lessen base.ramp_foot_round_mm",
        )
    before = design.plan.outer[1] / 2 - base.ramp_foot_mm - base.pocket_back_mm
    if before <= bend * base.ramp_foot_round_mm:
        yield Broken(
            "pocket_in_ramp",
            f"expected {bend * base.ramp_foot_round_mm:.2f} mm between the camera's pocket and the cable's ramp, got "
            f"{before:.2f} mm; lessen base.ramp_foot_mm",
        )
