"""The twin of a design put through what a sensor goes through: calibrated by its board and ball, then pressed by another ball."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ninedtact.calibration.flow import CalibrationPictures, calibrate
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.design import SensorDesign
from ninedtact.force.traction.estimator import traction_force
from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.indenter import Ball
from ninedtact.quantities import Frame, HeightMap, Reading
from ninedtact.shape.calibrated import CalibratedShape
from ninedtact.simulation.designed import designed_twin
from ninedtact.simulation.gauges import gauge_pictures
from ninedtact.simulation.press import Press
from ninedtact.simulation.truth import heights_like
from ninedtact.simulation.twin import Twin

OTHER_BALL = Ball(5.0)
BOARD_DEPTH_MM, FRAMES = 0.85, 8
"""How deep the board is pressed, and how many pictures each step of a guided calibration averages."""
DEPTH_PART, PLACE_PART = 0.5, 0.125
"""Of the gel's thickness and of the sensing area: how deep and how far off the middle the other ball is pressed."""
PRESSED_MM = 0.05
"""Skin that is deeper counts: what the noise of a picture stays below."""


@dataclass(frozen=True)
class Proof:
    """What the calibrated twin reads of a press that it was not calibrated with."""

    depth_error_mm: float
    """Mean absolute error of the height where the skin is pressed in."""
    load_error_part: float
    """Error of the load by physics, of the load; the modulus is taken as designed."""


def proof(design: SensorDesign) -> Proof:
    """Some ten seconds; raises `BoardNotFound`, `BallRefused` where the design cannot be calibrated, and what pressing raises."""
    twin = designed_twin(design)
    pictures = gauge_pictures(twin, design, board_depth_mm=BOARD_DEPTH_MM, frames=FRAMES)
    made = calibrate(CalibrationPictures(**vars(pictures)), design)
    shape, gel = SensorFolder(Path(), made.record).shape, made.record.twin.gel if made.record.twin else design.gel
    contact = other_press(design).on(twin, OTHER_BALL)
    reading = read(shape, twin, contact)
    load_n, read_n = (
        -wrench.force_n[2] for wrench in (contact.wrench(), traction_force(shape, gel).estimate(reading).wrench)
    )
    return Proof(depth_error_mm(twin, contact, reading.height), float(abs(read_n - load_n) / load_n))


def other_press(design: SensorDesign) -> Press:
    """Off the middle, less deep than the gel bears."""
    x, y = (PLACE_PART * side for side in design.sensing_area.size_mm)
    return Press(DEPTH_PART * design.gel.thickness_mm, at_mm=(x, -y))


def read(shape: CalibratedShape, twin: Twin, contact: Contact) -> Reading:
    """What the sensor makes of one picture of this contact."""
    depth = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(-FRAMES, 0)))
    frame = Frame(twin.renderer(contact, 1))
    rectified = shape.rectify(frame)
    return Reading(frame, rectified, depth(rectified), reference=depth.reference)


def depth_error_mm(twin: Twin, contact: Contact, seen: HeightMap) -> float:
    """Beside the truth, pixel by pixel."""
    true = heights_like(contact, seen, twin.renderer.light.nearness_per_mm)
    return float(np.abs(seen.z_mm - true.z_mm)[true.z_mm < -PRESSED_MM].mean())
