"""Simulated sources: the camera and the force/torque sensor of a twin, and the press sequence of the demo.

Both are sources like those of real hardware (`FrameSource`, `WrenchSource`) and follow one `PressSequence`.
"""

from dataclasses import dataclass, field
from functools import cached_property
from math import radians
from threading import Lock
from typing import Annotated

import numpy as np
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.capture.frame_source import FrameSource, SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.design import ForceTorqueMount
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame, Wrench
from ninedtact.shape.calibrated_shape import REFERENCE_FRAMES
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.press_sequence import ObjectTrajectory, PressSequence, SampleTimer
from ninedtact.simulation.trajectory import press_trajectory
from ninedtact.simulation.twin import Twin


@dataclass
class _SimulatedSource:
    """A source that joins a simulation when it is opened and leaves it when it is closed."""

    simulation: PressSequence
    is_open: bool = field(default=False, init=False)
    lock: Lock = field(default_factory=Lock, init=False, repr=False)
    """Guards opening, reading and closing."""
    timer: SampleTimer = field(init=False, repr=False)

    def open(self) -> None:
        """Start the simulation, or join it."""
        with self.lock:
            if not self.is_open:
                self.simulation.join()
                self.timer.restart()
                self.is_open = True
                self._begin()

    def _begin(self) -> None:
        """Forget what a source remembers of an earlier opening."""

    def close(self) -> None:
        """Leave the simulation; does nothing where the source is closed."""
        with self.lock:
            if self.is_open:
                self.simulation.clock.leave()
                self.is_open = False


@checks_arguments
@dataclass
class SimulatedCamera(_SimulatedSource, FrameSource):
    """A frame source of rendered images, one per step of a simulation; it ends after the last round, if there is one."""

    is_simulated = True
    first: int = field(default=-1, init=False)
    """Step number of the first image."""

    def __post_init__(self) -> None:
        self.name = f"twin {self.simulation.twin.name}"
        self.timer = SampleTimer(self.simulation.clock, self.simulation.hz)

    @cached_property
    def reference_frames(self) -> tuple[Frame, ...]:
        """The reference images (no contact) of the twin."""
        return simulate_reference_frames(self.simulation.twin)

    def _begin(self) -> None:
        self.first = -1

    def read(self) -> Frame:
        """Wait for the next image; raises `SourceEnded` after the last round."""
        with self.lock:
            if not self.is_open:
                raise SourceNotOpen(self.name)
            number, stamp_ns = self.timer.next()
            self.simulation.require_time(number / self.simulation.hz)
            self.first = number if self.first < 0 else self.first
            image = self.simulation.twin.renderer(self.simulation.contact(number), number)
            return Frame(image, stamp_ns, number - self.first)


SixComponents = tuple[float, float, float, float, float, float]
"""F_x, F_y, F_z in N and T_x, T_y, T_z in N·m."""
NO_OFFSET: SixComponents = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class ForceTorqueSensorNoise:
    """Noise and offset of a force/torque sensor; defaults are those of a small six-axis one."""

    noise: SixComponents = (0.02, 0.02, 0.03, 5e-4, 5e-4, 3e-4)
    """Standard deviation of one sample."""
    bias: SixComponents = NO_OFFSET
    """Constant offset about the sensor's own origin, which a tare removes."""


NO_FORCE_TORQUE_ERRORS = ForceTorqueSensorNoise(NO_OFFSET, NO_OFFSET)
"""An exact force/torque sensor."""


@checks_arguments
@dataclass
class SimulatedForceTorque(_SimulatedSource, WrenchSource):
    """A source of the true wrench on the skin with noise and offset, at its own rate; the torque is about the sensor's origin."""

    hz: Annotated[float, Meta(gt=0, le=1e6)] = 500.0
    errors: ForceTorqueSensorNoise = ForceTorqueSensorNoise()
    about_mm: tuple[float, float, float] = ForceTorqueMount().origin_mm
    """The sensor's origin, by default that of the paper."""
    seed: Annotated[int, Meta(ge=0)] = 0

    def __post_init__(self) -> None:
        self.name = f"force/torque sensor under twin {self.simulation.twin.name}"
        self.timer = SampleTimer(self.simulation.clock, self.hz)

    def _begin(self) -> None:
        self.rng = np.random.default_rng(self.seed)

    def read(self) -> Wrench:
        """Wait for the next sample; raises `SourceEnded` after the last round."""
        with self.lock:
            if not self.is_open:
                raise SourceNotOpen(self.name)
            number, stamp_ns = self.timer.next()
            self.simulation.require_time(number / self.hz)
            true = _wrench_from_six(self.simulation.wrench_six_at(number / self.hz), stamp_ns).about(
                np.array(self.about_mm)
            )
            return _wrench_from_six(
                true.six + self.errors.bias + self.rng.normal(0, self.errors.noise), stamp_ns, true.about_mm
            )


def _wrench_from_six(six: Array, stamp_ns: int, about_mm: Array | None = None) -> Wrench:
    """Return six components as a wrench, about the centre of the skin unless another point is given."""
    return Wrench(six[:3], six[3:], np.zeros(3) if about_mm is None else about_mm, stamp_ns)


def demo_press_sequence() -> list[ObjectTrajectory]:
    """Return the press sequence of the demo: six objects, about half a minute."""
    trajectories = {
        "ball:4": press_trajectory(Pose(0.0, 0.0, 1.4), (1.5, 0.8)),
        "gear_07": press_trajectory(Pose(-1.0, 0.5, 0.4), (0.3, 0.0), radians(15)),
        "cylinder:3,11": press_trajectory(Pose(2.0, -1.0, 1.0, radians(30)), (-0.5, 1.2), 0.0, (0.0, radians(5))),
        "letter_03": press_trajectory(Pose(0.0, 0.0, 0.7), (0.8, -0.6), radians(-12)),
        "ring_02": press_trajectory(Pose(-2.0, 1.0, 0.6), (0.0, -0.6), radians(15)),
        "key_01": press_trajectory(Pose(1.0, 0.0, 0.8), (-0.6, 0.4), radians(10)),
    }
    return [ObjectTrajectory(indenter_from_name(name), trajectory) for name, trajectory in trajectories.items()]


TRUE_WRENCH_MEANING = "what the object of the simulation applies to the skin"
SAMPLES_HZ = 60.0


@dataclass(frozen=True)
class DemoSources:
    """The simulated sources of the demo, which follow one press sequence, round after round."""

    camera: SimulatedCamera
    force_torque: SimulatedForceTorque

    @property
    def simulation(self) -> PressSequence:
        """The motion that both sources follow; its `hand` lets a person press."""
        return self.camera.simulation


def demo_sources(twin: Twin, rounds: int | None = None) -> DemoSources:
    """Return the sources of the demo, not yet opened."""
    simulation = PressSequence(twin, demo_press_sequence(), rounds=rounds)
    return DemoSources(
        SimulatedCamera(simulation), SimulatedForceTorque(simulation, SAMPLES_HZ, NO_FORCE_TORQUE_ERRORS)
    )


def simulate_reference_frames(twin: Twin) -> tuple[Frame, ...]:
    """Return as many images without contact as a reference image is the mean of; their noise is that of no image of a press."""
    return tuple(Frame(twin.renderer(None, number)) for number in range(-REFERENCE_FRAMES, 0))
