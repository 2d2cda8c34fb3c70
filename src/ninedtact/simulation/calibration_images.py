"""The four images that calibrate a twin, taken of itself: its board and its ball pressed as a hand presses them."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.capture.image_file import average_images
from ninedtact.design import PinBoard, SensorDesign
from ninedtact.mechanics.alternating_solver import SolverSettings
from ninedtact.mechanics.height_grid_indenter import HeightGridIndenter, indenter_from_heights
from ninedtact.mechanics.indenter_primitives import Ball
from ninedtact.simulation.renderer import BgrImage
from ninedtact.simulation.scripted_press import ScriptedPress
from ninedtact.simulation.twin import Twin

TABLE_PITCH_MM = 0.05
GRID_POINTS_PER_PIN_PITCH = 20
"""Grid points between pins: a whole number, so that all pins are solved alike."""
PIN_TALL_MM = 1.5
"""Over the floor of the published board."""
BOARD_DEPTH_MM = 0.7
GUIDED_FRAMES, GUIDED_BOARD_MM = 8, 0.85
"""Images averaged for each, as a guided calibration does; how deep a board is pressed whose imprints are as dark as real ones."""
BALL_DEPTH_MM = 1.8
BALL_DRAG_MM = 0.2, -0.12
"""A hand never presses straight."""
CALIBRATION_SOLVER_SETTINGS = SolverSettings(tolerance=5e-3)


@dataclass(frozen=True)
class SimulatedCalibrationImages:
    """What a calibration asks for, BGR; untouched skin before each press."""

    board_reference: BgrImage
    board: BgrImage
    ball_reference: BgrImage
    ball: BgrImage


def simulate_calibration_images(
    twin: Twin,
    design: SensorDesign = SensorDesign(),
    first_number: int = 0,
    board_depth_mm: float = BOARD_DEPTH_MM,
    frames: int = 1,
) -> SimulatedCalibrationImages:
    """The twin's own calibration images; `first_number` picks their noise. frames: how many are averaged for each, as a
    guided calibration averages eight. Gel that is thinner than the published one is pressed as much less deep."""
    finer = replace(twin, pitch_mm=design.pin_board.pitch_mm / GRID_POINTS_PER_PIN_PITCH)
    thinner = min(1.0, design.gel.thickness_mm / SensorDesign().gel.thickness_mm)
    board = ScriptedPress(board_depth_mm * thinner).on(
        finer, pin_board_indenter(design.pin_board), CALIBRATION_SOLVER_SETTINGS
    )
    ball = ScriptedPress(BALL_DEPTH_MM * thinner, drag_mm=BALL_DRAG_MM).on(
        twin, Ball(design.ball.radius_mm), CALIBRATION_SOLVER_SETTINGS
    )
    contacts = None, board, None, ball
    numbers = [range(first_number + n * frames, first_number + (n + 1) * frames) for n in range(len(contacts))]
    return SimulatedCalibrationImages(
        *(
            average_images([twin.renderer(contact, number) for number in some])
            for contact, some in zip(contacts, numbers, strict=True)
        )
    )


def pin_board_indenter(board: PinBoard) -> HeightGridIndenter:
    """The board's underside: hemispheres on cylinders on a floor."""
    half = [(count - 1) / 2 * board.pitch_mm + board.pitch_mm / 2 for count in (board.cols, board.rows)]
    x, y = np.meshgrid(*(np.linspace(-reach, reach, round(2 * reach / TABLE_PITCH_MM) + 1) for reach in half))
    from_pin = np.hypot(
        _distance_to_nearest_pin_mm(x, board.cols, board.pitch_mm),
        _distance_to_nearest_pin_mm(y, board.rows, board.pitch_mm),
    )
    radius = board.pin_diameter_mm / 2
    tip = radius - np.sqrt(np.maximum(radius**2 - from_pin**2, 0))
    return indenter_from_heights("pin_board", np.where(from_pin < radius, tip, PIN_TALL_MM), TABLE_PITCH_MM)


def _distance_to_nearest_pin_mm(
    place_mm: Float[Array, "rows cols"], pins: int, pitch_mm: float
) -> Float[Array, "rows cols"]:
    """Distance from the nearest pin along one axis."""
    index = np.clip(np.rint(place_mm / pitch_mm + (pins - 1) / 2), 0, pins - 1)
    return np.abs(place_mm - (index - (pins - 1) / 2) * pitch_mm)
