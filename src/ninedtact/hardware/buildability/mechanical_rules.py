"""Mechanical rules: wall thicknesses, clearances, positions of bosses and posts, the USB slot and the cable's ramp.
Lengths in mm."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations, product
from math import atan2, hypot, radians, sqrt, tan

from ninedtact.design import DesignImpossible
from ninedtact.hardware.assembly_dimensions import XY
from ninedtact.hardware.clearances import list_clearances
from ninedtact.hardware.design import HardwareDesign


@dataclass(frozen=True)
class BrokenRule:
    """A rule that a design breaks."""

    rule: str
    """Name of the rule, such as `wall_too_thin`."""
    message: str
    """What was expected, what was found, and what to do."""


class DesignRulesBroken(DesignImpossible):
    """Raised for a design that cannot be built; `broken` holds every broken rule."""

    def __init__(self, broken: Iterable[BrokenRule]) -> None:
        self.broken = tuple(broken)
        super().__init__("; also ".join(f"{each.message} (rule {each.rule})" for each in self.broken))


DesignRule = Callable[[HardwareDesign], Iterator[BrokenRule]]
MIN_WALL_MM = 0.8
"""Least wall thickness: two lines of a nozzle of 0.4 mm; laser-sintered nylon needs 0.7."""


def _check_wall_thickness(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Yield every wall that is too thin to print or to hold."""
    for name, thick in _wall_thicknesses(design):
        if thick < MIN_WALL_MM - 1e-9:
            yield BrokenRule(
                "wall_too_thin", f"expected {name} of at least {MIN_WALL_MM:g} mm, got {thick:.2f} mm; make it thicker"
            )


def _wall_thicknesses(design: HardwareDesign) -> Iterator[tuple[str, float]]:
    """Yield name and thickness of every wall."""
    shell, base = design.shell, design.base
    yield "shell.wall_mm", shell.wall_mm
    yield "shell.frame_wall_mm", shell.frame_wall_mm
    yield "the shell's corner beside the gel", _shell_corner_thickness_mm(design)
    yield "the screw bosses' wall (shell.boss_mm less shell.bore_mm, halved)", (shell.boss_mm - shell.bore_mm) / 2
    yield "the insert bosses' wall (base.boss_mm less base.bore_mm, halved)", (base.boss_mm - base.bore_mm) / 2
    yield "base.floor_mm", base.floor_mm
    yield "the base under its counterbores", base.plate_mm - base.counterbore_deep_mm
    yield "the ring's wall", (design.plan_view.ring_side - design.ring.bore_mm) / 2
    if shell.relief_deep_mm:
        yield "shell.relief_left_mm", shell.relief_left_mm


