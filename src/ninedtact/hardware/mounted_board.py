"""The LED board that fits a design: its outline, holes and parts handed to the room of the circuit board."""

from dataclasses import replace

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.footprints import led_2835, micro_usb, soic_8_ep
from ninedtact.hardware.led_board.lattice import LedLattice
from ninedtact.hardware.led_board.outline import BoardOutline
from ninedtact.hardware.led_board.refusal import BoardImpossible

Block = tuple[float, float, float]


def led_board_of(design: HardwareDesign) -> LedBoard:
    """The board in its size; the original's parts and faults only in the original's size. Raises `BoardImpossible`."""
    width, height = design.plan.circuit
    original = LedBoard.original()
    as_published = (width, height) == (original.outline.width_mm, original.outline.height_mm)
    made = original if design.variant == "original" and as_published else LedBoard.for_size(width, height)
    require_bodies(design, made)
    receptacle, (driver_x, from_edge) = micro_usb(made.usb_contact_mm), design.board.driver_at_mm
    return replace(
        made,
        outline=outline_of(design, made.outline),
        leds=LedLattice(design.plan.led_columns, design.plan.led_rows),
        usb_inset_mm=receptacle.body_at_mm[1] + receptacle.body_mm[1] / 2 - design.board.usb_beyond_mm,
        driver_x_mm=driver_x,
        driver_inset_mm=-from_edge,
        resistor_ohm=design.board.resistor_ohm,
    )


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
        boss_inset_mm=(plan.circuit[0] / 2 - mount[0], plan.circuit[1] / 2 - mount[1]),
        boss_mm=design.base.boss_mm,
        boss_gap_mm=levels.board_bottom - levels.boss_top,
    )


def require_bodies(design: HardwareDesign, made: LedBoard) -> None:
    """Refuse parts of another size than those that the circuit board has pads for; raises `BoardImpossible`."""
    board, driver = design.board, soic_8_ep().body_mm
    require_body("led_mm", board.led_mm, led_2835(made.led_pad_corner_mm).body_mm)
    require_body("usb_mm", board.usb_mm, micro_usb(made.usb_contact_mm).body_mm)
    # It lies on the board turned by a right angle.
    require_body("driver_mm", board.driver_mm, (driver[1], driver[0], driver[2]))


def require_body(name: str, body_mm: Block, drawn_mm: Block) -> None:
    """One of them; its height is free."""
    if body_mm[:2] != drawn_mm[:2]:
        raise BoardImpossible(
            f"expected board.{name} of {drawn_mm[0]:g} x {drawn_mm[1]:g} mm, the part that the circuit board has pads for, got "
            f"{body_mm[0]:g} x {body_mm[1]:g} mm; leave it, or draw that part's footprint"
        )
