"""ninedtact info: what is in a recording. ninedtact export: recordings as images, tables and heights in files of their own."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from msgspec import Meta

from ninedtact._version import find_entry_point
from ninedtact.cli.record import require_new_recording_path
from ninedtact.cli.result_and_interrupt import print_notices, print_result
from ninedtact.cli.shared_options import JsonOption, RecordedSensorOption
from ninedtact.errors import InputError, MissingLibraryError
from ninedtact.required_libraries import require_libraries

if TYPE_CHECKING:
    from ninedtact.recording.reader import Recording
    from ninedtact.recording.summary import RecordingSummary


_MISSING_REST = "The rest is missing. If the recording program crashed, that is about half a second."
_REPAIRED = f"This is the whole copy of a file that was cut short. {_MISSING_REST}"


@dataclass(frozen=True)
class InfoCommand:
    """Print what is in a recording: topics, rates, drops, gaps, pairs. To watch it: ninedtact live --source FILE.

    Images and other messages are not checked for damage, which takes minutes for a large file; `ninedtact export` checks them.
    """

    recording: Annotated[Path, tyro.conf.Positional]
    """File that `ninedtact record` or `ninedtact collect` wrote, finished or cut short."""
    whole_copy: Path | None = None
    """Write what is whole of a file that was cut short to this new file (.mcap), which other programs read too."""
    sensor: RecordedSensorOption = None
    json: JsonOption = False

    def run(self) -> int:
        """Read the recording through its index and print its summary."""
        from ninedtact.recording.errors import require_recording_libraries

        require_recording_libraries()
        with ExitStack() as opened:
            recordings = _open_each_sensor(opened, self.recording, self.sensor)
            if self.whole_copy is not None:
                _write_whole_copy(recordings, self.whole_copy)
            summaries = [recording.summary() for recording in recordings]
            lines = [line for summary in summaries for line in _summary_lines(recordings[0].path, summary)]
            lines += _ending_lines(recordings, max(summary.seconds for summary in summaries))
            lines += [] if self.whole_copy is None else [f"  {self.whole_copy} holds what is whole."]
            notices = _sensor_notices(recordings)
        figures = [asdict(summary) for summary in summaries]
        print_result(self.json, figures[0] if len(figures) == 1 else {"sensors": figures}, lines)
        print_notices(notices)
        return 0


def _open_each_sensor(opened: ExitStack, path: Path, sensor: Path | None) -> "list[Recording]":
    """Open the recording of each sensor of a file, or that of the sensor whose folder is given."""
    from ninedtact.recording.reader import Recording, recorded_sensor_addresses

    addresses = recorded_sensor_addresses(path) if sensor is None else [str(path)]
    return [opened.enter_context(Recording(address, sensor)) for address in addresses]


def _sensor_notices(recordings: "list[Recording]") -> list[str]:
    """Return a sentence for each recording that carries no sensor folder."""
    return [
        f"{one.path} carries no sensor folder for {one.sensor!r}: its images can be measured with --sensor FOLDER"
        for one in recordings
        if not one.sensor_files()
    ]


def _write_whole_copy(recordings: "list[Recording]", out: Path) -> None:
    """Write what is whole of some sensors' recordings, which are one file, to a new file.

    Raises `RecordingUnreadable` where it has no image, because as a finished file it would pass for a whole one.
    """
    from ninedtact.recording.export import require_exportable
    from ninedtact.recording.labels_and_whole_copy import write_whole_copy

    require_new_recording_path(out, "--whole-copy")
    require_exportable(recordings)
    write_whole_copy(recordings[0].path, out)


def _summary_lines(path: Path, summary: "RecordingSummary") -> Iterator[str]:
    yield f"{path}: {summary.seconds:.1f} s from {summary.began}, {path.stat().st_size / 1e6:.1f} MB"
    named = f"{summary.name}: " * bool(summary.name)
    calibration = f" (calibration {summary.calibration_checksum[:8]})" * bool(summary.calibration_checksum)
    yield f"  {named}sensor {summary.sensor}{calibration}, images from {summary.source}"
    if summary.force_torque:
        yield f"  forces from {summary.force_torque}"
    for topic in summary.topics:
        rate = ""
        if topic.rate_hz is not None:
            rate = f", {topic.rate_hz:.1f} Hz, {topic.gaps} gaps, longest {topic.longest_gap_ms:.0f} ms"
        yield f"  {topic.messages:8d}  {topic.topic} ({topic.type}){rate}"
    yield f"  {summary.dropped} images dropped"
    if summary.height_step_mm:
        yield f"  heights in steps of {summary.height_step_mm:g} mm"
    if summary.camera_delay_ms:
        yield f"  stamps are arrival times less the camera's delay of {summary.camera_delay_ms:g} ms"
    for span in summary.spans:
        yield f"  label '{span.label}': {(span.end_ns - span.begin_ns) / 1e9:.2f} s from stamp {span.begin_ns / 1e9:.2f} s on"
    if summary.pairs:
        yield f"  pairs: {', '.join(f'{number} {kind}' for kind, number in summary.pairs.items())}"


def _ending_lines(recordings: "list[Recording]", seconds: float) -> Iterator[str]:
    """Yield how far the file of some sensors' recordings can be used; seconds: duration of what is there."""
    from ninedtact.recording.errors import RecordingUnreadable
    from ninedtact.recording.export import require_exportable

    if recordings[0].is_being_written:
        yield f"  The file is still being written: {seconds:.1f} s so far."
    elif not recordings[0].is_finished:
        yield f"  The file was cut short: it ends after {seconds:.1f} s. {_MISSING_REST}"
        try:
            require_exportable(recordings)
            yield "  It can be read as it is; 'ninedtact info --whole-copy FILE' writes a whole one for other programs."
        except RecordingUnreadable as refusal:
            yield f"  It cannot be exported: {refusal}."
    elif recordings[0].is_repaired:
        yield f"  {_REPAIRED}"
    yield "  Images and other messages are not checked for damage here; 'ninedtact export' checks them."


