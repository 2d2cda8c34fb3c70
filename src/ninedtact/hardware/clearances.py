"""Room between parts, from their dimensions alone. Negative: they overlap. Lengths in mm."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot

from ninedtact.hardware.design import HardwareDesign

BASE, SHELL, RING, WINDOW, TRAY = (
    (name,) for name in ("sensor_base", "sensor_shell", "isolation_ring", "acrylic_window", "calibration_board")
)


@dataclass(frozen=True)
class Clearance:
    """One pair of faces that pass or face each other."""

    between: str
    mm: float
    least_mm: float
    """What printing, cutting or moulding needs."""
    held_by: tuple[str, ...] = ()
    """Parts to be made on whose accuracy it rests, where that matters; their drawings list it."""

    @property
    def tight(self) -> bool:
        """Less than is needed."""
        return self.mm < self.least_mm - 1e-9


def clearances(design: HardwareDesign) -> Iterator[Clearance]:
    """All of them; those of diameters are per side."""
    yield from round_the_board(design)
    yield from round_the_window(design)
    yield from round_the_camera(design)
    yield from round_the_screws(design)
    yield from outside(design)


def round_the_board(design: HardwareDesign) -> Iterator[Clearance]:
    """LED board in the shell and on the base."""
    board, shell, base, levels = design.board, design.shell, design.base, design.levels
    yield Clearance("LED board, shell cavity", board.gap_mm, 0.15, SHELL)
    yield Clearance("notch of the LED board, screw boss of the shell", board.notch_mm - shell.boss_mm / 2, 0.05, SHELL)
    yield Clearance("hole of the LED board, locating pin", (board.locating_mm - base.pin_mm) / 2, 0.02, BASE)
    yield Clearance("LED top, underside of the shell's floor", levels.ceiling - levels.led_top, 0.1, (*SHELL, *BASE))
    yield Clearance("insert boss of the base, LED board", levels.board_bottom - levels.boss_top, 0.5)
    yield Clearance("micro-USB receptacle, base plate", levels.usb_bottom - levels.plate_top, 0.3)
    yield Clearance("LED, isolation ring", led_to_ring(design), 0.1)


def round_the_window(design: HardwareDesign) -> Iterator[Clearance]:
    """Window and ring in the shell."""
    shell, ring, levels = design.shell, design.ring, design.levels
    yield Clearance("isolation ring, window hole of the shell", ring.gap_mm, 0.03, (*RING, *SHELL))
    yield Clearance("isolation ring, LED board", ring.above_board_mm, 0.0, RING)
    yield Clearance("window, frame of the shell", shell.frame_gap_mm, 0.05, (*WINDOW, *SHELL))
    yield Clearance("window ledge of the shell", (design.window.side_mm - shell.hole_mm) / 2, 0.5)
    yield Clearance("window, gel below the skin", levels.rim - levels.window_top, 1.0)
    yield Clearance("lens front, window", levels.floor_top - levels.lens_front, 0.1)


def round_the_camera(design: HardwareDesign) -> Iterator[Clearance]:
    """Camera in base, board and ring."""
    camera, base = design.camera, design.base
    yield Clearance("lens head, hole of the LED board", (design.board.lens_hole_mm - camera.head_mm[0]) / 2, 0.1)
    yield Clearance("lens head, bore of the ring", (design.ring.bore_mm - camera.head_mm[0]) / 2, 0.05, RING)
    yield Clearance("camera body, pocket of the base", (base.pocket_wide_mm - camera.side_mm) / 2, 0.1, BASE)
    yield Clearance("camera stiffener, shoulder of the pocket", base.pocket_back_mm - camera.stiffener_mm, 0.1, BASE)
    yield Clearance("flat cable, channel", (base.channel_wide_mm - camera.cable_mm[0]) / 2, 0.15, BASE)
    yield Clearance("flat cable, gap under the shell's rim", base.ramp_gap_mm - camera.cable_mm[1], 0.0)


def round_the_screws(design: HardwareDesign) -> Iterator[Clearance]:
    """Screws, inserts and the USB plug."""
    base, fasteners = design.base, design.fasteners
    head, tall = fasteners.head_mm
    yield Clearance("screw shank, hole of the base", (base.shell_screw_mm - 2.0) / 2, 0.1, BASE)
    yield Clearance("bolt of the robot, hole of the base", (base.bolt_mm - 2.0) / 2, 0.1, BASE)
    yield Clearance("screw head, counterbore", (base.counterbore_mm - head) / 2, 0.05, BASE)
    yield Clearance("screw head below the base's face", base.counterbore_deep_mm - tall, 0.0)
    yield Clearance("insert, floor of the shell's bore", design.shell.bore_deep_mm - fasteners.insert_mm[1], 0.2, SHELL)


def outside(design: HardwareDesign) -> Iterator[Clearance]:
    """What is slid over the sensor, or into it."""
    slot_bottom = design.levels.plate_top + design.shell.slot_from_mm
    yield Clearance("calibration board, shell", design.pin_frame.gap_mm, 0.1, (*TRAY, *SHELL))
    yield Clearance("micro-USB receptacle, slot of the shell", design.levels.usb_bottom - slot_bottom, 0.0, SHELL)
    yield Clearance("plug's overmould, mouth of the receptacle", 1.0 - plug_stopped_mm(design), 0.0)


def led_to_ring(design: HardwareDesign) -> float:
    """Nearest LED edge to the ring's square, seen from above."""
    half = (design.shell.hole_mm - 2 * design.ring.gap_mm) / 2
    wide, deep, _ = design.board.led_mm
    return min(
        hypot(max(abs(x) - wide / 2 - half, 0.0), max(abs(y) - deep / 2 - half, 0.0)) for x, y in design.plan.leds
    )


def plug_stopped_mm(design: HardwareDesign) -> float:
    """How far behind the face that stops a plug's overmould the receptacle's mouth is; a plug forgives about 1.0."""
    shell, face = design.shell, design.plan.outer[1] / 2
    return face - (shell.relief_deep_mm if shell.relief_wide_mm else 0.0) - design.plan.usb_mouth
