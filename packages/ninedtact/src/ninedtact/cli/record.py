"""ninedtact record: everything that a sensor and a force/torque sensor deliver, as one file."""

import json
import sys
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ninedtact.cli.result_and_interrupt import (
    given_or_recorded_sensor,
    load_estimator_with_notices,
    print_notice,
    print_result,
    stop_on_signal,
)
from ninedtact.cli.shared_options import (
    CameraDelayOption,
    CameraOption,
    CameraOptions,
    ForceTorqueOption,
    JsonOption,
    NamedSensorsOption,
    NamedSourcesOption,
    SecondsOption,
    parse_named_sources,
)
from ninedtact.errors import OutputError
from ninedtact.force.estimator_loading import NONE
from ninedtact.recording.errors import require_recording_libraries
from ninedtact.source_addresses import (
    RECORDING_SUFFIX,
    is_twin_address,
    require_matching_force_source,
    source_in_real_time,
)

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.frame_source import FrameSource
    from ninedtact.capture.wrench_source import WrenchSource
    from ninedtact.errors import NinedtactError
    from ninedtact.recording.recorder import SensorToRecord
    from ninedtact.recording.writer import RecordingWriter

_BAR = "{n:.0f} of {total:.0f} s |{bar}| {remaining} left{postfix}"
_BAR_WITHOUT_END = "{n:.0f} s{postfix}"
_BAR_DELAY_S = 0.3
"""A camera that is not there is reported before the bar appears."""


@dataclass(frozen=True)
class RecordCommand:
    """Record a sensor: images without loss, measured wrenches, and heights and forces on request. Ctrl-C ends it properly.

    The sensor folder is attached to the recording. Several sensors are recorded at once into one file, with stamps of one clock; a
    sensor that fails is reported, and the others go on. The delay of the camera is subtracted from the stamps of its images, and
    stated in the recording.
    """

    source: NamedSourcesOption
    out: Path
    """Recording to write: a new .mcap file, which ROS 2 and Foxglove read. Images (bit for bit) and wrenches are stored without
    loss, and heights too unless --height-bits is 16. Images drop if the disk or the computer is too slow for the camera and 128 of
    them wait already; they are counted, printed, and marked in the file at their place."""
    sensor: NamedSensorsOption = ()
    force_torque: ForceTorqueOption = None
    seconds: SecondsOption = None
    images: Literal["zstd", "png"] = "zstd"
    """Storage of images, both without loss: raw, in chunks that zstd compresses (sensor_msgs/Image), or each as a PNG
    (sensor_msgs/CompressedImage), which is smaller and takes longer to read (docs: recording)."""
    heights: bool = False
    """Also record the heights; the first ten images are then taken as reference images (no contact). A twin brings its own."""
    height_bits: Literal[32, 16] = 32
    """Storage of heights: 32, floating point without loss; 16, integers in steps of 0.001 mm, which are smaller and lose up to half
    a step."""
    camera_delay_ms: CameraDelayOption = 0.0
    force: str = NONE
    """Also record the wrench estimated from the images, by physics or by a force model (.onnx); takes the same reference images."""
    camera: CameraOption = CameraOptions()
    json: JsonOption = False

    def run(self) -> int:
        """Record and print the number of messages; return 1 where one of several sensors failed, and the others went on.

        Raises what a lost device raises where there is only one sensor, the file kept.
        """
        require_recording_libraries()
        require_new_recording_path(self.out)
        if self.height_bits == 16 and not self.heights:
            raise OutputError(
                expected="--height-bits with --heights",
                got="it alone",
                remedy="give --heights as well, or leave it out",
            )
        named = parse_named_sources(self.source, self.sensor)
        if "" in named:
            require_matching_force_source(named[""][0], self.force_torque, is_twin_address)
        elif self.force_torque is not None:
            raise OutputError(
                expected="one --source with --force-torque", got="several", remedy="record them one by one"
            )
        with ExitStack() as opened:
            parts = {}
            for name, (address, sensor) in named.items():
                folder = opened.enter_context(given_or_recorded_sensor(sensor, address))
                parts[name] = self._part(folder, address, name)
            writers, errors = self._record(parts)
        self._print_result(writers, errors)
        return 1 if errors else 0

    def _record(
        self, parts: "dict[str, SensorToRecord]"
    ) -> "tuple[dict[str, RecordingWriter], dict[str, NinedtactError]]":
        """Record one sensor, whose name is empty, or several; return their closed writers and the errors of those that failed."""
        from tqdm import tqdm

        from ninedtact.recording.metadata import HEIGHT_STEP_16_BIT_MM
        from ninedtact.recording.recorder import record_several

        with stop_on_signal() as until, _progress_bar(self.seconds, quiet=self.json) as show:
            return record_several(
                parts,
                self.out,
                heights=self.heights,
                settings=json.dumps(asdict(self), default=str),
                images=self.images,
                height_step_mm=HEIGHT_STEP_16_BIT_MM if self.height_bits == 16 else 0.0,
                seconds=self.seconds,
                should_stop=lambda: until.now,
                notify=lambda sentence: tqdm.write(f"ninedtact: {sentence}", sys.stderr),  # on a line of its own
                on_progress=lambda writers: show(until.elapsed_s, writers),
            )

    def _print_result(self, writers: "dict[str, RecordingWriter]", errors: "dict[str, NinedtactError]") -> None:
        messages = {
            topic.path(writer.metadata.topic_name, self.images): number
            for writer in writers.values()
            for topic, number in sorted(writer.written.items())
        }
        lost = {name: str(error) for name, error in errors.items()}
        dropped = {name: writer.dropped for name, writer in writers.items()}
        warned = {name: writer.warned for name, writer in writers.items()}
        figures: dict[str, Any] = {
            "out": str(self.out),
            "written": messages,
            "dropped": dropped,
            "warnings": warned,
            "lost": lost,
        }
        if "" in writers:
            figures |= {"dropped": dropped[""], "warnings": warned[""]}
        counts = ", ".join(f"{number} of {name}" if name else f"{number}" for name, number in dropped.items())
        lines = [f"{self.out}: {self.out.stat().st_size / 1e6:.1f} MB, images dropped: {counts}"]
        lines += [f"  {number:8d}  {topic}" for topic, number in messages.items()]
        lines += [
            f"  {f'{name}: ' * bool(name)}{number} {'image has' if number == 1 else 'images have'} the warning '{text}'"
            for name, writer in writers.items()
            for text, number in writer.warned.items()
        ]
        print_result(self.json, figures, lines + [f"  {name}: {error}" for name, error in lost.items()])

    def _part(self, folder: "SensorFolder", address: str, name: str) -> "SensorToRecord":
        """Return what is recorded of one sensor, not yet opened; name: of the sensor among several."""
        from ninedtact.capture.camera_delay import resolve_camera_delay_ms
        from ninedtact.recording.recorder import SensorToRecord

        if is_twin_address(address):
            camera, force_torque = twin_sources(folder, self.force_torque is not None, name)
        else:
            settings = self.camera.settings()
            camera = source_in_real_time(address, settings, sensor=folder, keeps_times=True)
            force_torque = None
            if self.force_torque is not None:
                from ninedtact.capture.force_torque.wrench_source_from_address import untared_wrench_source_for

                mount = folder.record.design.force_torque
                force_torque = untared_wrench_source_for(self.force_torque, mount, print_notice)
        camera_delay_ms = resolve_camera_delay_ms(self.camera_delay_ms, folder.path, camera.name)
        estimator = load_estimator_with_notices(self.force, folder)
        return SensorToRecord(camera, folder, force_torque, estimator, camera_delay_ms)


