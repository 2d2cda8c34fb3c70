"""The LED board that fits a design: its outline, holes and LEDs handed to the room of the circuit board."""

from dataclasses import replace

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.outline import BoardOutline


def led_board_of(design: HardwareDesign) -> LedBoard:
    """The board in its size; the original's parts and faults only in the original's size. Raises `BoardImpossible`."""
    width, height = design.plan.circuit
    original = LedBoard.original()
    if design.variant == "original" and (width, height) == (original.outline.width_mm, original.outline.height_mm):
        return original
    made = LedBoard.for_size(width, height)
    return replace(made, outline=outline_of(design, made.outline))


def outline_of(design: HardwareDesign, outline: BoardOutline) -> BoardOutline:
    """Holes and notches where shell and base have their bosses and pins."""
    plan, board, levels = design.plan, design.board, design.levels
    mount, screw = max(plan.mount_inserts), max(plan.shell_screws)
    return replace(
        outline,
        thickness_mm=board.thick_mm,
        lens_hole_mm=board.lens_hole_mm,
        notch_radius_mm=board.notch_mm,
        notch_inset_mm=(plan.circuit[0] / 2 - screw[0], plan.circuit[1] / 2 - screw[1]),
        locating_hole_mm=board.locating_mm,
        locating_inset_mm=board.locating_inset_mm,
        boss_at_mm=mount,
        boss_mm=design.base.boss_mm,
        boss_gap_mm=levels.board_bottom - levels.boss_top,
    )
