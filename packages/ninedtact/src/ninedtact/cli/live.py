"""ninedtact live: show a sensor live in the browser. ninedtact play: a recording there, with its time on a slider."""

from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact.cli.result_and_interrupt import given_or_recorded_sensor, print_notice, stop_on_signal
from ninedtact.cli.serve_sensor_page import (
    PageSensor,
    require_page_libraries,
    serve_sensor_page,
)
from ninedtact.cli.shared_options import (
    CameraOption,
    CameraOptions,
    DisplayRateOption,
    FollowReferenceOption,
    ForceOption,
    LoopOption,
    NamedSensorsOption,
    NamedSourcesOption,
    PageAddressOption,
    PageAddressOptions,
    ReferenceOrFirstOption,
    parse_named_sources,
)
from ninedtact.errors import InputError
from ninedtact.force.estimator_loading import NONE
from ninedtact.live_sensor import assemble_live_sensor
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.source_addresses import RECORDING_SUFFIX, SIMULATED, is_recording_address

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder

MAX_SENSORS = 4
"""Number of sensors that one page has room for."""


@dataclass(frozen=True)
class LiveCommand:
    """Show sensors live in the browser: camera image, heights, 3D surface, wrench, rates. Ctrl-C ends it.

    A twin is shown with its true wrench. Several sensors are shown on one page, with the grip force of each two in their order.
    Without --loop, the last image of a recording stays.
    """

    source: NamedSourcesOption
    sensor: NamedSensorsOption = ()
    reference: ReferenceOrFirstOption = ()
    force: ForceOption = NONE
    out: Path = Path("readings")
    """Folder for the readings that are saved from the page."""
    follow_reference: FollowReferenceOption = True
    camera: CameraOption = CameraOptions()
    loop: LoopOption = False
    display_hz: DisplayRateOption = 30.0
    address: PageAddressOption = PageAddressOptions()

    def run(self) -> int:
        """Serve the page until Ctrl-C."""
        require_page_libraries()
        guard = self.address.new_guard()
        named = self.named_sources()
        with ExitStack() as opened:
            parts = []
            for name, (address, path) in named.items():
                folder = opened.enter_context(given_or_recorded_sensor(path, address))
                live = assemble_live_sensor(
                    folder,
                    address,
                    self.reference,
                    self.camera.settings(),
                    self.follow_reference,
                    self.loop,
                    self.force,
                    name,
                    notify=print_notice,
                )
                parts.append(PageSensor(folder, live, name))
            ends = all(address == SIMULATED for address, _ in named.values())
            with suppress(KeyboardInterrupt):
                serve_sensor_page(parts, guard, self.address.port, self.out, self.display_hz, ends)
        counts = [f"{part.live.sensor.frames_read} images" + f" of {part.name}" * bool(part.name) for part in parts]
        print(f"stopped after {', '.join(counts)}")
        return 0

    def named_sources(self) -> dict[str, tuple[str, Path | None]]:
        """Return address and sensor folder of all sources by their names; raises `InputError`."""
        named = parse_named_sources(self.source, self.sensor)
        if len(named) > MAX_SENSORS:
            raise InputError(
                expected=f"at most {MAX_SENSORS} sources on one page", got=f"{len(named)}", remedy="drop some"
            )
        if self.reference and "" not in named:
            raise InputError(
                expected="no --reference with named sources",
                got=f"{self.reference[0]}",
                remedy="drop it: the first images of each are its reference",
            )
        return named


@dataclass(frozen=True)
class PlayCommand:
    """Show a recording in the browser: its time on a slider, frame by frame, at any speed; labels, and exports. Ctrl-C ends it."""

    recording: Annotated[Path, tyro.conf.Positional]
    """Recording (.mcap) of `ninedtact record`, of `collect`, or of the live page."""
    sensor: Path | None = None
    """Sensor folder to measure the images with, in place of the one that the recording carries."""
    out: Path = Path("readings")
    """Folder for what is exported from the page."""
    display_hz: DisplayRateOption = 30.0
    address: PageAddressOption = PageAddressOptions()

    def run(self) -> int:
        """Serve the page until Ctrl-C."""
        require_page_libraries()
        if not is_recording_address(str(self.recording)):
            raise RecordingUnreadable(
                expected=f"a recording ({RECORDING_SUFFIX})", got=f"{self.recording}", remedy="check the path"
            )
        from ninedtact.recording.reader import Recording, recorded_sensor_addresses

        addresses = recorded_sensor_addresses(self.recording)
        with Recording(addresses[0]) as recording:
            if not recording.is_finished:
                print_notice(str(recording.missing_end_error()))
        with ExitStack() as opened:
            folders = {
                address: opened.enter_context(given_or_recorded_sensor(self.sensor, address)) for address in addresses
            }
            with suppress(KeyboardInterrupt):
                self.serve(folders)
        return 0

    def serve(self, folders: "dict[str, SensorFolder]") -> None:
        """Serve the recording of these sensors; raises what reading it raises, before anything is served."""
        from ninedtact.live.sensor_poller import SensorPoller
        from ninedtact.recording.recorded_source import RecordedFrameSource
        from ninedtact.sensor import Sensor
        from ninedtact.studio.page_controller import DisplayedSensor, PageController
        from ninedtact.studio.page_server import page_server
        from ninedtact.studio.recorded_readings import empty_wrench_histories
        from ninedtact.studio.recordings_panel import RecordingsPanel, RecordingsPanelContext
        from ninedtact.studio.scene_3d import gel_block_under_skin
        from ninedtact.studio.sensor_page import SensorPage

        columns = {address: empty_wrench_histories(Path(address), one.shape) for address, one in folders.items()}
        folder, shapes = next(iter(folders.values())), {address: one.shape for address, one in folders.items()}
        guard = self.address.new_guard()
        with page_server(guard, self.address.port) as server:
            # These sensors are never opened: every viewer is shown a moment of the recording in their place.
            sensors = [
                DisplayedSensor(
                    SensorPoller(Sensor(RecordedFrameSource(address), shape)),
                    columns[address],
                    name=address.partition("#")[2],
                )
                for address, shape in shapes.items()
            ]
            controller = PageController(sensors, self.out, recheck_s=0.0)
            block = gel_block_under_skin(folder.shape, folder.record.design.gel)
            context = RecordingsPanelContext(folder, None, self.recording, shapes)
            title = folder.id if len(folders) == 1 else self.recording.stem
            page = SensorPage(server, controller, block, title, [partial(RecordingsPanel, context=context)])
            print(f"{self.recording}: open {guard.page_address(server.port)} in a browser; Ctrl-C ends", flush=True)
            with stop_on_signal() as stop:
                controller.run(page, self.display_hz, lambda: stop.now)
