"""Clearances told from dimensions against the distances of the solids."""

import pytest

from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.sensor_assembly import measure_body_pair

NEAREST = (
    ("camera", "isolation_ring", "lens head, bore of the ring"),
    ("camera", "led_board", "lens head, hole of the LED board"),
    ("camera", "acrylic_window", "lens front, window"),
    ("led_board", "sensor_shell", "notch of the LED board, screw boss of the shell"),
    ("isolation_ring", "sensor_shell", "isolation ring, window hole of the shell"),
)
"""Pairs of bodies that are nearest each other there, however large the sensor is."""
LED_AND_RING = ("led_board", "isolation_ring", "LED, isolation ring")
"""Only in the published size; in larger ones the ring is nearest to the board below it."""


def require_agreement(sensor: BuildableDesign, pairs: tuple[tuple[str, str, str], ...] = NEAREST) -> None:
    bodies = {body.name: body for body in sensor.bodies}
    told = {clearance.faces: clearance.clearance_mm for clearance in sensor.clearances}
    for first, second, between in pairs:
        # Bodies may be nearest elsewhere, a cable beside a rim: never farther than told, and about as near.
        assert measure_body_pair(bodies[first], bodies[second]).distance_mm == pytest.approx(told[between], abs=0.02), (
            between
        )