def _ending_notices(recordings: "list[Recording]") -> dict[Path, str]:
    """Return what is to be known about the end of every file; the sensors of one file have one end, that of the longest."""
    notices, seconds = dict[Path, str](), dict[Path, float]()
    for recording in recordings:
        path = recording.path
        seconds[path] = max(recording.duration_s, seconds.get(path, 0.0))
        if not recording.is_finished:
            notices[path] = str(recording.missing_end_error(seconds[path]))
        elif recording.is_repaired:
            notices[path] = f"{path}: {_REPAIRED}"
    return notices


def _load_lerobot_exporter() -> Callable[..., dict[str, int]]:
    found = find_entry_point("exporters", "lerobot")
    if found is None:
        raise MissingLibraryError(
            expected="the LeRobot plugin, which writes data sets of LeRobot",
            got="none",
            remedy="run pip install lerobot_camera_ninedtact",
        )
    exporter: Callable[..., dict[str, int]] = found.load()
    return exporter


@dataclass(frozen=True)
class ExportCommand:
    """Export a recording: images as PNG, wrenches, pairs, labels and times as CSV, heights as .npy, and the sensor folder."""

    recordings: tyro.conf.Positional[tuple[Path, ...]]
    """File that `ninedtact record` or `ninedtact collect` wrote; with `--to lerobot` one or more."""
    out: Path
    """New or empty folder; with `--to rerun`, a new file (.rrd)."""
    to: Literal["files", "lerobot", "rerun"] = "files"
    """`lerobot` writes a LeRobotDataset v3.0, each recording an episode: images, and wrenches at their times. `rerun`
    writes a file for the Rerun viewer: images, surfaces, wrenches with error bands."""
    task: str = "touch"
    """With `--to lerobot`: what is done in the recordings, in words."""
    fps: Annotated[int, Meta(ge=1)] | None = None
    """With `--to lerobot`: frames per second of the data set; the nearest images are taken. Otherwise all images are, and the
    recordings must have one rate, within 5 %."""
    tracking: bool = False
    """With `--to lerobot`: add contacts, motion of the object and slip, as `ninedtact track` finds them; Rerun has them always."""
    sensor: RecordedSensorOption = None
    points_every: Annotated[int, Meta(ge=1)] = 4
    """With `--to rerun`: write the points of every so many rows and columns of the height map."""
    json: JsonOption = False

    def run(self) -> int:
        """Export everything and print how many files and rows were written; return 1 where a recording has no end."""
        if len(self.recordings) != 1 and not (self.recordings and self.to == "lerobot"):
            raise InputError(
                expected="one recording, or several with --to lerobot",
                got=f"{len(self.recordings) or 'none'} with --to {self.to}",
                remedy="export each into a folder or file of its own",
            )
        from ninedtact.recording.errors import require_recording_libraries

        require_recording_libraries()
        from tqdm import tqdm

        from ninedtact.recording.export import export_each_sensor
        from ninedtact.recording.reader import Recording
        from ninedtact.recording.topics_and_messages import Topic

        with ExitStack() as opened:
            if self.to == "files":
                recordings = _open_each_sensor(opened, self.recordings[0], self.sensor)
            else:  # these are of one sensor, which `Recording` asks for
                recordings = [opened.enter_context(Recording(path, self.sensor)) for path in self.recordings]
            images = sum(len(recording.positions(Topic.IMAGES)) for recording in recordings)
            with tqdm(total=images, unit="images", disable=True if self.json else None) as bar:
                if self.to == "lerobot":
                    written = _load_lerobot_exporter()(
                        recordings, self.out, self.task, on_image=bar.update, fps=self.fps, tracking=self.tracking
                    )
                elif self.to == "rerun":
                    require_libraries("rerun", "rerun")
                    from ninedtact.interop.rerun import export_rerun

                    written = export_rerun(recordings[0], self.out, self.points_every, on_image=bar.update)
                else:
                    written = export_each_sensor(recordings, self.out, on_image=bar.update)
            is_finished = all(recording.is_finished for recording in recordings)
            notices = [*_sensor_notices(recordings), *_ending_notices(recordings).values()]
        figures = {"out": str(self.out), "finished": is_finished, "written": written}
        lines = [f"{self.out}:", *(f"  {number:8d}  {kind}" for kind, number in written.items())]
        print_result(self.json, figures, lines)
        print_notices(notices)
        return 0 if is_finished else 1
