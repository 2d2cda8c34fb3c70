"""Clearances between parts, computed from the dimensions alone. Negative clearances are overlaps. Lengths in mm."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise, product
from math import hypot, inf, sqrt

from ninedtact_hardware.design import HardwareDesign, distance_to_edge_mm, lens_view_radius_mm
from ninedtact_hardware.part_dimensions import M2_DIAMETER_MM


def _lens_diameter_mm(design: HardwareDesign, above_mm: float, below_mm: float = inf) -> float:
    """Return the diameter of the widest lens step that reaches above one height and begins below the other."""
    camera, floor = design.camera, design.base.floor_mm
    tops = [floor + camera.tall_mm, *(floor + top for _, top in camera.lens_mm)]
    steps = zip(camera.lens_mm, pairwise(tops), strict=True)
    return max((wide for (wide, _), (bottom, top) in steps if top > above_mm and bottom < below_mm), default=0.0)


def _lens_to_parts_below_mm(design: HardwareDesign) -> float:
    """Return the distance from the lens to the nearer of receptacle and LED driver, which hang below the board."""
    board, levels = design.board, design.heights
    (wide, deep, tall), (x, from_edge) = board.driver_mm, board.driver_at_mm
    y = design.horizontal_dimensions.led_board[1] / 2 + from_edge
    driver = _rectangle_distance_mm(abs(x) - wide / 2, abs(y) - deep / 2)
    receptacle = design.horizontal_dimensions.usb_mouth - board.usb_mm[1]
    lowest = min(levels.usb_bottom, levels.board_bottom - tall)
    return min(driver, receptacle) - _lens_diameter_mm(design, lowest, levels.board_bottom) / 2


def _driver_to_boss_mm(design: HardwareDesign) -> float:
    """Return the distance from the LED driver to the nearest insert boss, beside it or below it."""
    plan, levels = design.horizontal_dimensions, design.heights
    (wide, deep, tall), (x, from_edge) = design.board.driver_mm, design.board.driver_at_mm
    y = plan.led_board[1] / 2 + from_edge
    beside = min(
        _rectangle_distance_mm(abs(boss_x - x) - wide / 2, abs(boss_y - y) - deep / 2)
        for boss_x, boss_y in plan.mount_inserts
    )
    return max(beside - design.base.boss_mm / 2, levels.board_bottom - tall - levels.boss_top)


def _board_to_ceiling_mm(design: HardwareDesign) -> float:
    """Return the distance from the board's upper edge to the fillet at the ceiling, or to the wall where the fillet
    begins above it."""
    radius, levels = design.shell.fillet_mm, design.heights
    beside = min(design.board.gap_mm, design.board.notch_mm - design.shell.boss_mm / 2)
    above_start = levels.board_top - (levels.ceiling - radius)
    return radius - hypot(max(radius - beside, 0.0), above_start) if above_start > 0 else beside


def _led_to_ring_mm(design: HardwareDesign) -> float:
    half, (wide, deep, _) = design.horizontal_dimensions.ring_side / 2, design.board.led_mm
    return min(
        _rectangle_distance_mm(abs(x) - wide / 2 - half, abs(y) - deep / 2 - half)
        for x, y in design.horizontal_dimensions.leds
    )


def _led_to_cavity_wall_mm(design: HardwareDesign) -> float:
    """Return the distance from the LEDs to the nearest wall or screw boss, less what the ceiling's fillet takes at the
    LEDs' tops."""
    plan, radius, (wide, deep, _) = design.horizontal_dimensions, design.shell.fillet_mm, design.board.led_mm
    up = max(design.heights.led_top - (design.heights.ceiling - radius), 0.0)
    fillet = radius - sqrt(max(radius**2 - up**2, 0.0))
    walls = [min(plan.cavity[0] / 2 - abs(x) - wide / 2, plan.cavity[1] / 2 - abs(y) - deep / 2) for x, y in plan.leds]
    bosses = [
        _rectangle_distance_mm(abs(x - led_x) - wide / 2, abs(y - led_y) - deep / 2) - design.shell.boss_mm / 2
        for (x, y), (led_x, led_y) in product(plan.shell_screws, plan.leds)
    ]
    return min(walls + bosses) - fillet


def _rectangle_distance_mm(along_x: float, along_y: float) -> float:
    """Return the distance of two rectangles from their gaps along x and y; negative where they overlap."""
    return max(along_x, along_y) if max(along_x, along_y) < 0 else hypot(max(along_x, 0.0), max(along_y, 0.0))


