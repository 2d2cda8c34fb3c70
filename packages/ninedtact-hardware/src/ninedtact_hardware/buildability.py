"""Rules that a design must keep before anything is built: `find_broken_rules` returns those that it breaks with expected,
got and remedy, `require_buildable_design` raises `DesignNotBuildable`.

A rule is a length, or another number, that has to lie between two limits. Clearances between parts are rules too.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations, product
from math import atan2, dist, hypot, inf, radians, sqrt, tan

from ninedtact.design import DesignImpossible, PinBoard
from ninedtact_hardware.clearances import list_clearances
from ninedtact_hardware.design import (
    XY,
    HardwareDesign,
    distance_to_edge_mm,
    lens_view_radius_mm,
    required_camera_distance_mm,
    sensing_corner_distance_mm,
)
from ninedtact_hardware.led_board import LED_LIMIT_MA, LedOperatingPoint


@dataclass(frozen=True)
class DesignRule:
    """A number of a design that has to lie between two limits."""

    rule: str
    """Name of the rule, such as `wall_too_thin`."""
    subject: str
    """What has these limits: a dimension by its name in the design file, or a description."""
    value: float
    least: float = -inf
    most: float = inf
    remedy: str = "correct it"
    unit: str = "mm"

    @property
    def is_broken(self) -> bool:
        """Whether the value lies outside the limits."""
        return not self.least - ROUNDING <= self.value <= self.most + ROUNDING

    @property
    def message(self) -> str:
        """What is expected, what the design has, and what to do."""
        low, high, found = (f"{number:.2f}".removesuffix(".00") for number in (self.least, self.most, self.value))
        limits = f"from {low} to {high}" if self.least > -inf and self.most < inf else ""
        limits = limits or (f"of at least {low}" if self.least > -inf else f"of at most {high}")
        return f"expected {self.subject} {limits} {self.unit}, got {found} {self.unit}; {self.remedy}"


class DesignNotBuildable(DesignImpossible):
    """Raised for a design that cannot be built; `broken` holds every broken rule."""

    def __init__(self, broken: Iterable[DesignRule]) -> None:
        self.broken = tuple(broken)
        super().__init__("; also ".join(f"{each.message} (rule {each.rule})" for each in self.broken))


ROUNDING = 1e-9
MORE = 1e-6
"""Difference by which a value that has to be more than another is more."""
MIN_WALL_MM = 0.8
"""Least wall thickness: two lines of a nozzle of 0.4 mm; laser-sintered nylon needs 0.7."""
MIN_MOULD_MM = 1.5
"""Half an M3 screw: a thinner acrylic plate bends or cracks between the clamps, and the gel runs out under it."""
MIN_THREAD_MM = 2.0
"""Least length of M2 thread that holds, which is its diameter."""
M3_NUT_WIDTH_MM = 6.4
"""Width of an M3 nut across its corners (ISO 4032: 6.01 at least)."""
MAX_CAMERA_DISTANCE_MM = 200.0
MIN_PIN_GAP_MM = 0.6
"""Least distance between pins, so that their imprints stay apart."""
SLOT_BELOW_FLOOR_MM = 0.3
"""Least plastic between the USB slot and the shell's floor."""


def find_broken_rules(design: HardwareDesign) -> list[DesignRule]:
    """Return every rule that a design breaks; none if it can be built."""
    return [rule for rule in list_design_rules(design) if rule.is_broken]


def require_buildable_design(design: HardwareDesign) -> None:
    """Refuse a design that cannot be built; raises `DesignNotBuildable`."""
    if broken := find_broken_rules(design):
        raise DesignNotBuildable(broken)


