"""ninedtact demo: the twin of a sensor, calibrated from its own images, in the browser; no hardware is needed."""

import sys
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from msgspec import Meta

from ninedtact.cli.result_and_interrupt import load_sensor_with_notices
from ninedtact.cli.serve_sensor_page import (
    PageSensor,
    require_page_libraries,
    serve_sensor_page,
)
from ninedtact.cli.shared_options import (
    DesignFileOption,
    DisplayRateOption,
    ForceOption,
    PageAddressOption,
    PageAddressOptions,
    read_design_or_default,
    refuse_design_beside_sensor,
)
from ninedtact.design import SensorDesign
from ninedtact.force.estimator_loading import PHYSICS
from ninedtact.live_sensor import assemble_live_sensor

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.simulation.twin import Twin


@dataclass(frozen=True)
class DemoCommand:
    """Show a simulated sensor in the browser, pressed by hand or by a sequence of objects, with its true and its estimated wrench.

    Without a terminal it stops after one round.
    """

    sensor: Path | None = None
    """Sensor folder whose twin is shown; without one, the twin of the published design is calibrated and shown."""
    design_file: DesignFileOption = None
    """Design file (TOML) with what differs from the published sensor; its twin is calibrated and shown."""
    force: ForceOption = PHYSICS
    out: Path = Path("out/demo")
    """Folder for the sensor folder, and for what is saved from the page."""
    rounds: Annotated[int, Meta(ge=1)] | None = None
    """Number of rounds of the press sequence; without it, the demo runs until Ctrl-C at a terminal."""
    display_hz: DisplayRateOption = 30.0
    address: PageAddressOption = PageAddressOptions()
    browser: bool = True
    """Open the page in the browser, where there is a terminal and a screen."""

    def run(self) -> int:
        """Calibrate the twin, then show it."""
        from ninedtact.simulation.simulated_sources import demo_sources

        refuse_design_beside_sensor(self.sensor, self.design_file)
        require_page_libraries()
        guard = self.address.new_guard()
        self.out.mkdir(parents=True, exist_ok=True)
        folder = self.folder
        sources = demo_sources(self.twin, self.resolved_rounds)
        live = assemble_live_sensor(folder, sources, follow_reference=False, estimator=self.force)
        if self.rounds is None and self.resolved_rounds is not None:
            print("without a terminal the demo ends after one round; --rounds gives more", flush=True)
        with suppress(KeyboardInterrupt):
            serve_sensor_page(
                [PageSensor(folder, live)],
                guard,
                self.address.port,
                self.out,
                self.display_hz,
                opens_browser=self.browser,
            )
        print(f"stopped after {live.sensor.frames_read} images; the sensor is in {folder.path}")
        return 0

    @property
    def resolved_rounds(self) -> int | None:
        """The number of rounds: one without a terminal, where Ctrl-C cannot be pressed."""
        return self.rounds or (None if sys.stdout.isatty() else 1)

    @cached_property
    def twin(self) -> "Twin":
        """The twin that is pressed."""
        if self.sensor is not None:
            return self.folder.twin()
        from ninedtact.simulation.twin import twin_from_design

        return twin_from_design(self.design)

    @cached_property
    def design(self) -> SensorDesign:
        """The design of the twin that is calibrated."""
        return read_design_or_default(self.design_file)

    @cached_property
    def folder(self) -> "SensorFolder":
        """The folder of the calibrated sensor."""
        if self.sensor is not None:
            return load_sensor_with_notices(self.sensor)
        return calibrate_twin_as_sensor(self.twin, self.design, self.out / "sensor")


def calibrate_twin_as_sensor(twin: "Twin", design: SensorDesign, out: Path) -> "SensorFolder":
    """Calibrate a twin from its four simulated calibration images, as any other sensor, and save it; prints what is done."""
    from ninedtact.calibration.procedure import CalibrationImages, calibrate
    from ninedtact.calibration.save import save_sensor
    from ninedtact.simulation.calibration_images import simulate_calibration_images

    print("pressing the pin board and the ball on the twin, and calibrating it from the four images …", flush=True)
    images = CalibrationImages(**vars(simulate_calibration_images(twin, design)))
    folder = save_sensor(out, calibrate(images, design, sensor_id="twin"))
    print(f"  calibrated: {folder.path / 'certificate.html'}", flush=True)
    return folder
