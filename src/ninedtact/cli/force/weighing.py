"""A twin weighed as a person weighs a sensor: a ball pressed on it on a kitchen scale, some presses of known weight."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ninedtact.force.estimator import ForceEstimator
    from ninedtact.force.force_scale import KnownLoadPress
    from ninedtact.reading import Reading
    from ninedtact.shape.calibrated_shape import CalibratedShape
    from ninedtact.simulation.sensor_population import SampledSensor

RADIUS_MM, DEPTH_MM = 5.0, 0.8
"""Of the ball; where the search for its weight begins."""
PRESSES = ((0.0, 0.0, 1.0), (2.5, 1.5, 1.0), (0.0, 0.0, 2.5), (-2.5, -1.5, 5.0), (2.0, -1.5, 5.0))
"""x and y in mm, and newtons: 100 to 500 g."""
PITCH_MM = 0.3
"""Of the grid on which they are solved: a ball is smooth."""
UNTOUCHED = 8
"""Images averaged."""


def weighed(estimator: "ForceEstimator", member: "SampledSensor", shape: "CalibratedShape") -> "ForceEstimator":
    """The estimator adapted by these presses, as `ninedtact adapt` does it; as it is where it reads one of them as no press."""
    from ninedtact.force.force_scale import ForceScaleImpossible, ScaledForceEstimator, fit_force_scale

    try:
        return ScaledForceEstimator(estimator, fit_force_scale(list(presses(estimator, member, shape))).adaptation)
    except ForceScaleImpossible:
        return estimator


def presses(
    estimator: "ForceEstimator", member: "SampledSensor", shape: "CalibratedShape"
) -> "Iterator[KnownLoadPress]":
    """What the estimator reads, and what the scale shows."""
    from ninedtact.force.force_scale import KnownLoadPress

    for reading, load_n in readings(member, shape):
        estimator.forget()
        yield KnownLoadPress(max(0.0, -float(estimator.estimate(reading).wrench.force_n[2])), load_n)


def readings(member: "SampledSensor", shape: "CalibratedShape") -> "Iterator[tuple[Reading, float]]":
    """Every press as the sensor reads it, and its load."""
    from ninedtact.mechanics.indenter_primitives import Ball
    from ninedtact.mechanics.pose import Pose
    from ninedtact.quantities import Frame
    from ninedtact.reading import Reading

    twin = member.twin(PITCH_MM)
    depth = shape.depth_reader(*(Frame(twin.renderer(None, number)) for number in range(-UNTOUCHED, 0)))
    for number, (x, y, load_n) in enumerate(PRESSES):
        contact = twin.correct_contact(twin.step(twin.model.untouched(), Ball(RADIUS_MM), Pose(x, y, DEPTH_MM), load_n))
        frame = Frame(twin.renderer(contact, number))
        rectified = shape.rectify(frame)
        reading = Reading(frame, rectified, depth(rectified), reference=depth.reference)
        yield reading, -float(contact.wrench().force_n[2])