def _check_isolation_ring_cone(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the isolation ring's cone opens from its bore to its land within its height."""
    ring, levels = design.ring, design.heights
    wider = (design.plan_view.ring_side - ring.bore_mm) / 2 - ring.land_mm
    deep, tall = wider / tan(radians(ring.cone_deg)), levels.floor_top - levels.ring_bottom
    if not 0 < deep < tall:
        yield BrokenRule(
            "ring_has_no_mouth",
            f"expected a cone of more than zero and less than the ring's {tall:.2f} mm deep, got {deep:.2f} mm; change "
            "ring.land_mm, ring.bore_mm or ring.cone_deg",
        )


def _shell_corner_thickness_mm(design: HardwareDesign) -> float:
    """Return the thickness of the shell along the diagonal of a corner of the gel cavity."""
    shell, plan = design.shell, design.plan_view
    outer, inner = shell.corner_radius_mm, shell.opening_radius_mm
    apart = [(plan.outer[axis] / 2 - outer) - (plan.opening[axis] / 2 - inner) for axis in (0, 1)]
    return outer - inner + sqrt(2) * min(apart)


@dataclass(frozen=True)
class _BossPattern:
    """Four bosses or posts of one kind that stand on the base or hang down to it."""

    name: str
    places: tuple[XY, ...]
    radius_mm: float
    set_by: str
    """The dimension that determines their positions."""


def _check_clearances(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Yield pairs of faces that overlap; tight ones are only reported by `hardware check`."""
    for clearance in list_clearances(design):
        if clearance.is_impossible:
            yield BrokenRule(
                clearance.rule,
                f"expected clearance between {clearance.faces}, got {clearance.clearance_mm:.2f} mm; change "
                f"{clearance.adjusted_by}",
            )


def _check_boss_distances(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Yield patterns of bosses and posts that overlap, seen from above."""
    for one, other in combinations(_boss_patterns(design), 2):
        gap_mm = min(hypot(x - u, y - v) for (x, y), (u, v) in product(one.places, other.places))
        gap_mm -= one.radius_mm + other.radius_mm
        if gap_mm < 0:
            yield BrokenRule(
                "bosses_collide",
                f"expected {one.name} clear of {other.name}, got {gap_mm:.2f} mm; change {one.set_by} or {other.set_by}",
            )


def _boss_patterns(design: HardwareDesign) -> tuple[_BossPattern, ...]:
    """Return insert bosses, locating posts and screw bosses."""
    plan, base = design.plan_view, design.base
    return (
        _BossPattern("the base's insert bosses", tuple(plan.mount_inserts), base.boss_mm / 2, "base.mount_inset_mm"),
        _BossPattern("the locating posts", tuple(plan.posts), base.post_mm / 2, "board.locating_inset_mm"),
        _BossPattern(
            "the shell's screw bosses", tuple(plan.shell_screws), design.shell.boss_mm / 2, "shell.boss_inset_mm"
        ),
    )


def _check_boss_positions(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that insert bosses and locating posts are clear of the shell's wall, and of what lies in the middle: the
    camera's pocket, the receptacle and, for the posts, the driver."""
    inserts, posts, _ = _boss_patterns(design)
    cavity, board = design.plan_view.cavity, design.board
    inside = max(design.base.pocket_wide_mm, board.usb_mm[0]) / 2
    driver = board.driver_at_mm[0] + board.driver_mm[0] / 2
    for pattern, name, least in ((inserts, "mount", inside + 0.5), (posts, "post", max(inside, driver))):
        (x, y), radius = max(pattern.places), pattern.radius_mm
        if x - radius < least:
            yield BrokenRule(
                f"{name}_in_pocket",
                f"expected {pattern.name} beyond {least:.2f} mm from the middle, clear of camera, receptacle and driver, got "
                f"{x - radius:.2f} mm; reduce {pattern.set_by}",
            )
        if x + radius > cavity[0] / 2 or y + radius > cavity[1] / 2:
            yield BrokenRule(
                f"{name}_in_wall",
                f"expected {pattern.name} within the shell's cavity, got them at ({x:g}, {y:g}) mm; enlarge {pattern.set_by}",
            )


def _check_usb_slot(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the receptacle fits the slot and that the slot does not cut the shell's floor."""
    shell, levels, board = design.shell, design.heights, design.board
    if shell.slot_wide_mm < board.usb_mm[0]:
        yield BrokenRule(
            "usb_slot",
            f"expected shell.slot_wide_mm of at least {board.usb_mm[0]:g}, got {shell.slot_wide_mm:g}; widen it",
        )
    if not levels.board_bottom <= levels.plate_top + shell.slot_to_mm <= levels.ceiling - 0.3:
        yield BrokenRule(
            "usb_slot",
            f"expected shell.slot_to_mm above the receptacle and 0.3 mm below the shell's floor, got {shell.slot_to_mm:g}; "
            "correct it",
        )


def _check_cable_ramp(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the ramp of the flat cable climbs outwards behind the camera's pocket and that its two blends fit on
    it."""
    base = design.base
    run, rise = base.ramp_foot_mm - base.ramp_head_mm, design.heights.plate_top - base.ramp_gap_mm - base.floor_mm
    if min(run, rise) <= 0:
        yield BrokenRule(
            "ramp_too_short",
            f"expected a ramp that climbs outwards, got {run:.2f} mm out and {rise:.2f} mm up; take base.ramp_foot_mm above "
            "base.ramp_head_mm, and a thicker base.plate_mm",
        )
        return
    # A blend of radius R at a bend begins R tan(angle / 2) before the bend.
    bend = tan(atan2(rise, run) / 2)
    blends, slope = bend * (base.ramp_foot_round_mm + base.ramp_head_round_mm), hypot(run, rise)
    if blends >= slope:
        yield BrokenRule(
            "ramp_too_short",
            f"expected the ramp's slope of at least {blends:.2f} mm for its two blends, got {slope:.2f} mm; raise "
            "base.ramp_foot_mm, or reduce base.ramp_foot_round_mm",
        )
    before = design.plan_view.outer[1] / 2 - base.ramp_foot_mm - base.pocket_back_mm
    if before <= bend * base.ramp_foot_round_mm:
        yield BrokenRule(
            "pocket_in_ramp",
            f"expected {bend * base.ramp_foot_round_mm:.2f} mm between the camera's pocket and the cable's ramp, got "
            f"{before:.2f} mm; reduce base.ramp_foot_mm",
        )


MECHANICAL_RULES: tuple[DesignRule, ...] = (
    _check_wall_thickness,
    _check_isolation_ring_cone,
    _check_clearances,
    _check_boss_distances,
    _check_boss_positions,
    _check_usb_slot,
    _check_cable_ramp,
)