def _mould_seat_mm(design: HardwareDesign) -> float:
    """Return the least width of the shell's rim outside the black gel, at its sides and at its rounded corners; negative where
    the gel ends beyond the rim."""
    plan, inner = design.horizontal_dimensions, design.gels.rim_radius_mm + design.gels.black_side_mm
    outer = design.shell.corner_radius_mm
    sides = [(plan.outer[axis] - plan.black[axis]) / 2 for axis in (0, 1)]
    # How far the centre of the gel's corner lies beyond that of the shell's corner, x and y.
    beyond = [outer - inner - side for side in sides]
    return min(*sides, outer - inner - hypot(*beyond)) if min(beyond) > 0 else min(sides)


BASE, SHELL, RING, WINDOW, TRAY = (
    (name,) for name in ("sensor_base", "sensor_shell", "isolation_ring", "acrylic_window", "calibration_board")
)

PLUG_TOLERANCE_MM = 1.0
"""Distance from its end position at which a plug still makes contact; assumed, no cable was measured."""
STIFFENER_INTERFERENCE_MM = -0.1
"""Clearance of the camera's stiffener in the original's pocket. The original was built so, and the stiffener's corner
gives way."""
MIN_RIM_MM = 0.4
"""Least plastic beside a screw head's counterbore, which carries no load, and least rim of a head that bears on plastic: one
line of a nozzle of 0.4 mm."""
MIN_MOULD_SEAT_MM = 0.25
"""Least width of the shell's rim under the second mould: the tolerances of a printed shell and of a cut mould, 0.15 and 0.10 mm.
On less the mould slips down over the shell, and the black gel is neither as thick as the mould nor held by it."""
BOARD_PRESS_MM = 1.0
"""How deep the calibration board is pressed at most: the pins of a guided calibration go 0.85 mm deep."""
ROUNDING_MM = 1e-9


@dataclass(frozen=True)
class Clearance:
    """The distance between two faces that pass or face each other."""

    faces: str
    """Names of the two faces."""
    adjusted_by: str
    """Dimensions that change it."""
    clearance_mm: float
    required_mm: float
    """Least clearance for printing, cutting or moulding."""
    critical_parts: tuple[str, ...] = ()
    """Parts to be made whose accuracy decides whether it is kept; their drawings list it."""
    impossible_below_mm: float | None = 0.0
    """Least clearance with which a sensor can be built at all; none where any value can be built."""
    rule: str = "parts_touch"
    """Name of the rule that is broken below that."""

    @property
    def is_tight(self) -> bool:
        """Whether the clearance is less than required."""
        return self.clearance_mm < self.required_mm - ROUNDING_MM


def list_clearances(design: HardwareDesign) -> Iterator[Clearance]:
    """Yield all clearances of a design; those of diameters are per side."""
    yield from _led_board_clearances(design)
    yield from _window_clearances(design)
    yield from _camera_clearances(design)
    yield from _fastener_clearances(design)
    yield from _outer_clearances(design)


def fits_of_part(design: HardwareDesign, part: str) -> list[Clearance]:
    """Return the clearances that rest on how exactly this part is made."""
    return [clearance for clearance in list_clearances(design) if part in clearance.critical_parts]


def _led_board_clearances(design: HardwareDesign) -> Iterator[Clearance]:
    board, shell, base, levels = design.board, design.shell, design.base, design.heights
    plate, notch, pin = levels.plate_top, board.notch_mm - shell.boss_mm / 2, (board.locating_mm - base.pin_mm) / 2
    yield Clearance("LED board, shell cavity", "board.gap_mm", board.gap_mm, 0.15, SHELL)
    faces, changed = "notch of the LED board, screw boss of the shell", "board.notch_mm or shell.boss_mm"
    yield Clearance(faces, changed, notch, 0.05, SHELL)
    changed, ceiling = "board.gap_mm, shell.fillet_mm or shell.led_cavity_mm", _board_to_ceiling_mm(design)
    yield Clearance("LED board, rounded ceiling of the shell", changed, ceiling, 0.05, SHELL + BASE)
    yield Clearance("hole of the LED board, locating pin", "board.locating_mm or base.pin_mm", pin, 0.02, BASE)
    changed, floor = "board.thick_mm, base.post_tall_mm or shell.led_cavity_mm", levels.ceiling - levels.led_top
    touches = "led_touches_shell"
    yield Clearance("LED top, underside of the shell's floor", changed, floor, 0.1, SHELL + BASE, rule=touches)
    changed, boss = "base.boss_tall_mm or base.post_tall_mm", levels.board_bottom - levels.boss_top
    yield Clearance("insert boss of the base, LED board", changed, boss, 0.5)
    changed, boss = "base.mount_inset_mm, base.boss_tall_mm or board.driver_at_mm", _driver_to_boss_mm(design)
    yield Clearance("insert boss of the base, LED driver", changed, boss, 0.1)
    yield Clearance("micro-USB receptacle, base plate", "base.post_tall_mm", levels.usb_bottom - plate, 0.3)
    driver_bottom = levels.board_bottom - board.driver_mm[2]
    yield Clearance("LED driver, base plate", "base.post_tall_mm", driver_bottom - plate, 0.3)
    yield Clearance("LED, isolation ring", "board.led_inset_mm or shell.hole_mm", _led_to_ring_mm(design), 0.1)
    yield Clearance("LED, side of the shell's lower cavity", "board.led_inset_mm", _led_to_cavity_wall_mm(design), 0.1)


