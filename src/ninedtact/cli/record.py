"""ninedtact record: everything that a sensor sees and that presses on it, as one file."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ninedtact.cli.devices import RECORDING, device, is_sim, live_source, require_alike, sensor_of
from ninedtact.cli.live import print_notice
from ninedtact.cli.terminal import print_result, stop_on_signal
from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.frame_source import FrameSource
    from ninedtact.capture.wrench_source import WrenchSource
    from ninedtact.recording.metadata import RecordingMetadata
    from ninedtact.recording.recorder import RecordedEstimates
    from ninedtact.recording.writer import RecordingWriter

BAR = "{n:.0f} of {total:.0f} s |{bar}| {remaining} left, {postfix}"
FIRST_SHOWN_S = 0.3
"""A camera that is not there is told before."""
BAR_WITHOUT_END = "{n:.0f} s, {postfix}"


class RecordImpossible(NinedtactError):
    """A recording of nothing."""


@dataclass(frozen=True)
class Record:
    """Record a sensor: images as they come, without loss, measured wrenches, heights if asked for. Ctrl-C ends it well."""

    source: str
    """Camera (0, /dev/video0, csi:0), stream (http://…, rtsp://…), video, folder or recording; or sim, the sensor's twin."""
    out: Path
    """The recording: a new .mcap file. ROS 2 and Foxglove read it."""
    sensor: Path | None = None
    """Sensor folder that `ninedtact calibrate` wrote; it rides along in the file. A recording brings its own."""
    force_torque: str | None = None
    """Force/torque sensor (bota:CONFIG, netft:HOST, onrobot:HOST, serial:PORT), or sim with --source sim."""
    seconds: float | None = None
    """For how long; without it, until Ctrl-C or the end of the source."""
    heights: bool = False
    """Also write the heights; the first ten images are the untouched skin then."""
    force: str = "none"
    """Also write the wrench that physics or a force model (.onnx) reads from the images; the same holds of the first ten."""
    automatic: bool = False
    """Leave the camera's automatic exposure and white balance on, for one that cannot switch them off."""
    json: bool = False
    """Print the figures as one JSON object."""

    def run(self) -> int:
        """Record, and print_notice what there is; raises what a lost device raises, the file kept."""
        from ninedtact.recording.errors import require_recording_libraries

        require_recording_libraries()
        require_new_recording(self.out)
        require_seconds(self.seconds)
        require_alike(self.source, self.force_torque, is_sim)
        with sensor_of(self.sensor, self.source) as folder:
            episode = self.recorded(folder)
        found = {"out": str(self.out), "written": counts(episode), "dropped": episode.dropped}
        return print_result(self.json, found, lines(self.out, episode))

    def recorded(self, folder: "SensorFolder") -> "RecordingWriter":
        """The episode, finished."""
        from ninedtact.recording.reader import sensor_folder_attachments
        from ninedtact.recording.recorder import Recorder
        from ninedtact.recording.ros_messages import Topic
        from ninedtact.recording.writer import RecordingWriter

        camera, force_torque = self.sources(folder)
        meaning = self.interpretation(folder)
        topics = {Topic.IMAGES, *(meaning.topics if meaning else ()), *([Topic.MEASURED] if force_torque else ())}
        session = self.session(folder, camera, force_torque, meaning)
        episode = RecordingWriter(self.out, session, topics, sensor_folder_attachments(folder.path))
        with (
            stop_on_signal(self.seconds) as until,
            episode,
            progress(self.seconds, quiet=self.json) as demo_trajectories,
        ):
            Recorder(episode, camera, force_torque, meaning).run(
                lambda: until.now, lambda: demo_trajectories(until.elapsed_s, episode)
            )
        return episode

    def interpretation(self, folder: "SensorFolder") -> "RecordedEstimates | None":
        """What is written beside the images, if anything."""
        from ninedtact.force.estimator_loading import NONE, load_estimator
        from ninedtact.recording.recorder import RecordedEstimates

        if self.force == NONE and not self.heights:
            return None
        return RecordedEstimates(folder.shape, load_estimator(self.force, folder), self.heights)

    def sources(self, folder: "SensorFolder") -> "tuple[FrameSource, WrenchSource | None]":
        """Camera and force/torque sensor, not yet opened."""
        if is_sim(self.source):
            return twin_on_show(folder, self.force_torque is not None)
        from ninedtact.capture.frame_source import DEFAULT_CAMERA, FIXED_EXPOSURE

        camera = live_source(self.source, DEFAULT_CAMERA if self.automatic else FIXED_EXPOSURE)
        return camera, None if self.force_torque is None else measured(self.force_torque, folder)

    def session(
        self,
        folder: "SensorFolder",
        camera: "FrameSource",
        force_torque: "WrenchSource | None",
        meaning: "RecordedEstimates | None",
    ) -> "RecordingMetadata":
        """What is said once."""
        from importlib.metadata import version

        from ninedtact.recording.metadata import RecordingMetadata

        return RecordingMetadata(
            sensor=folder.id,
            purpose="record",
            source=camera.name,
            force_torque=force_torque.name if force_torque else "",
            settings=json.dumps(asdict(self), default=str),
            mm_per_px=meaning.shape.rectify.mm_per_px if meaning else 0.0,
            software=version("ninedtact"),
        )


def twin_on_show(folder: "SensorFolder", force_torque: bool) -> "tuple[FrameSource, WrenchSource | None]":
    """The sensor's twin, pressed by several objects in turn."""
    from ninedtact.calibration.twin.sensor_twin import build_sensor_twin
    from ninedtact.simulation.press_simulation import PressSimulation
    from ninedtact.simulation.simulated_sources import SimulatedCamera, SimulatedForceTorque, demo_trajectories

    stage = PressSimulation(build_sensor_twin(folder), demo_trajectories())
    return SimulatedCamera(stage), SimulatedForceTorque(stage) if force_torque else None


def measured(text: str, folder: "SensorFolder") -> "WrenchSource":
    """A device as it tells, in the sensor frame; samples that it calls wrong itself are left out, and that is said."""
    from ninedtact.capture.force_torque.pipeline import MountedWrenchSource
    from ninedtact.capture.force_torque.sample_checks import SkippingWrenchSource

    opened = device(
        text, on_lost=lambda loss: print_notice(f"{loss}; waiting for it"), on_back=lambda: print_notice("it is back")
    )
    told = SkippingWrenchSource(opened, on_skip=lambda reason: print_notice(f"{reason}; left out"))
    return MountedWrenchSource(told, folder.record.design.force_torque)


def require_new_recording(out: Path) -> None:
    """Refuse a name that other programs would not know, and one that is taken; raises `RecordImpossible`."""
    if out.suffix.lower() != RECORDING:
        raise RecordImpossible(f"expected --out to end in {RECORDING}, got {out}; add it")
    if out.exists():
        raise RecordImpossible(f"expected --out to be a new file, got {out}; choose another name")


def require_seconds(seconds: float | None) -> None:
    """Refuse a recording of no time; raises `RecordImpossible`."""
    if seconds is not None and not 0 < seconds < float("inf"):
        raise RecordImpossible(f"expected --seconds above zero, got {seconds}; drop it to record until Ctrl-C")


def counts(episode: "RecordingWriter") -> dict[str, int]:
    """How many messages of each topic were written."""
    return {topic.value: number for topic, number in sorted(episode.written.items())}


def lines(out: Path, episode: "RecordingWriter") -> Iterator[str]:
    """The same for a person."""
    size_mb = out.stat().st_size / 1e6
    yield f"{out}: {size_mb:.1f} MB, {episode.dropped} images dropped"
    yield from (f"  {number:8d}  {topic}" for topic, number in counts(episode).items())


@contextmanager
def progress(seconds: float | None, quiet: bool) -> Iterator[Callable[[float, "RecordingWriter"], None]]:
    """A bar on standard error over the seconds; what to call while it goes on."""
    from tqdm import tqdm

    total, form = seconds and round(seconds, 1), BAR if seconds else BAR_WITHOUT_END
    with tqdm(total=total, disable=quiet, bar_format=form, delay=FIRST_SHOWN_S) as bar:

        def demo_trajectories(elapsed_s: float, episode: "RecordingWriter") -> None:
            bar.set_postfix_str(f"{episode.written.total()} messages, {episode.dropped} dropped", refresh=False)
            bar.update(round(min(elapsed_s, seconds or elapsed_s), 1) - bar.n)

        yield demo_trajectories
