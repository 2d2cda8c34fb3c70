"""Parts that must not stand in each other's way."""

from collections.abc import Iterator
from itertools import product
from math import hypot

from ninedtact.hardware.clearances import clearances
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.plan import Pair
from ninedtact.hardware.rules.rule import Broken

ORIGINAL_OVERLAP_MM = -0.1
"""The camera's stiffener in the original's pocket: it was built so, the corner gives way."""


def parts_touch(design: HardwareDesign) -> Iterator[Broken]:
    """Pairs that overlap; what is only tight is told by `hardware check`."""
    for room in clearances(design):
        allowed = ORIGINAL_OVERLAP_MM if room.between.startswith(("camera stiffener", "plug's")) else 0.0
        if room.mm < allowed - 1e-9 and not room.between.startswith("plug's"):
            name = "led_touches_shell" if room.between.startswith("LED top") else "parts_touch"
            yield Broken(
                name, f"expected room between {room.between}, got {room.mm:.2f} mm; move or shrink one of them"
            )


def bosses_collide(design: HardwareDesign) -> Iterator[Broken]:
    """Bosses, posts and the camera's pocket, seen from above."""
    for (name, place, radius), (other, beside, reach) in product(inner_bosses(design), outer_bosses(design)):
        room = hypot(place[0] - beside[0], place[1] - beside[1]) - radius - reach
        if room < 0:
            yield Broken(
                "bosses_collide", f"expected {name} clear of {other}, got {room:.2f} mm; change base.mount_inset_mm"
            )
            break
    yield from mounts_misplaced(design)


def inner_bosses(design: HardwareDesign) -> Iterator[tuple[str, Pair, float]]:
    """Of the base: inserts for the robot."""
    for place in design.plan.mount_inserts:
        yield "an insert boss of the base", place, design.base.boss_mm / 2


def outer_bosses(design: HardwareDesign) -> Iterator[tuple[str, Pair, float]]:
    """Round them: posts and screws."""
    for place in design.plan.posts:
        yield "a locating post", place, design.base.post_mm / 2
    for place in design.plan.shell_screws:
        yield "a screw boss of the shell", place, design.shell.boss_mm / 2


def mounts_misplaced(design: HardwareDesign) -> Iterator[Broken]:
    """Insert bosses in the pocket, under the receptacle or in the shell's wall; a ramp in the pocket."""
    base, radius, (x, y) = design.base, design.base.boss_mm / 2, max(design.plan.mount_inserts)
    inside = max(base.pocket_wide_mm, design.board.usb_mm[0]) / 2 + 0.5
    if x - radius < inside:
        yield Broken(
            "mount_in_pocket",
            f"expected the insert bosses beyond {inside:.2f} mm from the middle, got {x - radius:.2f} mm; lessen "
            "base.mount_inset_mm",
        )
    if x + radius > design.plan.cavity[0] / 2 or y + radius > design.plan.cavity[1] / 2:
        yield Broken(
            "mount_in_wall",
            f"expected the insert bosses within the shell's cavity, got them at ({x:g}, {y:g}) mm; enlarge base.mount_inset_mm",
        )
    if base.pocket_back_mm > design.plan.outer[1] / 2 - base.ramp_foot_mm:
        yield Broken(
            "pocket_in_ramp", "expected the cable's ramp behind the camera's pocket, got it inside; move it out"
        )


def usb_slot_misplaced(design: HardwareDesign) -> Iterator[Broken]:
    """A slot that the receptacle does not reach into, or that cuts the shell's floor."""
    shell, levels, board = design.shell, design.levels, design.board
    if shell.slot_wide_mm < board.usb_mm[0]:
        yield Broken(
            "usb_slot",
            f"expected shell.slot_wide_mm of at least {board.usb_mm[0]:g}, got {shell.slot_wide_mm:g}; widen it",
        )
    if not levels.board_bottom <= levels.plate_top + shell.slot_to_mm <= levels.ceiling - 0.3:
        yield Broken(
            "usb_slot",
            f"expected shell.slot_to_mm above the receptacle and 0.3 mm below the shell's floor, got {shell.slot_to_mm:g}; "
            "correct it",
        )
