"""The twin of a design put through what a sensor goes through: calibrated by its board and ball, then pressed by another ball."""

from dataclasses import dataclass
from pathlib import Path

from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.design import SensorDesign
from ninedtact.force.traction.estimator import traction_force
from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.indenter_primitives import Ball
from ninedtact.quantities import Frame
from ninedtact.reading import Reading
from ninedtact.shape.calibrated import CalibratedShape
from ninedtact.simulation.designed import designed_twin
from ninedtact.simulation.gauges import GUIDED_BOARD_MM, GUIDED_FRAMES, gauge_images
from ninedtact.simulation.press import Press
from ninedtact.simulation.truth import heights_like, mean_error_mm
from ninedtact.simulation.twin import Twin

OTHER_BALL = Ball(5.0)
DEPTH_PART, PLACE_PART = 0.5, 0.125
"""Of the gel's thickness and of the sensing area: how deep and how far off the middle the other ball is pressed."""


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
    images = gauge_images(twin, design, board_depth_mm=GUIDED_BOARD_MM, frames=GUIDED_FRAMES)
    made = calibrate(CalibrationImages(**vars(images)), design)
    shape, gel = SensorFolder(Path(), made.record).shape, made.record.twin.gel if made.record.twin else design.gel
    contact = other_press(design).on(twin, OTHER_BALL)
    reading = read(shape, twin, contact)
    true = heights_like(contact, reading.height, twin.renderer.light.nearness_per_mm)
    load_n, read_n = (
        -wrench.force_n[2] for wrench in (contact.wrench(), traction_force(shape, gel).estimate(reading).wrench)
    )
    return Proof(mean_error_mm(true, reading.height), float(abs(read_n - load_n) / load_n))


def other_press(design: SensorDesign) -> Press:
    """Off the middle, less deep than the gel bears."""
    x, y = (PLACE_PART * side for side in design.sensing_area.size_mm)
    return Press(DEPTH_PART * design.gel.thickness_mm, at_mm=(x, -y))


def read(shape: CalibratedShape, twin: Twin, contact: Contact) -> Reading:
    """What the sensor makes of one image of this contact."""
    depth = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(-GUIDED_FRAMES, 0)))
    frame = Frame(twin.renderer(contact, 1))
    rectified = shape.rectify(frame)
    return Reading(frame, rectified, depth(rectified), reference=depth.reference)