def list_design_rules(design: HardwareDesign) -> Iterator[DesignRule]:
    """Yield all rules of a design, kept and broken."""
    for name, thick in _wall_thicknesses(design):
        yield DesignRule("wall_too_thin", name, thick, MIN_WALL_MM, remedy="make it thicker")
    # Clearances that are merely tight are only reported by `hardware check`.
    for each in list_clearances(design):
        if each.impossible_below_mm is not None:
            subject, remedy = f"clearance between {each.faces}", f"change {each.adjusted_by}"
            yield DesignRule(each.rule, subject, each.clearance_mm, each.impossible_below_mm, remedy=remedy)
    yield from _boss_rules(design)
    yield from _slot_and_ring_rules(design)
    yield from _cable_ramp_rules(design)
    yield from _fastener_rules(design)
    yield from _mould_rules(design)
    yield from _view_rules(design)
    yield from _calibration_board_rules(design)
    led_ma = LedOperatingPoint(design.board.resistor_ohm).led_ma
    remedy = "raise board.resistor_ohm"
    yield DesignRule("leds_too_bright", "a current in each LED", led_ma, most=LED_LIMIT_MA, remedy=remedy, unit="mA")


def _wall_thicknesses(design: HardwareDesign) -> Iterator[tuple[str, float]]:
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


@dataclass(frozen=True)
class _BossPattern:
    """Four bosses or posts of one kind that stand on the base or hang down to it."""

    name: str
    places: tuple[XY, ...]
    radius_mm: float
    set_by: str
    """The dimension that determines their positions."""


def _boss_rules(design: HardwareDesign) -> Iterator[DesignRule]:
    """Yield the distances of bosses and posts from one another, from the shell's wall, and from what lies in the middle:
    the camera's pocket, the receptacle and, for the posts, the driver."""
    plan, base, shell, board = design.horizontal_dimensions, design.base, design.shell, design.board
    inserts = _BossPattern("the insert bosses", (*plan.mount_inserts,), base.boss_mm / 2, "base.mount_inset_mm")
    posts = _BossPattern("the locating posts", (*plan.posts,), base.post_mm / 2, "board.locating_inset_mm")
    screws = _BossPattern("the screw bosses", (*plan.shell_screws,), shell.boss_mm / 2, "shell.boss_inset_mm")
    for one, other in combinations((inserts, posts, screws), 2):
        gap_mm = min(dist(*pair) for pair in product(one.places, other.places)) - one.radius_mm - other.radius_mm
        subject, remedy = f"a gap between {one.name} and {other.name}", f"change {one.set_by} or {other.set_by}"
        yield DesignRule("bosses_collide", subject, gap_mm, 0.0, remedy=remedy)
    inside = max(base.pocket_wide_mm, board.usb_mm[0]) / 2
    driver = board.driver_at_mm[0] + board.driver_mm[0] / 2
    for pattern, name, least in ((inserts, "mount", inside + 0.5), (posts, "post", max(inside, driver))):
        (x, y), radius = max(pattern.places), pattern.radius_mm
        subject = f"a distance of {pattern.name} from the middle, clear of camera, receptacle and driver,"
        yield DesignRule(f"{name}_in_pocket", subject, x - radius, least, remedy=f"reduce {pattern.set_by}")
        room_mm = min(plan.cavity[0] / 2 - x, plan.cavity[1] / 2 - y) - radius
        subject = f"a gap between {pattern.name} and the shell's wall"
        yield DesignRule(f"{name}_in_wall", subject, room_mm, 0.0, remedy=f"enlarge {pattern.set_by}")


def _slot_and_ring_rules(design: HardwareDesign) -> Iterator[DesignRule]:
    """Yield that the receptacle fits the slot, that the slot does not cut the shell's floor, and that the isolation ring's cone
    opens from its bore to its land within its height."""
    shell, levels, ring = design.shell, design.heights, design.ring
    yield DesignRule("usb_slot", "shell.slot_wide_mm", shell.slot_wide_mm, design.board.usb_mm[0], remedy="widen it")
    lowest, highest = levels.board_bottom - levels.plate_top, shell.led_cavity_mm - SLOT_BELOW_FLOOR_MM
    yield DesignRule("usb_slot", "shell.slot_to_mm", shell.slot_to_mm, lowest, highest)
    wider = (design.horizontal_dimensions.ring_side - ring.bore_mm) / 2 - ring.land_mm
    deep, tall = wider / tan(radians(ring.cone_deg)), levels.floor_top - levels.ring_bottom
    remedy = "change ring.land_mm, ring.bore_mm or ring.cone_deg"
    yield DesignRule("ring_has_no_mouth", "a depth of the ring's cone", deep, MORE, tall - MORE, remedy)