def _window_clearances(design: HardwareDesign) -> Iterator[Clearance]:
    shell, ring, levels = design.shell, design.ring, design.heights
    yield Clearance("isolation ring, window hole of the shell", "ring.gap_mm", ring.gap_mm, 0.03, RING + SHELL)
    yield Clearance("isolation ring, LED board", "ring.above_board_mm", ring.above_board_mm, 0.0, RING)
    yield Clearance("window, frame of the shell", "shell.frame_gap_mm", shell.frame_gap_mm, 0.05, WINDOW + SHELL)
    ledge, gel = (design.window.side_mm - shell.hole_mm) / 2, levels.rim - levels.window_top
    yield Clearance("window ledge of the shell", "window.side_mm or shell.hole_mm", ledge, 0.5)
    yield Clearance("window, gel below the skin", "camera.distance_mm or gel.thickness_mm", gel, 1.0)
    mouth = design.horizontal_dimensions.ring_side / 2 - ring.land_mm
    spare, changed = mouth - lens_view_radius_mm(design, levels.floor_top), "shell.floor_mm or shell.led_cavity_mm"
    faces = "cone of view, mouth of the isolation ring"
    yield Clearance(faces, f"shell.hole_mm, {changed}", spare, 0.0, rule="ring_cuts_the_view")
    lens = levels.floor_top - levels.lens_front
    yield Clearance("lens front, window", "shell.led_cavity_mm or shell.floor_mm", lens, 0.1)


def _camera_clearances(design: HardwareDesign) -> Iterator[Clearance]:
    camera, base, levels = design.camera, design.base, design.heights
    beside, below = _lens_to_parts_below_mm(design), levels.board_bottom - (base.floor_mm + camera.tall_mm)
    yield Clearance("lens, parts below the LED board", "board.driver_at_mm or board.usb_beyond_mm", beside, 0.3)
    yield Clearance("camera body, LED board", "base.post_tall_mm", below, 0.3)
    hole = (design.board.lens_hole_mm - _lens_diameter_mm(design, levels.board_bottom)) / 2
    yield Clearance("lens head, hole of the LED board", "board.lens_hole_mm", hole, 0.1)
    bore = (design.ring.bore_mm - _lens_diameter_mm(design, levels.ring_bottom)) / 2
    yield Clearance("lens head, bore of the ring", "ring.bore_mm", bore, 0.05, RING)
    pocket, front = (base.pocket_wide_mm - camera.side_mm) / 2, base.pocket_front_mm - camera.side_mm / 2
    yield Clearance("camera body, pocket of the base", "base.pocket_wide_mm", pocket, 0.1, BASE)
    yield Clearance("camera body, wall of the pocket at +y", "base.pocket_front_mm", front, 0.1, BASE)
    faces, behind = "camera stiffener, shoulder of the pocket", base.pocket_back_mm - camera.stiffener_mm
    yield Clearance(faces, "base.pocket_back_mm", behind, 0.1, BASE, STIFFENER_INTERFERENCE_MM)
    channel, gap = (base.channel_wide_mm - camera.cable_mm[0]) / 2, base.ramp_gap_mm - camera.cable_mm[1]
    yield Clearance("flat cable, channel", "base.channel_wide_mm", channel, 0.15, BASE)
    yield Clearance("flat cable, gap under the shell's rim", "base.ramp_gap_mm", gap, 0.0)


