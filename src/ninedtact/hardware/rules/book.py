"""All rules, asked of a design before anything is built."""

from collections.abc import Callable, Iterator

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.rules.cable import ramp_has_no_room
from ninedtact.hardware.rules.moulding import (
    clamps_in_the_shell,
    gel_has_no_seat,
    inserts_do_not_hold,
    mould_too_thin_for_the_screws,
    screws_do_not_hold,
    tray_does_not_pass,
)
from ninedtact.hardware.rules.room import (
    bosses_collide,
    mounts_misplaced,
    parts_touch,
    posts_misplaced,
    usb_slot_misplaced,
)
from ninedtact.hardware.rules.rule import Broken, RulesBroken
from ninedtact.hardware.rules.view import (
    camera_too_far,
    lens_does_not_see_the_corner,
    pins_out_of_view,
    pins_too_close,
    window_cuts_the_view,
)
from ninedtact.hardware.rules.walls import ring_has_no_mouth, walls_too_thin

Rule = Callable[[HardwareDesign], Iterator[Broken]]
RULES: tuple[Rule, ...] = (
    walls_too_thin,
    ring_has_no_mouth,
    parts_touch,
    bosses_collide,
    mounts_misplaced,
    posts_misplaced,
    usb_slot_misplaced,
    ramp_has_no_room,
    camera_too_far,
    lens_does_not_see_the_corner,
    window_cuts_the_view,
    pins_out_of_view,
    pins_too_close,
    mould_too_thin_for_the_screws,
    screws_do_not_hold,
    inserts_do_not_hold,
    gel_has_no_seat,
    tray_does_not_pass,
    clamps_in_the_shell,
)


def broken_rules(design: HardwareDesign) -> list[Broken]:
    """Every rule that it breaks; none if it can be built."""
    return [broken for rule in RULES for broken in rule(design)]


def require_buildable(design: HardwareDesign) -> None:
    """Refuse a design that cannot be built; raises `RulesBroken`."""
    if broken := broken_rules(design):
        raise RulesBroken(broken)
