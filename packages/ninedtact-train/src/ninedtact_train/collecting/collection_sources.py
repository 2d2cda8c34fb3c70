"""The setup of a collection: its camera and its force/torque sensor, from devices, from recordings, or from a simulated sensor,
and their images and samples in one stream.

The simulated sensor is pressed by a script, which takes one object after the other and presses, drags, twists and tilts it a few
times.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, field
from math import radians
from pathlib import Path
from threading import Event

import numpy as np

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.force_torque.sample_checks import CheckedWrenchSource, SampleCheckSettings
from ninedtact.capture.force_torque.wrench_source_from_address import DeviceFrameWrenchSource, MountedWrenchSource
from ninedtact.capture.frame_source import FrameSource, SourceEnded
from ninedtact.capture.reconnecting import ReconnectingWrenchSource
from ninedtact.capture.wrench_source import WrenchSampleRejected, WrenchSource
from ninedtact.design import ForceTorqueMount
from ninedtact.errors import InputError
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.background_reader import STALL_S, Arrival, BackgroundReader
from ninedtact.recording.reader import Recording
from ninedtact.recording.recorded_source import RecordedFrameSource, RecordedWrenchSource
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.press_sequence import ObjectTrajectory, PressSequence
from ninedtact.simulation.simulated_sources import SimulatedCamera, SimulatedForceTorque
from ninedtact.simulation.trajectory import (
    HOVER_MM,
    ScriptedPress,
    Trajectory,
    TrajectorySegment,
    concatenate_trajectories,
    press_trajectory,
)
from ninedtact.simulation.twin import Twin

_DEFAULT_OBJECTS = ("ball:4", "cylinder:3,11", "ring_02", "letter_03", "key_01")
_UNTOUCHED_S = 1.5
"""Time before the first touch: longer than a tare."""
_PAUSE_S = 0.3
_SAME_CLOCK_NS = 60_000_000_000
"""Difference of the wall clocks of two recordings of one run of a computer; it is corrected by less meanwhile."""
_LOADS_N = (3.5, 10.0)
_IMAGE_HZ, _SAMPLE_HZ = 20.0, 200.0
_SPEED = 1.5
"""Speed of the scripted presses relative to that of a calm hand."""
_OFFSET_MM, _DRAG_MM, _TWIST_DEG, _TILT_DEG = 3.0, 0.9, 15.0, 4.0

_READ_AHEAD_NS = 300_000_000
"""Time by which samples are read ahead of the newest frame before the next frame is read."""
_BUFFERED_IMAGES, _BUFFERED_SAMPLES = 128, 100_000
_WAIT_S = 0.02

MergedArrival = Arrival[Frame | Wrench | WrenchSampleRejected] | None
"""An arrival, or None where nothing arrived for a moment."""


@dataclass(frozen=True)
class CollectSetup:
    """The camera and the force/torque sensor of one collection, not yet opened."""

    camera: FrameSource
    force_torque: WrenchSource
    """Source of the wrench samples; it rejects unusable samples and does not subtract a tare."""
    is_live: bool = True
    object_at: Callable[[Frame], str] | None = None
    """A function that returns the object in an image, where it is known without a key press."""
    was_away: Event = field(default_factory=Event)
    """Set when a lost force/torque sensor is back."""
    wall_minus_monotonic_ns: int | None = None
    """Difference of wall clock and monotonic clock for the stamps of a recording."""
    on_message: Callable[[str], None] = lambda sentence: None
    """Receives a sentence about a device that delivers nothing."""
    recorded_camera: str = ""
    """Name of the camera of a recording, as it was when the recording was made."""
    camera_delay_ms: float = 0.0
    """Delay of the camera that the stamps of a recording already have subtracted."""

    @property
    def camera_name(self) -> str:
        """Name of the camera that took the images."""
        return self.recorded_camera or self.camera.name

    def arrivals(self) -> Generator[MergedArrival, None, None]:
        """Open both sources and yield their images and samples in one stream."""
        if self.is_live:
            return merge_live_streams(self.camera, self.force_torque, self.on_message)
        return merge_recorded_streams(self.camera, self.force_torque)


def collection_setup_from_devices(
    camera: FrameSource,
    force_torque: WrenchSource,
    folder: SensorFolder,
    checks: SampleCheckSettings,
    on_message: Callable[[str], None],
) -> CollectSetup:
    """Return the setup of a camera and of a force/torque sensor in its own frame; a lost sensor is reopened and reported."""
    was_away = Event()

    def on_back() -> None:
        was_away.set()
        on_message("the force/torque sensor is back")

    reopened = ReconnectingWrenchSource(force_torque, lambda loss: on_message(f"{loss}; waiting for it"), on_back)
    mounted = MountedWrenchSource(CheckedWrenchSource(reopened, checks), folder.record.design.force_torque)
    return CollectSetup(camera, mounted, was_away=was_away, on_message=on_message)


def collection_setup_from_recordings(
    images: Path, wrenches: Path, checks: SampleCheckSettings, mount: ForceTorqueMount = ForceTorqueMount()
) -> CollectSetup:
    """Return the setup of the images and the wrenches of recordings, with their own stamps.

    Recorded wrenches are in the sensor frame, about the centre of the skin; they are checked in the frame of the device. Raises
    `InputError` for recordings that do not share a clock.
    """
    device = CheckedWrenchSource(DeviceFrameWrenchSource(RecordedWrenchSource(wrenches), mount), checks)
    with Recording(images) as recording, Recording(wrenches) as measured:
        metadata = recording.metadata
        # The monotonic clock begins anew with each start of a computer.
        apart_ns = metadata.wall_minus_monotonic_ns - measured.metadata.wall_minus_monotonic_ns
    if abs(apart_ns) > _SAME_CLOCK_NS:
        raise InputError(
            expected="recordings of images and wrenches that were made together on one computer",
            got=f"{images} and {wrenches}, whose clocks are {abs(apart_ns) / 1000000000.0:.0f} s apart",
            remedy="name two that belong together",
        )
    return CollectSetup(
        RecordedFrameSource(images),
        MountedWrenchSource(device, mount),
        is_live=False,
        wall_minus_monotonic_ns=metadata.wall_minus_monotonic_ns,
        recorded_camera=metadata.source,
        camera_delay_ms=metadata.camera_delay_ms,
    )


def build_simulated_collect_setup(
    folder: SensorFolder, objects: Sequence[str], touches: int, seed: int, checks: SampleCheckSettings
) -> CollectSetup:
    """Return the setup of the twin of a sensor, pressed by a script: each object so many times, steps without pauses."""
    names = tuple(objects or _DEFAULT_OBJECTS)
    simulation = _simulate_script(folder.twin(), names, touches, seed)

    def object_at(frame: Frame) -> str:
        at_s = (frame.stamp_ns - simulation.clock.start_ns) / 1e9
        return names[simulation.trajectory_at(at_s)[0] % len(names)]

    force_torque = CheckedWrenchSource(SimulatedForceTorque(simulation, _SAMPLE_HZ), checks)
    return CollectSetup(SimulatedCamera(simulation), force_torque, is_live=False, object_at=object_at)


def _simulate_script(twin: Twin, names: Sequence[str], touches: int, seed: int) -> PressSequence:
    rng = np.random.default_rng(seed)
    above = Pose(depth_mm=-HOVER_MM)
    presses: list[ObjectTrajectory] = []
    for name in names:
        indenter = indenter_from_name(name)
        trajectories = [_random_touch(twin, indenter, rng) for _ in range(touches)]
        if not presses:
            trajectories.insert(0, Trajectory(above, (TrajectorySegment(above, _UNTOUCHED_S),)))
        presses.append(ObjectTrajectory(indenter, concatenate_trajectories(trajectories)))
    return PressSequence(twin, presses, _IMAGE_HZ, real_time=False, rounds=1)


def _random_touch(twin: Twin, indenter: Indenter, rng: np.random.Generator) -> Trajectory:
    load_n = float(rng.uniform(*_LOADS_N))
    depth_mm = ScriptedPress(load_n=load_n).simulate(twin, indenter, solver_settings=None).pose.depth_mm
    x, y = rng.uniform(-_OFFSET_MM, _OFFSET_MM, 2) * (1, 0.7)
    drag_x, drag_y = rng.uniform(-_DRAG_MM, _DRAG_MM, 2)
    tilt = radians(rng.uniform(-_TILT_DEG, _TILT_DEG)), radians(rng.uniform(-_TILT_DEG, _TILT_DEG))
    pose = Pose(float(x), float(y), depth_mm, radians(rng.uniform(-180, 180)))
    twist = radians(rng.uniform(-_TWIST_DEG, _TWIST_DEG))
    return press_trajectory(pose, (float(drag_x), float(drag_y)), twist, tilt, _PAUSE_S, _SPEED)


def merge_live_streams(
    camera: FrameSource,
    force_torque: WrenchSource,
    on_stall: Callable[[str], None] = lambda sentence: None,
    stall_s: float = STALL_S,
) -> Generator[MergedArrival, None, None]:
    """Yield what two devices deliver, each read in its own thread; raises what they raise, ends with a recording.

    on_stall: called with a sentence each time that a device has delivered nothing for `stall_s`.
    """
    with (
        BackgroundReader[Wrench](
            force_torque, _BUFFERED_SAMPLES, WrenchSampleRejected, on_stall=on_stall, stall_s=stall_s
        ) as samples,
        BackgroundReader[Frame](camera, _BUFFERED_IMAGES, on_stall=on_stall, stall_s=stall_s) as images,
    ):
        try:
            while True:
                while (sample := samples.take()) is not None:
                    yield sample
                yield images.take(_WAIT_S)
        except SourceEnded:
            return


def merge_recorded_streams(camera: FrameSource, force_torque: WrenchSource) -> Generator[MergedArrival, None, None]:
    """Yield every frame and every sample in the order of their stamps, as fast as they are requested, until one source ends.

    Samples are read ahead, so that frames follow the last sample, up to its stamp.
    """
    newest_ns, has_samples = 0, True
    with force_torque, camera:
        try:
            while True:
                frame = camera.read()
                if not has_samples and frame.stamp_ns > newest_ns:
                    return
                yield Arrival(frame, frame.stamp_ns)
                while has_samples and newest_ns < frame.stamp_ns + _READ_AHEAD_NS:
                    if (sample := _read_sample(force_torque)) is None:
                        has_samples = False
                        break
                    newest_ns = max(newest_ns, sample.stamp_ns if isinstance(sample, Wrench) else 0)
                    yield Arrival(sample, newest_ns)
        except SourceEnded:
            return


def _read_sample(force_torque: WrenchSource) -> Wrench | WrenchSampleRejected | None:
    """Return the next sample, or the reason for its rejection; None after the last one."""
    try:
        return force_torque.read()
    except WrenchSampleRejected as reason:
        return reason
    except SourceEnded:
        return None