def _cable_ramp_rules(design: HardwareDesign) -> Iterator[DesignRule]:
    """Yield that the ramp of the flat cable climbs outwards behind the camera's pocket and that its two blends fit on it."""
    base = design.base
    run, rise = base.ramp_foot_mm - base.ramp_head_mm, design.heights.plate_top - base.ramp_gap_mm - base.floor_mm
    remedy = "take base.ramp_foot_mm above base.ramp_head_mm, and a thicker base.plate_mm"
    yield DesignRule("ramp_too_short", "a ramp that climbs and leads outwards", min(run, rise), MORE, remedy=remedy)
    if min(run, rise) <= 0:
        return
    # A blend of radius R at a bend begins R tan(angle / 2) before the bend.
    bend = tan(atan2(rise, run) / 2)
    blends = bend * (base.ramp_foot_round_mm + base.ramp_head_round_mm)
    remedy = "raise base.ramp_foot_mm, or reduce base.ramp_foot_round_mm"
    yield DesignRule("ramp_too_short", "a slope for the ramp's blends", hypot(run, rise), blends + MORE, remedy=remedy)
    before, needed = (
        design.horizontal_dimensions.outer[1] / 2 - base.ramp_foot_mm - base.pocket_back_mm,
        bend * base.ramp_foot_round_mm,
    )
    subject = "a distance of the camera's pocket from the cable's ramp"
    yield DesignRule("pocket_in_ramp", subject, before, needed + MORE, remedy="reduce base.ramp_foot_mm")


def _fastener_rules(design: HardwareDesign) -> Iterator[DesignRule]:
    """Yield that the M2 screws engage the shell's inserts through the base and through the base board, and that the knurl of the
    inserts melts into the bore and stays within the boss."""
    base, shell, fasteners = design.base, design.shell, design.fasteners
    for name, through in (("base", base.plate_mm - base.counterbore_deep_mm), ("base board", design.moulds.base_mm)):
        subject, remedy = f"a length of the screw above the {name}", "take another fasteners.screw_mm"
        above = fasteners.screw_mm - through
        yield DesignRule("screws_do_not_hold", subject, above, MIN_THREAD_MM, shell.bore_deep_mm, remedy)
    for name, bore, boss in (("base", base.bore_mm, base.boss_mm), ("shell", shell.bore_mm, shell.boss_mm)):
        subject = f"inserts wider than {name}.bore_mm and narrower than {name}.boss_mm,"
        remedy = f"change fasteners.insert_mm or {name}.bore_mm"
        yield DesignRule("inserts_do_not_hold", subject, fasteners.insert_mm[0], bore + MORE, boss - MORE, remedy)


def _mould_rules(design: HardwareDesign) -> Iterator[DesignRule]:
    """Yield that the first mould, which is as thick as the gel, can be clamped, and that the M3 screws and their nuts are clear of
    the shell, within the plates and apart."""
    plan, moulds = design.horizontal_dimensions, design.moulds
    thin, subject = "mould_too_thin_for_the_screws", "gel.thickness_mm, which is that of the first mould,"
    yield DesignRule(thin, subject, design.sensor.gel.thickness_mm, MIN_MOULD_MM, remedy="make the gel thicker")
    beside = min(max(abs(x) - plan.outer[0] / 2, abs(y) - plan.outer[1] / 2) for x, y in plan.clamps)
    subject, remedy = "a distance of the moulds' screws from the shell", "raise moulds.beyond_mm"
    yield DesignRule("clamps_in_the_shell", subject, beside, M3_NUT_WIDTH_MM / 2, remedy=remedy)
    rim = min(distance_to_edge_mm(place, plan.plate, moulds.corner_radius_mm) for place in plan.clamps)
    apart = min(dist(*pair) for pair in combinations(plan.clamps, 2))
    name, remedy = "clamps_beyond_the_plates", "change moulds.pairs_mm, moulds.hole_inset_mm or moulds.corner_radius_mm"
    subject = "a distance of the moulds' holes from the edges of the plates"
    yield DesignRule(name, subject, rim - moulds.hole_mm / 2, MIN_WALL_MM, remedy=remedy)
    yield DesignRule(name, "a distance of the moulds' holes from one another", apart, M3_NUT_WIDTH_MM, remedy=remedy)


