"""What the camera must see, and what must press inside its view."""

from collections.abc import Iterator

from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.optics import corner_mm, distance_to_see_mm, reach_mm
from ninedtact.hardware.rules.rule import Broken

FARTHEST_MM = 200.0
APART_MM = 0.6
"""Least skin between pins: imprints must not run into each other."""


def camera_too_far(design: HardwareDesign) -> Iterator[Broken]:
    """A sensor as tall as an arm."""
    distance = design.sensor.camera.distance_mm
    if distance > FARTHEST_MM:
        yield Broken(
            "camera_too_far",
            f"expected the camera at most {FARTHEST_MM:g} mm from the skin, got {distance:g} mm; lessen camera.distance_mm",
        )


def lens_does_not_see_the_corner(design: HardwareDesign) -> Iterator[Broken]:
    """The sensing area's corners, through air, acrylic and silicone."""
    reach, corner = reach_mm(design), corner_mm(design)
    if reach < corner - 1e-6:
        yield Broken(
            "lens_does_not_see_the_corner",
            f"expected the lens to reach the sensing area's corner, {corner:.1f} mm from the middle, got {reach:.1f} mm; set "
            f"camera.distance_mm to {distance_to_see_mm(design) + 0.05:.1f}, or make the area smaller",
        )


def window_cuts_the_view(design: HardwareDesign) -> Iterator[Broken]:
    """The cone of sight at the window's upper face."""
    reach, half = reach_mm(design, design.levels.window_top), design.window.side_mm / 2
    if reach > half:
        yield Broken(
            "window_cuts_the_view",
            f"expected a window of at least {2 * reach:.1f} mm, got {design.window.side_mm:g} mm; enlarge it and its hole",
        )


def pins_out_of_view(design: HardwareDesign) -> Iterator[Broken]:
    """Pins beside the sensing area: their imprints would not be seen whole."""
    board, area = design.sensor.pin_board, design.sensor.sensing_area
    for axis, count, side in (("cols", board.cols, area.width_mm), ("rows", board.rows, area.height_mm)):
        most = int((side - board.pin_diameter_mm) / board.pitch_mm + 1e-9) + 1
        if count > most:
            yield Broken(
                "pins_out_of_view",
                f"expected at most {most} {axis} of pins {board.pitch_mm:g} mm apart within {side:g} mm of sensing area, got "
                f"{count}; {fewer(axis, most)}",
            )


def fewer(axis: str, most: int) -> str:
    """What to do about it: a lens is fitted to three at the least."""
    return f"set pin_board.{axis} to {most}" if most >= 3 else "narrow pin_board.pitch_mm and take thinner pins"


def pins_too_close(design: HardwareDesign) -> Iterator[Broken]:
    """Pins whose imprints would join."""
    board = design.sensor.pin_board
    if board.pitch_mm < board.pin_diameter_mm + APART_MM:
        yield Broken(
            "pins_too_close",
            f"expected a pitch of at least {board.pin_diameter_mm + APART_MM:.2f} mm between pins of {board.pin_diameter_mm:g} mm, "
            f"got {board.pitch_mm:g} mm; widen pin_board.pitch_mm, or take thinner pins",
        )
    if design.pin_frame.pin_tall_mm < board.pin_diameter_mm / 2:
        yield Broken(
            "pin_too_short",
            f"expected pins as tall as half their diameter, {board.pin_diameter_mm / 2:g} mm, got "
            f"{design.pin_frame.pin_tall_mm:g} mm; raise pin_frame.pin_tall_mm",
        )
