"""A hand that collects on a twin: it takes one object after the other, presses, drags, twists and tilts each a few times.

The devices of a collection: a camera and a force/torque sensor that are read together.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from math import radians
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

from ninedtact.cli.devices import device, live_source

if TYPE_CHECKING:
    import numpy as np

    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.force_torque.sample_checks import SampleCheckSettings
    from ninedtact.capture.frame_source import CameraSettings, FrameSource
    from ninedtact.capture.wrench_source import WrenchSource
    from ninedtact.mechanics.indenter import Indenter
    from ninedtact.quantities import Frame
    from ninedtact.recording.merge_streams import MergedArrival
    from ninedtact.simulation.press_simulation import PressSimulation
    from ninedtact.simulation.simulated_sources import SimulatedCamera, SimulatedForceTorque
    from ninedtact.simulation.trajectory import Trajectory
    from ninedtact.simulation.twin import Twin


OBJECTS = ("ball:4", "cylinder:3,11", "ring_02", "letter_03", "key_01")
"""Where none are named."""
UNTOUCHED_S = 1.5
"""Before the first touch: as long as a tare takes, and some."""
LOADS_N = (3.5, 10.0)
HZ, SAMPLES_HZ, SPEED = 20.0, 200.0, 1.5
"""Images and samples per second, and times a calm hand."""
PLACE_MM, DRAG_MM, TWIST_DEG, TILT_DEG = 3.0, 0.9, 15.0, 4.0


@dataclass(frozen=True)
class ScriptedHand:
    """A twin on a stage, and which object is in the hand."""

    stage: "PressSimulation"
    names: tuple[str, ...]
    """Of the object of each act."""

    @property
    def sources(self) -> "tuple[SimulatedCamera, SimulatedForceTorque]":
        """What watches the stage, not yet opened."""
        from ninedtact.simulation.simulated_sources import SimulatedCamera, SimulatedForceTorque

        return SimulatedCamera(self.stage), SimulatedForceTorque(self.stage, SAMPLES_HZ)

    def object_at(self, frame: "Frame") -> str:
        """The object in the hand when an image was taken."""
        at_s = (frame.stamp_ns - self.stage.clock.start_ns) / 1e9
        return self.names[self.stage.trajectory_at(at_s)[0] % len(self.names)]


def scripted_hand(twin: "Twin", names: Sequence[str], touches: int, seed: int) -> ScriptedHand:
    """The hand with these objects, each touching so many times; steps follow each other as fast as they are solved."""
    import numpy as np

    from ninedtact.simulation.objects.catalogue import indenter_from_name
    from ninedtact.simulation.press_simulation import ObjectTrajectory, PressSimulation
    from ninedtact.simulation.trajectory import concatenate_trajectories

    rng = np.random.default_rng(seed)
    acts: list[ObjectTrajectory] = []
    for name in names or OBJECTS:
        indenter = indenter_from_name(name)
        motions = [touched(twin, indenter, rng, pause_s=0.3) for _ in range(touches)]
        if not acts:
            motions.insert(0, waiting(UNTOUCHED_S))
        acts.append(ObjectTrajectory(indenter, concatenate_trajectories(motions)))
    return ScriptedHand(PressSimulation(twin, acts, HZ, real_time=False, rounds=1), tuple(names or OBJECTS))


def waiting(seconds: float) -> "Trajectory":
    """Above the skin."""
    from ninedtact.mechanics.pose import Pose
    from ninedtact.simulation.trajectory import HOVER_MM, Trajectory, TrajectorySegment

    above = Pose(depth_mm=-HOVER_MM)
    return Trajectory(above, (TrajectorySegment(above, seconds),))


def touched(twin: "Twin", indenter: "Indenter", rng: "np.random.Generator", pause_s: float) -> "Trajectory":
    """One touch, as hard as a hand presses."""
    from ninedtact.mechanics.pose import Pose
    from ninedtact.simulation.scripted_press import ScriptedPress
    from ninedtact.simulation.trajectory import press_trajectory

    load_n = float(rng.uniform(*LOADS_N))
    depth_mm = ScriptedPress(load_n=load_n).simulate(twin, indenter, solver_settings=None).pose.depth_mm
    x, y = rng.uniform(-PLACE_MM, PLACE_MM, 2) * (1, 0.7)
    drag_x, drag_y = rng.uniform(-DRAG_MM, DRAG_MM, 2)
    tilt = radians(rng.uniform(-TILT_DEG, TILT_DEG)), radians(rng.uniform(-TILT_DEG, TILT_DEG))
    place = Pose(float(x), float(y), depth_mm, radians(rng.uniform(-180, 180)))
    return press_trajectory(
        place, (float(drag_x), float(drag_y)), radians(rng.uniform(-TWIST_DEG, TWIST_DEG)), tilt, pause_s, SPEED
    )


@dataclass(frozen=True)
class Bench:
    """Two sources that belong together, not yet opened."""

    camera: "FrameSource"
    force_torque: "WrenchSource"
    """Its untrusted samples are refused; its tare is not taken off."""
    is_live: bool = True
    object_at: "Callable[[Frame], str] | None" = None
    """Which object is in the hand, where that is known without a key."""
    was_away: Event = field(default_factory=Event)
    """Set when a force/torque sensor is back that was lost."""
    wall_minus_monotonic_ns: int | None = None
    """Of a recording's stamps."""

    def feed(self) -> "Generator[MergedArrival, None, None]":
        """Images and samples, in one stream; opens both."""
        from ninedtact.recording.merge_streams import merge_live_streams, merge_recorded_streams

        return (
            merge_live_streams(self.camera, self.force_torque)
            if self.is_live
            else merge_recorded_streams(self.camera, self.force_torque)
        )