def _fastener_clearances(design: HardwareDesign) -> Iterator[Clearance]:
    base, plan = design.base, design.horizontal_dimensions
    (head, tall), (_, insert) = design.fasteners.head_mm, design.fasteners.insert_mm
    shank, bolt = (base.shell_screw_mm - M2_DIAMETER_MM) / 2, (base.bolt_mm - M2_DIAMETER_MM) / 2
    yield Clearance("screw shank, hole of the base", "base.shell_screw_mm", shank, 0.1, BASE)
    yield Clearance("bolt of the robot, hole of the base", "base.bolt_mm", bolt, 0.1, BASE)
    yield Clearance("screw head, counterbore", "base.counterbore_mm", (base.counterbore_mm - head) / 2, 0.05, BASE)
    rim = distance_to_edge_mm(max(plan.shell_screws), plan.outer, base.corner_radius_mm) - base.counterbore_mm / 2
    changed = "shell.wall_mm, shell.boss_inset_mm, base.counterbore_mm or base.corner_radius_mm"
    yield Clearance("counterbore, side of the base", changed, rim, MIN_RIM_MM, BASE, MIN_RIM_MM, rule="wall_too_thin")
    below = base.counterbore_deep_mm - tall
    yield Clearance("screw head below the base's face", "base.counterbore_deep_mm", below, 0.0)
    for part, table, hole in (
        ("base", "base", base.shell_screw_mm),
        ("base board", "moulds", design.moulds.shell_screw_mm),
    ):
        faces, changed = f"edge of the screw head, hole of the {part}", f"fasteners.head_mm or {table}.shell_screw_mm"
        edge, rule = (head - hole) / 2, "screws_do_not_hold"
        yield Clearance(faces, changed, edge, MIN_RIM_MM, impossible_below_mm=MIN_RIM_MM, rule=rule)
    above, changed = base.plate_mm + base.boss_tall_mm - base.floor_mm - insert, "base.boss_tall_mm or base.floor_mm"
    yield Clearance("insert, floor of the base's bore", changed, above, 0.2, BASE)
    above = design.shell.bore_deep_mm - insert
    yield Clearance("insert, floor of the shell's bore", "shell.bore_deep_mm", above, 0.2, SHELL)


def _outer_clearances(design: HardwareDesign) -> Iterator[Clearance]:
    board, shell, levels, plan = design.board, design.shell, design.heights, design.horizontal_dimensions
    faces, least = "black gel and second mould, outer edge of the shell's rim", MIN_MOULD_SEAT_MM
    changed = "shell.wall_mm, shell.corner_radius_mm, sensing_area.overlap_mm or gels.black_side_mm"
    yield Clearance(faces, changed, _mould_seat_mm(design), least, (), least, "gel_beyond_the_shell")
    yield Clearance("calibration board, shell", "pin_frame.gap_mm", design.pin_frame.gap_mm, 0.1, TRAY + SHELL)
    faces, least = "calibration board on the skin, plug's overmould below it", BOARD_PRESS_MM
    above = levels.rim - design.pin_frame.guided_mm - (levels.plate_top + shell.relief_tall_mm)
    changed = "pin_frame.guided_mm, camera.distance_mm or gel.thickness_mm"
    yield Clearance(faces, changed, above, least, (), least, "tray_does_not_pass")
    slot = levels.usb_bottom - (levels.plate_top + shell.slot_from_mm)
    yield Clearance("micro-USB receptacle, slot of the shell", "shell.slot_from_mm", slot, 0.0, SHELL)
    if shell.slot_from_mm > 0:
        faces = "micro-USB receptacle, wall below its slot while the board is lowered"
        play = min(board.gap_mm, board.notch_mm - shell.boss_mm / 2) - (board.usb_beyond_mm - board.gap_mm)
        yield Clearance(faces, "board.usb_beyond_mm, board.gap_mm or board.notch_mm", play, 0.0, SHELL)
    stop_mm = plan.outer[1] / 2 - shell.relief_deep_mm - plan.usb_mouth
    changed = "shell.relief_left_mm, shell.relief_wide_mm or board.usb_beyond_mm"
    possible = None if design.variant == "original" else 0.0
    faces, spare = "plug's overmould, mouth of the receptacle", PLUG_TOLERANCE_MM - stop_mm
    yield Clearance(faces, changed, spare, 0.0, impossible_below_mm=possible)
