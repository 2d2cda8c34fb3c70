"""Rules that a design must keep before anything is built: `find_broken_rules` returns those that it breaks with expected,
got and remedy, `require_buildable_design` raises `DesignNotBuildable`.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations, product
from math import atan2, dist, hypot, radians, sqrt, tan

from ninedtact.design import DesignImpossible, PinBoard
from ninedtact_hardware.assembly_dimensions import XY, distance_to_edge_mm
from ninedtact_hardware.clearances import list_clearances
from ninedtact_hardware.design import (
    HardwareDesign,
    lens_view_radius_mm,
    required_camera_distance_mm,
    sensing_corner_distance_mm,
)


@dataclass(frozen=True)
class BrokenRule:
    """A rule that a design breaks."""

    rule: str
    """Name of the rule, such as `wall_too_thin`."""
    message: str
    """What was expected, what was found, and what to do."""


class DesignNotBuildable(DesignImpossible):
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
    shell, base, plan = design.shell, design.base, design.horizontal_dimensions
    yield "shell.wall_mm", shell.wall_mm
    yield "shell.frame_wall_mm", shell.frame_wall_mm
    yield "the shell's corner beside the gel", plan.shell_corner
    beside_bores = distance_to_edge_mm(max(plan.shell_screws), plan.outer, shell.corner_radius_mm) - shell.bore_mm / 2
    yield (
        "the shell outside its bores (shell.wall_mm and shell.boss_inset_mm, less shell.bore_mm, halved)",
        beside_bores,
    )
    yield "the screw bosses' wall (shell.boss_mm less shell.bore_mm, halved)", (shell.boss_mm - shell.bore_mm) / 2
    yield "the insert bosses' wall (base.boss_mm less base.bore_mm, halved)", (base.boss_mm - base.bore_mm) / 2
    # Where the bores do not lie below the gel cavity, the wall continues above them.
    if distance_to_edge_mm(max(plan.shell_screws), plan.opening, shell.opening_radius_mm) > -shell.bore_mm / 2:
        above_bores = shell.led_cavity_mm + shell.floor_mm - shell.bore_deep_mm
        yield "the shell above its bores (shell.led_cavity_mm and shell.floor_mm, less shell.bore_deep_mm)", above_bores
    yield "base.floor_mm", base.floor_mm
    yield "the base under its counterbores", base.plate_mm - base.counterbore_deep_mm
    yield "the ring's wall", (plan.ring_side - design.ring.bore_mm) / 2
    if shell.relief_deep_mm:
        yield "shell.relief_left_mm", shell.relief_left_mm


def _check_isolation_ring_cone(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the isolation ring's cone opens from its bore to its land within its height."""
    ring, levels = design.ring, design.heights
    wider = (design.horizontal_dimensions.ring_side - ring.bore_mm) / 2 - ring.land_mm
    deep, tall = wider / tan(radians(ring.cone_deg)), levels.floor_top - levels.ring_bottom
    if not 0 < deep < tall:
        yield BrokenRule(
            "ring_has_no_mouth",
            f"expected a cone of more than zero and less than the ring's {tall:.2f} mm deep, got {deep:.2f} mm; change "
            "ring.land_mm, ring.bore_mm or ring.cone_deg",
        )


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
            least = clearance.impossible_below_mm or 0.0
            yield BrokenRule(
                clearance.rule,
                f"expected clearance between {clearance.faces}{f' of at least {least:g} mm' if least > 0 else ''}, got "
                f"{clearance.clearance_mm:.2f} mm; change {clearance.adjusted_by}",
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
    plan, base = design.horizontal_dimensions, design.base
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
    cavity, board = design.horizontal_dimensions.cavity, design.board
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
    before = design.horizontal_dimensions.outer[1] / 2 - base.ramp_foot_mm - base.pocket_back_mm
    if before <= bend * base.ramp_foot_round_mm:
        yield BrokenRule(
            "pocket_in_ramp",
            f"expected {bend * base.ramp_foot_round_mm:.2f} mm between the camera's pocket and the cable's ramp, got "
            f"{before:.2f} mm; reduce base.ramp_foot_mm",
        )


MIN_MOULD_MM = 1.5
"""Half an M3 screw: a thinner acrylic plate bends or cracks between the clamps, and the gel runs out under it."""
MIN_THREAD_MM = 2.0
"""Least length of M2 thread that holds, which is its diameter."""
M3_NUT_WIDTH_MM = 6.4
"""Width of an M3 nut across its corners (ISO 4032: 6.01 at least)."""


def _check_mould_thickness(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the first mould, which is as thick as the gel, can be clamped."""
    thick = design.sensor.gel.thickness_mm
    if thick < MIN_MOULD_MM:
        yield BrokenRule(
            "mould_too_thin_for_the_screws",
            f"expected a mould of at least {MIN_MOULD_MM:g} mm between its M3 screws, got gel.thickness_mm {thick:g}; make "
            "the gel thicker",
        )


def _check_screw_lengths(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the M2 screws engage the shell's inserts through the base and through the base board."""
    screw, deepest = design.fasteners.screw_mm, design.shell.bore_deep_mm
    for name, through in (
        ("the base", design.base.plate_mm - design.base.counterbore_deep_mm),
        ("the base board", design.moulds.base_mm),
    ):
        if not MIN_THREAD_MM <= screw - through <= deepest:
            yield BrokenRule(
                "screws_do_not_hold",
                f"expected {MIN_THREAD_MM:g} to {deepest:g} mm of the screw above {name}, got {screw - through:.2f} mm; take "
                "another fasteners.screw_mm",
            )


def _check_insert_bores(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the knurl of the inserts melts into the bore and stays within the boss."""
    knurl, base, shell = design.fasteners.insert_mm[0], design.base, design.shell
    for name, bore, boss in (("base", base.bore_mm, base.boss_mm), ("shell", shell.bore_mm, shell.boss_mm)):
        if not bore < knurl < boss:
            yield BrokenRule(
                "inserts_do_not_hold",
                f"expected inserts wider than {name}.bore_mm, {bore:g}, and narrower than {name}.boss_mm, {boss:g}, got "
                f"{knurl:g} mm; change fasteners.insert_mm or {name}.bore_mm",
            )


def _check_calibration_board_fit(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the calibration board slides over the shell's corners."""
    frame, shell = design.pin_frame, design.shell
    inside = max(frame.corner_radius_mm - frame.wall_mm, 0.0)
    gap_mm = frame.gap_mm - max(inside - shell.corner_radius_mm, 0.0) * (sqrt(2) - 1)
    if gap_mm < 0.05:
        yield BrokenRule(
            "tray_does_not_pass",
            f"expected 0.05 mm between the calibration board's corners and the shell's, got {gap_mm:.2f} mm; reduce "
            "pin_frame.corner_radius_mm",
        )


def _check_clamp_positions(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the M3 screws of the moulds and their nuts are clear of the shell."""
    (wide, deep), gap_mm = design.horizontal_dimensions.outer, M3_NUT_WIDTH_MM / 2
    for x, y in design.horizontal_dimensions.clamps:
        if abs(x) < wide / 2 + gap_mm and abs(y) < deep / 2 + gap_mm:
            yield BrokenRule(
                "clamps_in_the_shell",
                f"expected the moulds' screws {gap_mm:.2f} mm beside the shell, got one at ({x:g}, {y:g}) mm; raise "
                "moulds.beyond_mm",
            )
            return


def _check_clamp_holes(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the holes for the moulds' screws lie within the plates and leave room for the nuts."""
    plan, moulds, nut_mm = design.horizontal_dimensions, design.moulds, M3_NUT_WIDTH_MM
    rims = (distance_to_edge_mm(place, plan.plate, moulds.corner_radius_mm) for place in plan.clamps)
    rim, apart = min(rims) - moulds.hole_mm / 2, min(dist(*pair) for pair in combinations(plan.clamps, 2))
    if rim < MIN_WALL_MM - 1e-9 or apart < nut_mm:
        yield BrokenRule(
            "clamps_beyond_the_plates",
            f"expected the moulds' holes {MIN_WALL_MM:g} mm inside the plates and {nut_mm:g} mm apart, got {rim:.2f} and "
            f"{apart:.2f} mm; change moulds.pairs_mm, moulds.hole_inset_mm or moulds.corner_radius_mm",
        )


MAX_CAMERA_DISTANCE_MM = 200.0
MIN_PIN_GAP_MM = 0.6
"""Least distance between pins, so that their imprints stay apart."""


def _check_camera_distance(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the camera is not unreasonably far from the skin."""
    distance = design.sensor.camera.distance_mm
    if distance > MAX_CAMERA_DISTANCE_MM:
        yield BrokenRule(
            "camera_too_far",
            f"expected the camera at most {MAX_CAMERA_DISTANCE_MM:g} mm from the skin, got {distance:g} mm; reduce "
            "camera.distance_mm",
        )


def _check_lens_coverage(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the lens sees the corners of the sensing area through air, acrylic and silicone."""
    reach, corner = lens_view_radius_mm(design), sensing_corner_distance_mm(design)
    if reach < corner - 1e-6:
        yield BrokenRule(
            "lens_does_not_see_the_corner",
            f"expected the lens to reach the sensing area's corner, {corner:.1f} mm from the middle, got {reach:.1f} mm; set "
            f"camera.distance_mm to {required_camera_distance_mm(design) + 0.05:.1f}, or make the area smaller",
        )


def _check_window_size(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the window does not cut off the cone of view at its upper face."""
    reach, half = lens_view_radius_mm(design, design.heights.window_top), design.window.side_mm / 2
    if reach > half:
        yield BrokenRule(
            "window_cuts_the_view",
            f"expected a window of at least {2 * reach:.1f} mm, got {design.window.side_mm:g} mm; enlarge it and its hole",
        )


def count_pins_within(board: PinBoard, side_mm: float) -> int:
    """Return how many pins of a row press whole within a side of the sensing area."""
    return int((side_mm - board.pin_diameter_mm) / board.pitch_mm + 1e-9) + 1


def _check_pins_in_view(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that all pins press within the sensing area, so that their imprints are seen whole."""
    board, area = design.sensor.pin_board, design.sensor.sensing_area
    for axis, count, side in (("cols", board.cols, area.width_mm), ("rows", board.rows, area.height_mm)):
        most = count_pins_within(board, side)
        if count > most:
            yield BrokenRule(
                "pins_out_of_view",
                f"expected at most {most} {axis} of pins {board.pitch_mm:g} mm apart within {side:g} mm of sensing area, got "
                f"{count}; {_pin_count_remedy(axis, most)}",
            )


def _pin_count_remedy(axis: str, most: int) -> str:
    """Return what to do about too many pins; fitting a lens takes at least three in a row."""
    return f"set pin_board.{axis} to {most}" if most >= 3 else "narrow pin_board.pitch_mm and take thinner pins"


def _check_pin_spacing(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the imprints of neighbouring pins stay apart and that the pins are tall enough."""
    board = design.sensor.pin_board
    if board.pitch_mm < board.pin_diameter_mm + MIN_PIN_GAP_MM:
        yield BrokenRule(
            "pins_too_close",
            f"expected a pitch of at least {board.pin_diameter_mm + MIN_PIN_GAP_MM:.2f} mm between pins of "
            f"{board.pin_diameter_mm:g} mm, got {board.pitch_mm:g} mm; widen pin_board.pitch_mm, or take thinner pins",
        )
    if design.pin_frame.pin_tall_mm < board.pin_diameter_mm / 2:
        yield BrokenRule(
            "pin_too_short",
            f"expected pins as tall as half their diameter, {board.pin_diameter_mm / 2:g} mm, got "
            f"{design.pin_frame.pin_tall_mm:g} mm; raise pin_frame.pin_tall_mm",
        )


DESIGN_RULES: tuple[DesignRule, ...] = (
    _check_wall_thickness,
    _check_isolation_ring_cone,
    _check_clearances,
    _check_boss_distances,
    _check_boss_positions,
    _check_usb_slot,
    _check_cable_ramp,
    _check_camera_distance,
    _check_lens_coverage,
    _check_window_size,
    _check_pins_in_view,
    _check_pin_spacing,
    _check_mould_thickness,
    _check_screw_lengths,
    _check_insert_bores,
    _check_calibration_board_fit,
    _check_clamp_positions,
    _check_clamp_holes,
)


def find_broken_rules(design: HardwareDesign) -> list[BrokenRule]:
    """Return every rule that a design breaks; none if it can be built."""
    return [broken for rule in DESIGN_RULES for broken in rule(design)]


def require_buildable_design(design: HardwareDesign) -> None:
    """Refuse a design that cannot be built; raises `DesignNotBuildable`."""
    if broken := find_broken_rules(design):
        raise DesignNotBuildable(broken)