def devices(
    source: str,
    force_torque: str,
    folder: "SensorFolder",
    trust: "SampleCheckSettings",
    camera: "CameraSettings",
    say: Callable[[str], None],
) -> Bench:
    """A camera and a force/torque sensor on the desk."""
    from ninedtact.capture.force_torque.pipeline import MountedWrenchSource
    from ninedtact.capture.force_torque.sample_checks import CheckedWrenchSource

    was_away = Event()

    def back() -> None:
        was_away.set()
        say("the force/torque sensor is back")

    opened = CheckedWrenchSource(device(force_torque, lambda loss: say(f"{loss}; waiting for it"), back), trust)
    mounted = MountedWrenchSource(opened, folder.record.design.force_torque)
    return Bench(live_source(source, camera), mounted, was_away=was_away)


def recording(source: str, force_torque: str, trust: "SampleCheckSettings") -> Bench:
    """The images and the wrenches of recordings, with their own stamps."""
    from ninedtact.capture.force_torque.sample_checks import CheckedWrenchSource
    from ninedtact.recording.reader import Recording
    from ninedtact.recording.recorded_source import RecordedSource, RecordedWrenchSource

    images, samples = (Path(text).expanduser() for text in (source, force_torque))
    with Recording(images) as episode:
        ahead_ns = episode.session.wall_minus_monotonic_ns
    forces = CheckedWrenchSource(RecordedWrenchSource(samples), trust)
    return Bench(RecordedSource(images), forces, is_live=False, wall_minus_monotonic_ns=ahead_ns)


def twin(
    folder: "SensorFolder", objects: tuple[str, ...], touches: int, seed: int, trust: "SampleCheckSettings"
) -> Bench:
    """The sensor's twin under a scripted hand."""
    from ninedtact.calibration.twin.sensor_twin import build_sensor_twin
    from ninedtact.capture.force_torque.sample_checks import CheckedWrenchSource

    hand = scripted_hand(build_sensor_twin(folder), objects, touches, seed)
    camera, force_torque = hand.sources
    return Bench(camera, CheckedWrenchSource(force_torque, trust), is_live=False, object_at=hand.object_at)
