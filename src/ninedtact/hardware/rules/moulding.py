"""What moulds, gels and screws need."""

from collections.abc import Iterator
from math import sqrt

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.rules.rule import Broken

THINNEST_PLATE_MM = 1.5
"""Half an M3 screw: a thinner acrylic plate bends or cracks between the clamps, and the gel runs out under it."""
THREAD_MM = 2.0
"""Least length of M2 thread that holds: its diameter."""

M3_NUT_MM = 6.4
"""Across its corners (ISO 4032: 6.01 at least)."""


def mould_too_thin_for_the_screws(design: HardwareDesign) -> Iterator[Broken]:
    """The first mould is as thick as the gel."""
    thick = design.sensor.gel.thickness_mm
    if thick < THINNEST_PLATE_MM:
        yield Broken(
            "mould_too_thin_for_the_screws",
            f"expected a mould of at least {THINNEST_PLATE_MM:g} mm between its M3 screws, got gel.thickness_mm {thick:g}; make "
            "the gel thicker",
        )


def screws_do_not_hold(design: HardwareDesign) -> Iterator[Broken]:
    """M2 screws through base and base board into the shell's inserts."""
    screw, deepest = design.fasteners.screw_mm, design.shell.bore_deep_mm
    for name, through in (
        ("the base", design.base.plate_mm - design.base.counterbore_deep_mm),
        ("the base board", design.moulds.base_mm),
    ):
        if not THREAD_MM <= screw - through <= deepest:
            yield Broken(
                "screws_do_not_hold",
                f"expected {THREAD_MM:g} to {deepest:g} mm of the screw above {name}, got {screw - through:.2f} mm; take another "
                "fasteners.screw_mm",
            )


def inserts_do_not_hold(design: HardwareDesign) -> Iterator[Broken]:
    """Their knurl melts into the bore and stays within the boss."""
    knurl, base, shell = design.fasteners.insert_mm[0], design.base, design.shell
    for name, bore, boss in (("base", base.bore_mm, base.boss_mm), ("shell", shell.bore_mm, shell.boss_mm)):
        if not bore < knurl < boss:
            yield Broken(
                "inserts_do_not_hold",
                f"expected inserts wider than {name}.bore_mm, {bore:g}, and narrower than {name}.boss_mm, {boss:g}, got "
                f"{knurl:g} mm; change fasteners.insert_mm or {name}.bore_mm",
            )


def gel_has_no_seat(design: HardwareDesign) -> Iterator[Broken]:
    """The pressed gel and its black coat must end on the shell's rim."""
    plan = design.plan
    if min(plan.outer[axis] - plan.black[axis] for axis in (0, 1)) < 0:
        yield Broken(
            "gel_beyond_the_shell",
            f"expected the black gel within the shell's {plan.outer[0]:g} x {plan.outer[1]:g} mm, got {plan.black[0]:g} x "
            f"{plan.black[1]:g} mm; thicken shell.wall_mm, or lessen sensing_area.overlap_mm or gels.black_side_mm",
        )


def tray_does_not_pass(design: HardwareDesign) -> Iterator[Broken]:
    """The calibration board over the shell's corners."""
    frame, shell = design.pin_frame, design.shell
    inside = max(frame.corner_radius_mm - frame.wall_mm, 0.0)
    room = frame.gap_mm - max(inside - shell.corner_radius_mm, 0.0) * (sqrt(2) - 1)
    if room < 0.05:
        yield Broken(
            "tray_does_not_pass",
            f"expected 0.05 mm between the calibration board's corners and the shell's, got {room:.2f} mm; lessen "
            "pin_frame.corner_radius_mm",
        )


def clamps_in_the_shell(design: HardwareDesign) -> Iterator[Broken]:
    """The M3 screws that hold the moulds stand beside the shell, their nuts too."""
    (wide, deep), room = design.plan.outer, M3_NUT_MM / 2
    for x, y in design.plan.clamps:
        if abs(x) < wide / 2 + room and abs(y) < deep / 2 + room:
            yield Broken(
                "clamps_in_the_shell",
                f"expected the moulds' screws {room:.2f} mm beside the shell, got one at ({x:g}, {y:g}) mm; raise "
                "moulds.beyond_mm",
            )
            return
