"""The force/torque sensor under a twin: a wrench source like any other, driven by the same motion as the camera."""

from dataclasses import dataclass, field
from threading import Lock

import numpy as np
from numpy import ndarray as Array

from ninedtact.capture.frame_source import SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.design import ForceTorqueMount
from ninedtact.quantities import Wrench
from ninedtact.simulation.pace import Pace
from ninedtact.simulation.stage import Stage

BELOW_SKIN_MM = -ForceTorqueMount().origin_mm[2]
"""Where the paper's sensor sits."""
Six = tuple[float, float, float, float, float, float]
"""F_x, F_y, F_z in N and T_x, T_y, T_z in N·m."""
NONE: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Errors:
    """What a force/torque sensor adds to the truth; defaults are those of a small six-axis one."""

    noise: Six = (0.02, 0.02, 0.03, 5e-4, 5e-4, 3e-4)
    """Standard deviation of one sample."""
    bias: Six = NONE
    """Constant offset, about the sensor's own origin, which a tare removes."""


EXACT = Errors(NONE, NONE)
"""The truth itself."""


@dataclass
class SimulatedForceTorque(WrenchSource):
    """The wrench on the skin, sampled at its own rate, with noise and bias; torque about its own origin."""

    stage: Stage
    hz: float = 500.0
    errors: Errors = Errors()
    about_mm: tuple[float, float, float] = (0.0, 0.0, -BELOW_SKIN_MM)
    seed: int = 0
    is_open: bool = field(default=False, init=False)
    lock: Lock = field(default_factory=Lock, init=False, repr=False)
    """Of opening, reading and closing."""

    def __post_init__(self) -> None:
        self.name = f"force/torque sensor under twin {self.stage.twin.name}"
        self.pace = Pace(self.stage.clock, self.hz)
        self.rng = np.random.default_rng(self.seed)

    def open(self) -> None:
        """Begin the motion, or join it."""
        with self.lock:
            if not self.is_open:
                self.stage.join()
                self.pace.restart()
                self.rng = np.random.default_rng(self.seed)
                self.is_open = True

    def read(self) -> Wrench:
        """Wait for the next sample; raises `SourceEnded` after the last round."""
        with self.lock:
            if not self.is_open:
                raise SourceNotOpen(self.name)
            number, stamp_ns = self.pace.next()
            self.stage.require_time(number / self.hz)
            true = wrench_of(self.stage.six(number / self.hz), stamp_ns).about(np.array(self.about_mm))
            return wrench_of(
                true.six + self.errors.bias + self.rng.normal(0, self.errors.noise), stamp_ns, true.about_mm
            )

    def close(self) -> None:
        """End it."""
        with self.lock:
            if self.is_open:
                self.stage.clock.leave()
                self.is_open = False


def wrench_of(six: Array, stamp_ns: int, about_mm: Array | None = None) -> Wrench:
    """Six numbers as a wrench, about the skin's centre unless said otherwise."""
    return Wrench(six[:3], six[3:], np.zeros(3) if about_mm is None else about_mm, stamp_ns)
