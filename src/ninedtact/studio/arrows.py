"""A wrench in the 3D part of the page: an arrow where its force goes through the skin, an arc for what twists there."""

import numpy as np
from jaxtyping import Float32, Float64
from numpy import ndarray as Array
from viser import ArrowsHandle, ViserServer

from ninedtact.quantities import Wrench

MM_PER_N = 0.5
ARC_DEG_PER_MNM = 4.0
MOST_ARC_DEG = 330.0
ARC_RADIUS_MM = 4.5
LIFT_MM = 0.6
"""Of the arc over the skin, which bulges."""
LEAST_N = 0.1
"""Less presses nothing that would have a place."""
ARC_PIECES = 48
LEAST_ARC_DEG = 8.0
"""Shorter than its head."""
FORCE, TWIST = (201, 42, 42), (95, 61, 196)
SHAFT_MM, HEAD_MM, HEAD_LONG_MM = 0.22, 0.55, 1.2


class Arrows:
    """One wrench in the scene; an arrow's head is on the untouched skin where the force goes through it."""

    def __init__(self, server: ViserServer, name: str) -> None:
        self._force = arrow(server, f"/{name}/force", FORCE)
        self._twist = arrow(server, f"/{name}/twist", TWIST)
        whole = np.zeros((ARC_PIECES, 2, 3), np.float32)
        self._arc = server.scene.add_line_segments(
            f"/{name}/arc", whole, TWIST, thickness=4.0, thickness_units="screen", visible=False
        )

    def show(self, wrench: Wrench | None) -> None:
        """Draw it; nothing where nothing presses."""
        place = None if wrench is None else centre_mm(wrench)
        if wrench is None or place is None:
            self._force.visible = self._twist.visible = self._arc.visible = False
            return
        turn_deg = arc_deg(float(wrench.about(place).torque_nm[2]))
        arc = arc_mm(place, turn_deg)
        self._force.points = np.array([[place - wrench.force_n * MM_PER_N, place]], np.float32)
        self._arc.points, self._twist.points = np.stack([arc[:-1], arc[1:]], axis=1), arc[None, [-3, -1]]
        # Shown only now, so that no browser draws them where they were.
        self._force.visible = True
        self._arc.visible = self._twist.visible = abs(turn_deg) > LEAST_ARC_DEG


def arrow(server: ViserServer, name: str, colour: tuple[int, int, int]) -> ArrowsHandle:
    """One arrow, hidden."""
    return server.scene.add_arrows(
        name,
        np.zeros((1, 2, 3), np.float32),
        colour,
        shaft_radius=SHAFT_MM,
        head_radius=HEAD_MM,
        head_length=HEAD_LONG_MM,
        visible=False,
    )


def centre_mm(wrench: Wrench) -> Float64[Array, "3"] | None:
    """Where on the untouched skin the force has no torque but about z; None for a force too faint to have a place."""
    force_z = float(wrench.force_n[2])
    if abs(force_z) < LEAST_N:
        return None
    about = wrench.about(np.zeros(3)).torque_nm * 1e3
    return np.array([-about[1] / force_z, about[0] / force_z, 0.0])


def arc_deg(torque_nm: float) -> float:
    """How far the arc of a torque about z goes round, in its direction."""
    return float(np.clip(1e3 * torque_nm * ARC_DEG_PER_MNM, -MOST_ARC_DEG, MOST_ARC_DEG))


def arc_mm(place_mm: Float64[Array, "3"], turn_deg: float) -> Float32[Array, "n 3"]:
    """Points of an arc about a place, from its front."""
    angle = np.linspace(0, np.radians(turn_deg), ARC_PIECES + 1) - np.pi / 2
    circle = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1) * ARC_RADIUS_MM
    return (place_mm + circle + [0, 0, LIFT_MM]).astype(np.float32)
