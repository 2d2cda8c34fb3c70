"""Rules of moulds, gels and screws, and of what the camera must see. Lengths in mm."""

from collections.abc import Iterator
from math import sqrt

from ninedtact.hardware.buildability.mechanical_rules import BrokenRule, DesignRule
from ninedtact.hardware.design import (
    HardwareDesign,
    lens_reach_mm,
    required_camera_distance_mm,
    sensing_corner_radius_mm,
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


def _check_gel_seat(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the translucent gel and its black coat end on the shell's rim."""
    plan = design.plan_view
    if min(plan.outer[axis] - plan.black[axis] for axis in (0, 1)) < 0:
        yield BrokenRule(
            "gel_beyond_the_shell",
            f"expected the black gel within the shell's {plan.outer[0]:g} x {plan.outer[1]:g} mm, got {plan.black[0]:g} x "
            f"{plan.black[1]:g} mm; thicken shell.wall_mm, or reduce sensing_area.overlap_mm or gels.black_side_mm",
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
    (wide, deep), gap_mm = design.plan_view.outer, M3_NUT_WIDTH_MM / 2
    for x, y in design.plan_view.clamps:
        if abs(x) < wide / 2 + gap_mm and abs(y) < deep / 2 + gap_mm:
            yield BrokenRule(
                "clamps_in_the_shell",
                f"expected the moulds' screws {gap_mm:.2f} mm beside the shell, got one at ({x:g}, {y:g}) mm; raise "
                "moulds.beyond_mm",
            )
            return


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
    reach, corner = lens_reach_mm(design), sensing_corner_radius_mm(design)
    if reach < corner - 1e-6:
        yield BrokenRule(
            "lens_does_not_see_the_corner",
            f"expected the lens to reach the sensing area's corner, {corner:.1f} mm from the middle, got {reach:.1f} mm; set "
            f"camera.distance_mm to {required_camera_distance_mm(design) + 0.05:.1f}, or make the area smaller",
        )


def _check_window_size(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that the window does not cut off the cone of view at its upper face."""
    reach, half = lens_reach_mm(design, design.heights.window_top), design.window.side_mm / 2
    if reach > half:
        yield BrokenRule(
            "window_cuts_the_view",
            f"expected a window of at least {2 * reach:.1f} mm, got {design.window.side_mm:g} mm; enlarge it and its hole",
        )


def _check_pins_in_view(design: HardwareDesign) -> Iterator[BrokenRule]:
    """Check that all pins press within the sensing area, so that their imprints are seen whole."""
    board, area = design.sensor.pin_board, design.sensor.sensing_area
    for axis, count, side in (("cols", board.cols, area.width_mm), ("rows", board.rows, area.height_mm)):
        most = int((side - board.pin_diameter_mm) / board.pitch_mm + 1e-9) + 1
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


MOULDING_AND_VIEW_RULES: tuple[DesignRule, ...] = (
    _check_camera_distance,
    _check_lens_coverage,
    _check_window_size,
    _check_pins_in_view,
    _check_pin_spacing,
    _check_mould_thickness,
    _check_screw_lengths,
    _check_insert_bores,
    _check_gel_seat,
    _check_calibration_board_fit,
    _check_clamp_positions,
)
