"""From the connector to the driver, below the board: 5 V passes right of the lens hole, ground left of it."""

from math import hypot

from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.driver_routes import ground_column, via
from ninedtact.hardware.led_board.netlist import GROUND, SUPPLY
from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.pads import Pad, place_of
from ninedtact.hardware.led_board.ring_routes import rim
from ninedtact.hardware.led_board.tracks import Routes, Track

SIDE_PAD_MM = 1.50, 1.20
"""The connector's pads between which and the lens hole the lines squeeze through."""


def usb_routes(board: LedBoard, pads: tuple[Pad, ...]) -> Routes:
    """Supply, ground, and the shield if it is tied."""
    routes = supply_routes(board, pads) + ground_routes(board, pads)
    return routes + shield_routes(board, pads) if board.shield_tied else routes


def squeeze(board: LedBoard, pads: tuple[Pad, ...], contact: str, side_pad: str) -> tuple[Place, ...]:
    """From a contact between the lens hole and a side pad's corner, and on along the hole's tangent."""
    (pin_x, _), (x, y), (_, usb_y) = place_of(pads, contact), place_of(pads, side_pad), board.usb
    outward = 1 if x > board.usb_x_mm else -1
    corner = x - outward * SIDE_PAD_MM[0] / 2, y + SIDE_PAD_MM[1] / 2
    far = hypot(*corner)
    reach = squeezed(board, far)
    ray = corner[0] / far, corner[1] / far
    between = ray[0] * reach, ray[1] * reach
    beyond = between[0] - outward * ray[1] * 2.8, between[1] + outward * ray[0] * 2.8
    return (pin_x, usb_y + 0.44 + board.usb_contact_mm), between, beyond


def squeezed(board: LedBoard, corner_mm: float) -> float:
    """How far from the lens a line runs past a corner at that distance: in the middle of the gap, if that is narrow."""
    rules, half = board.rules, board.copper.neck_mm / 2
    most = corner_mm - rules.clearance_mm - half - 0.005
    room = most - board.outline.lens_hole_mm / 2 - rules.copper_to_edge_mm - half
    return most - min(max(room, 0.0) / 2, 0.5)


def supply_routes(board: LedBoard, pads: tuple[Pad, ...]) -> Routes:
    """5 V to the driver's enable pin, under the driver to its two supply pins, and to the capacitor."""
    (x, _), enable, pin = board.driver, place_of(pads, "U1.8"), place_of(pads, "U1.3")
    neck, last = squeeze(board, pads, "USB3.1", "USB3.7"), place_of(pads, "U1.4")
    under = x - 1.375
    narrow = [neck, ((x - 0.79, enable[1]), (under, enable[1] + 0.585), (under, pin[1]), pin)]
    wide: list[tuple[Place, ...]] = [
        (neck[-1], (enable[0], neck[-1][1]), enable),
        (enable, (x - 0.79, enable[1])),
        (pin, last),
    ]
    if board.input_capacitor:
        wide.append((last, place_of(pads, "C1.1")))
    lines = [(board.copper.neck_mm, line) for line in narrow] + [(board.copper.supply_mm, line) for line in wide]
    return Routes(tuple(Track(SUPPLY, "bottom", width, line) for width, line in lines))


def ground_routes(board: LedBoard, pads: tuple[Pad, ...]) -> Routes:
    """From the ground contact up to the row left of the driver; vias that hold the pours of both sides together."""
    neck, column, y = squeeze(board, pads, "USB3.5", "USB3.6"), ground_column(board), board.driver[1]
    up = (neck[-1], (column, neck[-1][1]), (column, y))
    tracks = (
        Track(GROUND, "bottom", board.copper.neck_mm, neck),
        Track(GROUND, "bottom", board.copper.ground_mm, up),
    )
    places = ((column, 2.6), (column, -2.6), (1.5 - board.outline.half[0], 0.0)) if board.copper.pour else ()
    return Routes(tracks, tuple(via(board, GROUND, place) for place in places))


def shield_routes(board: LedBoard, pads: tuple[Pad, ...]) -> Routes:
    """Ground contact to the shield's left pad; both sides' pads to their legs; the legs, above, to the edge's ground."""
    contact, left = place_of(pads, "USB3.5"), place_of(pads, "USB3.6")
    y, width = left[1] + 0.17, min(board.copper.ground_mm, 0.5)
    tracks = [Track(GROUND, "bottom", width, ((contact[0], y), (left[0], y)))]
    for pad, leg in (("USB3.6", "USB3.8"), ("USB3.7", "USB3.9")):
        foot = place_of(pads, leg)
        tracks.append(Track(GROUND, "bottom", width, (place_of(pads, pad), foot)))
        tracks.append(Track(GROUND, "top", width, (foot, (foot[0], -rim(board)))))
    return Routes(tuple(tracks))
