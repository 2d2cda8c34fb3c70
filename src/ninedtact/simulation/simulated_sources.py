"""The camera of a twin: a frame source like any other.

The force/torque sensor under a twin: a wrench source like any other, driven by the same motion as the camera.

What a twin is shown with: a few objects in turn, each pressed, dragged, twisted, tilted and lifted.

A twin in place of a sensor on a desk: its camera, its untouched skin and its true wrench.
"""

from dataclasses import dataclass, field
from math import radians
from threading import Lock
from typing import TYPE_CHECKING

import numpy as np
from numpy import ndarray as Array

from ninedtact.capture.frame_source import FrameSource, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.design import ForceTorqueMount
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame, Wrench
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.press_simulation import ObjectTrajectory, PressSimulation, SampleTimer
from ninedtact.simulation.trajectory import press_trajectory

if TYPE_CHECKING:
    from ninedtact.quantities import Frame
    from ninedtact.simulation.twin import Twin


@dataclass
class SimulatedCamera(FrameSource):
    """Images of the stage, one per step of its motion, for ever or until its last round ends."""

    stage: PressSimulation
    is_open: bool = field(default=False, init=False)
    first: int = field(default=-1, init=False)
    """Step of the first image."""
    lock: Lock = field(default_factory=Lock, init=False, repr=False)
    """Of opening, reading and closing."""

    def __post_init__(self) -> None:
        self.name = f"twin {self.stage.twin.name}"
        self.pace = SampleTimer(self.stage.clock, self.stage.hz)

    def open(self) -> None:
        """Begin the motion, or join it."""
        with self.lock:
            if not self.is_open:
                self.stage.join()
                self.pace.restart()
                self.first, self.is_open = -1, True

    def read(self) -> Frame:
        """Wait for the next image; raises `SourceEnded` after the last round."""
        with self.lock:
            if not self.is_open:
                raise SourceNotOpen(self.name)
            number, stamp_ns = self.pace.next()
            self.stage.require_time(number / self.stage.hz)
            self.first = number if self.first < 0 else self.first
            image = self.stage.twin.renderer(self.stage.contact(number), number)
            return Frame(image, stamp_ns, number - self.first)

    def close(self) -> None:
        """End it."""
        with self.lock:
            if self.is_open:
                self.stage.clock.leave()
                self.is_open = False


FORCE_TORQUE_BELOW_SKIN_MM = -ForceTorqueMount().origin_mm[2]
"""Where the paper's sensor sits."""
SixComponents = tuple[float, float, float, float, float, float]
"""F_x, F_y, F_z in N and T_x, T_y, T_z in N·m."""
NO_OFFSET: SixComponents = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ForceTorqueErrors:
    """What a force/torque sensor adds to the truth; defaults are those of a small six-axis one."""

    noise: SixComponents = (0.02, 0.02, 0.03, 5e-4, 5e-4, 3e-4)
    """Standard deviation of one sample."""
    bias: SixComponents = NO_OFFSET
    """Constant offset, about the sensor's own origin, which a tare removes."""


NO_FORCE_TORQUE_ERRORS = ForceTorqueErrors(NO_OFFSET, NO_OFFSET)
"""The truth itself."""


@dataclass
class SimulatedForceTorque(WrenchSource):
    """The wrench on the skin, sampled at its own rate, with noise and bias; torque about its own origin."""

    stage: PressSimulation
    hz: float = 500.0
    errors: ForceTorqueErrors = ForceTorqueErrors()
    about_mm: tuple[float, float, float] = (0.0, 0.0, -FORCE_TORQUE_BELOW_SKIN_MM)
    seed: int = 0
    is_open: bool = field(default=False, init=False)
    lock: Lock = field(default_factory=Lock, init=False, repr=False)
    """Of opening, reading and closing."""

    def __post_init__(self) -> None:
        self.name = f"force/torque sensor under twin {self.stage.twin.name}"
        self.pace = SampleTimer(self.stage.clock, self.hz)
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
            true = _wrench_from_six(self.stage.six(number / self.hz), stamp_ns).about(np.array(self.about_mm))
            return _wrench_from_six(
                true.six + self.errors.bias + self.rng.normal(0, self.errors.noise), stamp_ns, true.about_mm
            )

    def close(self) -> None:
        """End it."""
        with self.lock:
            if self.is_open:
                self.stage.clock.leave()
                self.is_open = False


def _wrench_from_six(six: Array, stamp_ns: int, about_mm: Array | None = None) -> Wrench:
    """Six numbers as a wrench, about the skin's centre unless said otherwise."""
    return Wrench(six[:3], six[3:], np.zeros(3) if about_mm is None else about_mm, stamp_ns)


def demo_trajectories() -> list[ObjectTrajectory]:
    """About half a minute."""
    return [
        ObjectTrajectory(indenter_from_name("ball:4"), press_trajectory(Pose(0.0, 0.0, 1.4), (1.5, 0.8))),
        ObjectTrajectory(
            indenter_from_name("gear_07"), press_trajectory(Pose(-1.0, 0.5, 0.4), (0.3, 0.0), radians(15))
        ),
        ObjectTrajectory(
            indenter_from_name("cylinder:3,11"),
            press_trajectory(Pose(2.0, -1.0, 1.0, radians(30)), (-0.5, 1.2), 0.0, (0.0, radians(5))),
        ),
        ObjectTrajectory(
            indenter_from_name("letter_03"), press_trajectory(Pose(0.0, 0.0, 0.7), (0.8, -0.6), radians(-12))
        ),
        ObjectTrajectory(
            indenter_from_name("ring_02"), press_trajectory(Pose(-2.0, 1.0, 0.6), (0.0, -0.6), radians(15))
        ),
        ObjectTrajectory(indenter_from_name("key_01"), press_trajectory(Pose(1.0, 0.0, 0.8), (-0.6, 0.4), radians(10))),
    ]


TRUE_WRENCH_NAME = "true wrench, object on skin"
SAMPLES_HZ = 60.0
REFERENCE_FRAMES = 10


@dataclass(frozen=True)
class DemoSources:
    """Objects press a twin in turn, round after round; its camera and its force/torque sensor watch."""

    camera: "SimulatedCamera"
    force_torque: "SimulatedForceTorque"
    untouched: "tuple[Frame, ...]"


def demo_sources(twin: "Twin", rounds: int | None = None) -> DemoSources:
    """The sources, not yet opened."""
    from ninedtact.quantities import Frame
    from ninedtact.simulation.press_simulation import PressSimulation

    stage = PressSimulation(twin, demo_trajectories(), rounds=rounds)
    untouched = tuple(Frame(twin.renderer(None, number)) for number in range(-REFERENCE_FRAMES, 0))
    return DemoSources(
        SimulatedCamera(stage), SimulatedForceTorque(stage, SAMPLES_HZ, NO_FORCE_TORQUE_ERRORS), untouched
    )
