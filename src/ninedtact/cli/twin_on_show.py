"""A twin in place of a sensor on a desk: its camera, its untouched skin and its true wrench."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ninedtact.quantities import Frame
    from ninedtact.simulation.camera import SimulatedCamera
    from ninedtact.simulation.force_torque import SimulatedForceTorque
    from ninedtact.simulation.twin import Twin

SIM = "sim"
"""What a person names it as a source."""
TRUE_WRENCH = "true wrench, object on skin"
SAMPLES_HZ = 60.0
UNTOUCHED_IMAGES = 10


@dataclass(frozen=True)
class TwinOnShow:
    """Objects press a twin in turn, round after round; its camera and its force/torque sensor watch."""

    camera: "SimulatedCamera"
    force_torque: "SimulatedForceTorque"
    untouched: "tuple[Frame, ...]"


def on_show(twin: "Twin", rounds: int | None = None) -> TwinOnShow:
    """The sources, not yet opened."""
    from ninedtact.quantities import Frame
    from ninedtact.simulation.camera import SimulatedCamera
    from ninedtact.simulation.force_torque import EXACT, SimulatedForceTorque
    from ninedtact.simulation.show import show
    from ninedtact.simulation.stage import Stage

    stage = Stage(twin, show(), rounds=rounds)
    untouched = tuple(Frame(twin.renderer(None, number)) for number in range(-UNTOUCHED_IMAGES, 0))
    return TwinOnShow(SimulatedCamera(stage), SimulatedForceTorque(stage, SAMPLES_HZ, EXACT), untouched)
