"""Clearances between parts, computed from the dimensions alone. Negative clearances are overlaps. Lengths in mm."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise, product
from math import hypot, inf, sqrt

from ninedtact_hardware.design import HardwareDesign, distance_to_edge_mm
from ninedtact_hardware.lens_view import lens_view_radius_mm
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
    plan, levels, ((wide, deep, tall), (x, from_edge)) = (
        design.horizontal_dimensions,
        design.heights,
        (design.board.driver_mm, design.board.driver_at_mm),
    )
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
    """Return the distance from the nearest LED edge to the square of the ring, seen from above."""
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


def _board_play_mm(design: HardwareDesign) -> float:
    """Return how far the LED board can be moved away from the slot while it is lowered into the shell."""
    return min(design.board.gap_mm, design.board.notch_mm - design.shell.boss_mm / 2)


def _mould_seat_mm(design: HardwareDesign) -> float:
    """Return the least width of the shell's rim outside the black gel, at its sides and at its rounded corners; negative where
    the gel ends beyond the rim."""
    plan, inner = design.horizontal_dimensions, design.gels.rim_radius_mm + design.gels.black_side_mm
    outer = design.shell.corner_radius_mm
    sides = [(plan.outer[axis] - plan.black[axis]) / 2 for axis in (0, 1)]
    # How far the centre of the gel's corner lies beyond that of the shell's corner, x and y.
    beyond = [outer - inner - side for side in sides]
    return min(*sides, outer - inner - hypot(*beyond)) if min(beyond) > 0 else min(sides)


def _plug_stop_distance_mm(design: HardwareDesign) -> float:
    """Return how far the receptacle's mouth lies behind the face that stops the plug's overmould."""
    return (
        design.horizontal_dimensions.outer[1] / 2 - design.shell.relief_deep_mm - design.horizontal_dimensions.usb_mouth
    )


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
    """Yield the clearances of the LED board in the shell and on the base."""
    board, shell, base, levels = design.board, design.shell, design.base, design.heights
    yield Clearance("LED board, shell cavity", "board.gap_mm", board.gap_mm, 0.15, SHELL)
    yield Clearance(
        "notch of the LED board, screw boss of the shell",
        "board.notch_mm or shell.boss_mm",
        board.notch_mm - shell.boss_mm / 2,
        0.05,
        SHELL,
    )
    yield Clearance(
        "LED board, rounded ceiling of the shell",
        "board.gap_mm, shell.fillet_mm or shell.led_cavity_mm",
        _board_to_ceiling_mm(design),
        0.05,
        (*SHELL, *BASE),
    )
    yield Clearance(
        "hole of the LED board, locating pin",
        "board.locating_mm or base.pin_mm",
        (board.locating_mm - base.pin_mm) / 2,
        0.02,
        BASE,
    )
    under_floor = levels.ceiling - levels.led_top
    yield Clearance(
        "LED top, underside of the shell's floor",
        "board.thick_mm, base.post_tall_mm or shell.led_cavity_mm",
        under_floor,
        0.1,
        (*SHELL, *BASE),
        rule="led_touches_shell",
    )
    yield Clearance(
        "insert boss of the base, LED board",
        "base.boss_tall_mm or base.post_tall_mm",
        levels.board_bottom - levels.boss_top,
        0.5,
    )
    yield Clearance(
        "insert boss of the base, LED driver",
        "base.mount_inset_mm, base.boss_tall_mm or board.driver_at_mm",
        _driver_to_boss_mm(design),
        0.1,
    )
    yield Clearance("micro-USB receptacle, base plate", "base.post_tall_mm", levels.usb_bottom - levels.plate_top, 0.3)
    driver_bottom = levels.board_bottom - board.driver_mm[2]
    yield Clearance("LED driver, base plate", "base.post_tall_mm", driver_bottom - levels.plate_top, 0.3)
    yield Clearance("LED, isolation ring", "board.led_inset_mm or shell.hole_mm", _led_to_ring_mm(design), 0.1)
    yield Clearance("LED, side of the shell's lower cavity", "board.led_inset_mm", _led_to_cavity_wall_mm(design), 0.1)


def _window_clearances(design: HardwareDesign) -> Iterator[Clearance]:
    """Yield the clearances of window and isolation ring in the shell."""
    shell, ring, plan, levels = design.shell, design.ring, design.horizontal_dimensions, design.heights
    yield Clearance("isolation ring, window hole of the shell", "ring.gap_mm", ring.gap_mm, 0.03, (*RING, *SHELL))
    yield Clearance("isolation ring, LED board", "ring.above_board_mm", ring.above_board_mm, 0.0, RING)
    yield Clearance("window, frame of the shell", "shell.frame_gap_mm", shell.frame_gap_mm, 0.05, (*WINDOW, *SHELL))
    yield Clearance(
        "window ledge of the shell", "window.side_mm or shell.hole_mm", (design.window.side_mm - shell.hole_mm) / 2, 0.5
    )
    yield Clearance(
        "window, gel below the skin", "camera.distance_mm or gel.thickness_mm", levels.rim - levels.window_top, 1.0
    )
    mouth, reach = plan.ring_side / 2 - ring.land_mm, lens_view_radius_mm(design, levels.floor_top)
    yield Clearance(
        "cone of view, mouth of the isolation ring",
        "shell.hole_mm, shell.floor_mm or shell.led_cavity_mm",
        mouth - reach,
        0.0,
        rule="ring_cuts_the_view",
    )
    yield Clearance(
        "lens front, window", "shell.led_cavity_mm or shell.floor_mm", levels.floor_top - levels.lens_front, 0.1
    )


def _camera_clearances(design: HardwareDesign) -> Iterator[Clearance]:
    """Yield the clearances of the camera in base, LED board and ring."""
    camera, base, levels = design.camera, design.base, design.heights
    yield Clearance(
        "lens, parts below the LED board",
        "board.driver_at_mm or board.usb_beyond_mm",
        _lens_to_parts_below_mm(design),
        0.3,
    )
    yield Clearance(
        "camera body, LED board", "base.post_tall_mm", levels.board_bottom - (base.floor_mm + camera.tall_mm), 0.3
    )
    yield Clearance(
        "lens head, hole of the LED board",
        "board.lens_hole_mm",
        (design.board.lens_hole_mm - _lens_diameter_mm(design, levels.board_bottom)) / 2,
        0.1,
    )
    yield Clearance(
        "lens head, bore of the ring",
        "ring.bore_mm",
        (design.ring.bore_mm - _lens_diameter_mm(design, levels.ring_bottom)) / 2,
        0.05,
        RING,
    )
    yield Clearance(
        "camera body, pocket of the base", "base.pocket_wide_mm", (base.pocket_wide_mm - camera.side_mm) / 2, 0.1, BASE
    )
    yield Clearance(
        "camera body, wall of the pocket at +y",
        "base.pocket_front_mm",
        base.pocket_front_mm - camera.side_mm / 2,
        0.1,
        BASE,
    )
    behind = base.pocket_back_mm - camera.stiffener_mm
    yield Clearance(
        "camera stiffener, shoulder of the pocket", "base.pocket_back_mm", behind, 0.1, BASE, STIFFENER_INTERFERENCE_MM
    )
    yield Clearance(
        "flat cable, channel", "base.channel_wide_mm", (base.channel_wide_mm - camera.cable_mm[0]) / 2, 0.15, BASE
    )
    yield Clearance(
        "flat cable, gap under the shell's rim", "base.ramp_gap_mm", base.ramp_gap_mm - camera.cable_mm[1], 0.0
    )


def _fastener_clearances(design: HardwareDesign) -> Iterator[Clearance]:
    """Yield the clearances of screws and inserts."""
    base, fasteners, plan = design.base, design.fasteners, design.horizontal_dimensions
    head, tall = fasteners.head_mm
    yield Clearance(
        "screw shank, hole of the base", "base.shell_screw_mm", (base.shell_screw_mm - M2_DIAMETER_MM) / 2, 0.1, BASE
    )
    yield Clearance(
        "bolt of the robot, hole of the base", "base.bolt_mm", (base.bolt_mm - M2_DIAMETER_MM) / 2, 0.1, BASE
    )
    yield Clearance("screw head, counterbore", "base.counterbore_mm", (base.counterbore_mm - head) / 2, 0.05, BASE)
    rim_mm = distance_to_edge_mm(max(plan.shell_screws), plan.outer, base.corner_radius_mm) - base.counterbore_mm / 2
    yield Clearance(
        "counterbore, side of the base",
        "shell.wall_mm, shell.boss_inset_mm, base.counterbore_mm or base.corner_radius_mm",
        rim_mm,
        MIN_RIM_MM,
        BASE,
        MIN_RIM_MM,
        "wall_too_thin",
    )
    yield Clearance(
        "screw head below the base's face", "base.counterbore_deep_mm", base.counterbore_deep_mm - tall, 0.0
    )
    for part, name, hole_mm in (
        ("base", "base.shell_screw_mm", base.shell_screw_mm),
        ("base board", "moulds.shell_screw_mm", design.moulds.shell_screw_mm),
    ):
        yield Clearance(
            f"edge of the screw head, hole of the {part}",
            f"fasteners.head_mm or {name}",
            (head - hole_mm) / 2,
            MIN_RIM_MM,
            impossible_below_mm=MIN_RIM_MM,
            rule="screws_do_not_hold",
        )
    base_bore = base.plate_mm + base.boss_tall_mm - base.floor_mm
    yield Clearance(
        "insert, floor of the base's bore",
        "base.boss_tall_mm or base.floor_mm",
        base_bore - fasteners.insert_mm[1],
        0.2,
        BASE,
    )
    yield Clearance(
        "insert, floor of the shell's bore",
        "shell.bore_deep_mm",
        design.shell.bore_deep_mm - fasteners.insert_mm[1],
        0.2,
        SHELL,
    )


def _outer_clearances(design: HardwareDesign) -> Iterator[Clearance]:
    """Yield the clearances of what lies on the sensor's rim, slides over it or is plugged into it."""
    slot_bottom = design.heights.plate_top + design.shell.slot_from_mm
    yield Clearance(
        "black gel and second mould, outer edge of the shell's rim",
        "shell.wall_mm, shell.corner_radius_mm, sensing_area.overlap_mm or gels.black_side_mm",
        _mould_seat_mm(design),
        MIN_MOULD_SEAT_MM,
        impossible_below_mm=MIN_MOULD_SEAT_MM,
        rule="gel_beyond_the_shell",
    )
    yield Clearance("calibration board, shell", "pin_frame.gap_mm", design.pin_frame.gap_mm, 0.1, (*TRAY, *SHELL))
    plug_top = design.heights.plate_top + design.shell.relief_tall_mm
    yield Clearance(
        "calibration board on the skin, plug's overmould below it",
        "pin_frame.guided_mm, camera.distance_mm or gel.thickness_mm",
        design.heights.rim - design.pin_frame.guided_mm - plug_top,
        BOARD_PRESS_MM,
        impossible_below_mm=BOARD_PRESS_MM,
        rule="tray_does_not_pass",
    )
    yield Clearance(
        "micro-USB receptacle, slot of the shell",
        "shell.slot_from_mm",
        design.heights.usb_bottom - slot_bottom,
        0.0,
        SHELL,
    )
    if design.shell.slot_from_mm > 0:
        yield Clearance(
            "micro-USB receptacle, wall below its slot while the board is lowered",
            "board.usb_beyond_mm, board.gap_mm or board.notch_mm",
            _board_play_mm(design) - (design.board.usb_beyond_mm - design.board.gap_mm),
            0.0,
            SHELL,
        )
    spare, forgiven = PLUG_TOLERANCE_MM - _plug_stop_distance_mm(design), None if design.variant == "original" else 0.0
    yield Clearance(
        "plug's overmould, mouth of the receptacle",
        "shell.relief_left_mm, shell.relief_wide_mm or board.usb_beyond_mm",
        spare,
        0.0,
        impossible_below_mm=forgiven,
    )
