"""Parts that must not stand in each other's way."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, product
from math import hypot

from ninedtact.hardware.clearances import clearances
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.plan import Pair
from ninedtact.hardware.rules.rule import Broken


@dataclass(frozen=True)
class Upright:
    """Four of a kind that stand on the base or hang down to it."""

    name: str
    places: tuple[Pair, ...]
    radius_mm: float
    set_by: str
    """The dimension that places them."""


def parts_touch(design: HardwareDesign) -> Iterator[Broken]:
    """Pairs that overlap; what is only tight is told by `hardware check`."""
    for room in clearances(design):
        if room.impossible:
            yield Broken(
                room.rule, f"expected room between {room.between}, got {room.mm:.2f} mm; change {room.mended_by}"
            )


def bosses_collide(design: HardwareDesign) -> Iterator[Broken]:
    """Bosses and posts, seen from above."""
    for one, other in combinations(uprights(design), 2):
        room = min(hypot(x - u, y - v) for (x, y), (u, v) in product(one.places, other.places))
        room -= one.radius_mm + other.radius_mm
        if room < 0:
            yield Broken(
                "bosses_collide",
                f"expected {one.name} clear of {other.name}, got {room:.2f} mm; change {one.set_by} or {other.set_by}",
            )


def uprights(design: HardwareDesign) -> tuple[Upright, ...]:
    """Insert bosses, posts, screw bosses."""
    plan, base = design.plan, design.base
    return (
        Upright("the base's insert bosses", tuple(plan.mount_inserts), base.boss_mm / 2, "base.mount_inset_mm"),
        Upright("the locating posts", tuple(plan.posts), base.post_mm / 2, "board.locating_inset_mm"),
        Upright("the shell's screw bosses", tuple(plan.shell_screws), design.shell.boss_mm / 2, "shell.boss_inset_mm"),
    )


def posts_misplaced(design: HardwareDesign) -> Iterator[Broken]:
    """Locating posts in the shell's wall, in the camera's pocket, or under the receptacle or the driver."""
    base, plan, radius = design.base, design.plan, design.base.post_mm / 2
    x, y = max(plan.posts)
    if x + radius > plan.cavity[0] / 2 or y + radius > plan.cavity[1] / 2:
        yield Broken(
            "post_in_wall",
            f"expected the locating posts within the shell's cavity, got them at ({x:g}, {y:g}) mm; enlarge "
            "board.locating_inset_mm",
        )
    inside = max(base.pocket_wide_mm, design.board.usb_mm[0]) / 2
    driver = design.board.driver_at_mm[0] + design.board.driver_mm[0] / 2
    if x - radius < max(inside, driver):
        yield Broken(
            "post_in_pocket",
            f"expected the locating posts beyond {max(inside, driver):.2f} mm from the middle, clear of camera, receptacle and "
            f"driver, got {x - radius:.2f} mm; lessen board.locating_inset_mm",
        )


def mounts_misplaced(design: HardwareDesign) -> Iterator[Broken]:
    """Insert bosses in the pocket, under the receptacle or in the shell's wall."""
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
