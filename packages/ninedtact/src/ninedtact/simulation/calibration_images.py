"""Simulates the four images that calibrate a twin: two references (no contact), the pressed pin board, and the pressed ball."""

from dataclasses import dataclass, replace

import numpy as np

from ninedtact.capture.strict_image_reading import average_images
from ninedtact.design import Gel, SensorDesign
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.indenter import Ball
from ninedtact.quantities import BgrImage
from ninedtact.simulation.calibration_press_models import GRID_POINTS_PER_PIN_PITCH, pin_board_indenter
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import Twin

GUIDED_FRAMES, GUIDED_BOARD_MM = 8, 0.85
"""Number of frames that a guided calibration averages, and the depth at which imprints of the board are as dark as real ones."""
SECOND_BALL_DEPTH = 0.4
"""Largest depth of a small second ball, in radii: deeper, its disc is as wide as the ball."""
FLAT_END_EDGE_MM = 0.2
"""Radius of the lightly broken edge of a rod whose flat end is pressed."""
CALIBRATION_SOLVER_SETTINGS = SolverSettings(tolerance=5e-3)


@dataclass(frozen=True)
class HandPressImperfections:
    """How a person presses pin board and ball. Presses by hand are never exactly vertical: boards tilt, and balls are dragged."""

    board_depth_mm: float = 0.7
    board_tilt_rad: tuple[float, float] = (0.0, 0.0)
    """Tilts about x and y."""
    ball_depth_mm: float = 1.8
    ball_drag_mm: tuple[float, float] = (0.2, -0.12)
    exposure_drift: float = 0.0
    """Relative exposure of the pressed images over that of their reference images, less one."""

    def for_gel(self, gel: Gel) -> "HandPressImperfections":
        """Return the presses for a gel; one that is thinner than the published gel is pressed proportionally less deep."""
        factor = min(1.0, gel.thickness_mm / SensorDesign().gel.thickness_mm)
        return replace(self, board_depth_mm=self.board_depth_mm * factor, ball_depth_mm=self.ball_depth_mm * factor)


DEFAULT_PRESSES = HandPressImperfections()
GUIDED_PRESSES = HandPressImperfections(board_depth_mm=GUIDED_BOARD_MM)
"""The presses of a guided calibration."""


@dataclass(frozen=True)
class SimulatedCalibrationImages:
    """The BGR images that a calibration needs, with a reference image (no contact) before each press."""

    board_reference: BgrImage
    board: BgrImage
    ball_reference: BgrImage
    ball: BgrImage


def simulate_calibration_images(
    twin: Twin,
    design: SensorDesign = SensorDesign(),
    presses: HandPressImperfections = DEFAULT_PRESSES,
    frames: int = 1,
) -> SimulatedCalibrationImages:
    """Return the four calibration images of a twin.

    frames: number of images that are averaged for each of the four. Gel that is thinner than the
    published one is pressed proportionally less deep.
    """
    settings = CALIBRATION_SOLVER_SETTINGS
    finer, scaled = refine_twin_grid_for_board(twin, design), presses.for_gel(design.gel)
    board_press = ScriptedPress(scaled.board_depth_mm, tilt_rad=scaled.board_tilt_rad)
    ball_press = ScriptedPress(scaled.ball_depth_mm, drag_mm=scaled.ball_drag_mm)
    board = board_press.simulate(finer, pin_board_indenter(design.pin_board), settings)
    ball = ball_press.simulate(twin, Ball(design.ball.radius_mm), settings)
    contacts = None, board, None, ball
    drifted = replace(twin.renderer, reference=twin.renderer.reference * np.float32(1 + presses.exposure_drift))
    numbers = [range(n * frames, (n + 1) * frames) for n in range(len(contacts))]
    return SimulatedCalibrationImages(
        *(
            average_images([(twin.renderer if contact is None else drifted)(contact, number) for number in some])
            for contact, some in zip(contacts, numbers, strict=True)
        )
    )


def refine_twin_grid_for_board(twin: Twin, design: SensorDesign) -> Twin:
    """Return the twin on a grid that is fine enough for the pins of the board."""
    return replace(twin, pitch_mm=design.pin_board.pitch_mm / GRID_POINTS_PER_PIN_PITCH)