def twin_sources(
    folder: "SensorFolder", force_torque: bool, name: str = ""
) -> "tuple[FrameSource, WrenchSource | None]":
    """Return camera and force/torque sensor of the twin of a sensor, pressed by several objects in turn.

    name: of the sensor among several, each of which has noise of its own.
    """
    from ninedtact.simulation.simulated_sources import SimulatedForceTorque, demo_sources

    sources = demo_sources(folder.twin().with_noise_of(name))
    return sources.camera, SimulatedForceTorque(sources.simulation) if force_torque else None


def require_new_recording_path(out: Path, option: str = "--out") -> None:
    """Raise `OutputError` for a name without .mcap, which other programs would not know, and for one that exists."""
    if out.suffix.lower() != RECORDING_SUFFIX:
        raise OutputError(expected=f"{option} to end in {RECORDING_SUFFIX}", got=str(out), remedy="add it")
    if out.exists():
        raise OutputError(expected=f"{option} to be a new file", got=str(out), remedy="choose another name")


@contextmanager
def _progress_bar(
    seconds: float | None, quiet: bool
) -> Iterator[Callable[[float, "Collection[RecordingWriter]"], None]]:
    """Show a progress bar on standard error; yield the function that updates it."""
    from tqdm import tqdm

    total, form = seconds and round(seconds, 1), _BAR if seconds else _BAR_WITHOUT_END
    with tqdm(total=total, disable=True if quiet else None, bar_format=form, delay=_BAR_DELAY_S) as bar:

        def show(elapsed_s: float, writers: "Collection[RecordingWriter]") -> None:
            messages, dropped = sum(one.written.total() for one in writers), sum(one.dropped for one in writers)
            bar.set_postfix_str(f"{messages} messages, {dropped} dropped", refresh=False)
            bar.update(round(min(elapsed_s, seconds or elapsed_s), 1) - bar.n)

        yield show
