"""The list of all rules, and their application to a design before anything is built."""

from collections.abc import Callable, Iterator

from ninedtact.hardware.buildability.mechanical_rules import (
    BrokenRule,
    DesignRulesBroken,
    check_boss_distances,
    check_cable_ramp,
    check_clearances,
    check_insert_boss_positions,
    check_isolation_ring_cone,
    check_post_positions,
    check_usb_slot,
    check_wall_thickness,
)
from ninedtact.hardware.buildability.moulding_and_view_rules import (
    check_calibration_board_fit,
    check_camera_distance,
    check_clamp_positions,
    check_gel_seat,
    check_insert_bores,
    check_lens_coverage,
    check_mould_thickness,
    check_pin_spacing,
    check_pins_in_view,
    check_screw_lengths,
    check_window_size,
)
from ninedtact.hardware.design import HardwareDesign

DesignRule = Callable[[HardwareDesign], Iterator[BrokenRule]]
DESIGN_RULES: tuple[DesignRule, ...] = (
    check_wall_thickness,
    check_isolation_ring_cone,
    check_clearances,
    check_boss_distances,
    check_insert_boss_positions,
    check_post_positions,
    check_usb_slot,
    check_cable_ramp,
    check_camera_distance,
    check_lens_coverage,
    check_window_size,
    check_pins_in_view,
    check_pin_spacing,
    check_mould_thickness,
    check_screw_lengths,
    check_insert_bores,
    check_gel_seat,
    check_calibration_board_fit,
    check_clamp_positions,
)


def find_broken_rules(design: HardwareDesign) -> list[BrokenRule]:
    """Return every rule that a design breaks; none if it can be built."""
    return [broken for rule in DESIGN_RULES for broken in rule(design)]


def require_buildable_design(design: HardwareDesign) -> None:
    """Refuse a design that cannot be built; raises `DesignRulesBroken`."""
    if broken := find_broken_rules(design):
        raise DesignRulesBroken(broken)