def _view_rules(design: HardwareDesign) -> Iterator[DesignRule]:
    """Yield that the camera is not unreasonably far from the skin, that the lens sees the corners of the sensing area through air,
    acrylic and silicone, and that the window does not cut off the cone of view at its upper face."""
    distance, reach = design.sensor.camera.distance_mm, lens_view_radius_mm(design)
    remedy = "reduce camera.distance_mm"
    yield DesignRule("camera_too_far", "camera.distance_mm", distance, most=MAX_CAMERA_DISTANCE_MM, remedy=remedy)
    least, subject = sensing_corner_distance_mm(design) - MORE, "a view of the lens to the sensing area's corner"
    remedy = f"set camera.distance_mm to {required_camera_distance_mm(design) + 0.05:.1f}, or make the area smaller"
    yield DesignRule("lens_does_not_see_the_corner", subject, reach, least, remedy=remedy)
    seen, remedy = 2 * lens_view_radius_mm(design, design.heights.window_top), "enlarge it and its hole"
    yield DesignRule("window_cuts_the_view", "window.side_mm", design.window.side_mm, seen, remedy=remedy)


def count_pins_within(board: PinBoard, side_mm: float) -> int:
    """Return how many pins of a row press whole within a side of the sensing area."""
    return int((side_mm - board.pin_diameter_mm) / board.pitch_mm + 1e-9) + 1


def _calibration_board_rules(design: HardwareDesign) -> Iterator[DesignRule]:
    """Yield that all pins press within the sensing area, so that their imprints are seen whole and apart, that they are tall
    enough, and that the tray slides over the shell's corners."""
    board, area, frame = design.sensor.pin_board, design.sensor.sensing_area, design.pin_frame
    for axis, count, side in (("cols", board.cols, area.width_mm), ("rows", board.rows, area.height_mm)):
        most = count_pins_within(board, side)
        # Fitting a lens takes at least three in a row.
        fewer, closer = f"set pin_board.{axis} to {most}", "narrow pin_board.pitch_mm and take thinner pins"
        subject, remedy = f"pin_board.{axis} within {side:g} mm of sensing area", fewer if most >= 3 else closer
        yield DesignRule("pins_out_of_view", subject, count, most=most, remedy=remedy, unit="pins")
    pitch, remedy = board.pin_diameter_mm + MIN_PIN_GAP_MM, "widen it, or take thinner pins"
    yield DesignRule("pins_too_close", "pin_board.pitch_mm", board.pitch_mm, pitch, remedy=remedy)
    tall, subject = board.pin_diameter_mm / 2, "pin_frame.pin_tall_mm, half a pin's diameter or more,"
    yield DesignRule("pin_too_short", subject, frame.pin_tall_mm, tall, remedy="raise it")
    inside = max(frame.corner_radius_mm - frame.wall_mm, 0.0)
    gap_mm = frame.gap_mm - max(inside - design.shell.corner_radius_mm, 0.0) * (sqrt(2) - 1)
    subject, remedy = (
        "a gap between the calibration board's corners and the shell's",
        "reduce pin_frame.corner_radius_mm",
    )
    yield DesignRule("tray_does_not_pass", subject, gap_mm, 0.05, remedy=remedy)
