"""ninedtact demo: the twin of a sensor, calibrated from its own images, in the browser; no hardware is needed."""

import json
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ninedtact.cli.result_and_interrupt import load_sensor_with_notices
from ninedtact.cli.serve_sensor_page import (
    PageSensor,
    PageSettings,
    require_display_rate,
    require_page_libraries,
    serve_sensor_page,
)
from ninedtact.cli.shared_options import (
    DesignFileOption,
    DisplayRateOption,
    ForceOption,
    PageHostOption,
    PageOriginOption,
    PagePortOption,
    read_design_or_default,
    refuse_design_beside_sensor,
)
from ninedtact.design import SensorDesign
from ninedtact.errors import InputError
from ninedtact.force.estimator_loading import PHYSICS
from ninedtact.live_sensor import assemble_live_sensor

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.simulation.press_figures import ReconstructedPress
    from ninedtact.simulation.press_sequence import ObjectTrajectory
    from ninedtact.simulation.twin import Twin

STEPS_HZ = 6.0
"""Rate of the steps of the drawn presses, as coarse as friction allows."""


@dataclass(frozen=True)
class Demo:
    """Show a simulated sensor in the browser, pressed by hand or by a sequence of objects, with its true and its estimated wrench.

    Without a terminal it stops after one round. Results are written to a folder either way.
    """

    sensor: Path | None = None
    """Sensor folder whose twin is shown; without one, the twin of the published design is calibrated and shown."""
    design_file: DesignFileOption = None
    """Design file (TOML) of a sensor that is not built yet; its twin is calibrated and shown."""
    force: ForceOption = PHYSICS
    out: Path = Path("out/demo")
    """Folder for the sensor folder, images and figures."""
    rounds: int | None = None
    """Number of rounds of the press sequence; without it, the demo runs until Ctrl-C at a terminal."""
    display_hz: DisplayRateOption = 30.0
    host: PageHostOption = "127.0.0.1"
    port: PagePortOption = None
    browser: bool = True
    """Open the page in the browser, where there is a terminal and a screen."""
    allow_origin: PageOriginOption = ()

    def run(self) -> int:
        """Calibrate, reconstruct one press of each object, then show them live."""
        from ninedtact.simulation.simulated_sources import demo_sources

        self.require_rounds()
        refuse_design_beside_sensor(self.sensor, self.design_file)
        require_display_rate(self.display_hz)
        require_page_libraries()
        self.out.mkdir(parents=True, exist_ok=True)
        folder = self.folder
        self.write_summary(self.compare_presses(folder))
        sources = demo_sources(self.twin, self.resolved_rounds)
        live = assemble_live_sensor(folder, sources, follow_reference=False, estimator=self.force)
        settings = PageSettings(
            self.out,
            self.display_hz,
            self.host,
            self.port,
            self.allow_origin,
            opens_browser=self.browser,
        )
        if self.rounds is None and self.resolved_rounds is not None:
            print("without a terminal the demo ends after one round; --rounds gives more", flush=True)
        with suppress(KeyboardInterrupt):
            serve_sensor_page([PageSensor(folder, live)], settings)
        print(f"stopped after {live.sensor.frames_read} images; results are in {self.out}")
        return 0

    def require_rounds(self) -> None:
        """Refuse fewer rounds than one; raises `InputError`."""
        if self.rounds is not None and self.rounds < 1:
            raise InputError(expected="--rounds of at least 1", got=f"{self.rounds}", remedy="drop it")

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

    def compare_presses(self, folder: "SensorFolder") -> "list[ReconstructedPress]":
        """Press each object once, and reconstruct its heights from the image."""
        from tqdm import tqdm

        from ninedtact.simulation.simulated_sources import demo_press_sequence, simulate_reference_frames

        reader = folder.shape.depth_reader(*simulate_reference_frames(self.twin))
        progress = tqdm(
            demo_press_sequence(), desc="pressing and reconstructing", unit="object", disable=None, leave=False
        )
        return [self.compare_press(act, folder, reader) for act in progress]

    def compare_press(self, act: "ObjectTrajectory", folder: "SensorFolder", reader: Any) -> "ReconstructedPress":
        """Compare one press at the end of its drag and twist."""
        from ninedtact.quantities import Frame
        from ninedtact.simulation.ground_truth import true_height_map_like
        from ninedtact.simulation.press_figures import ReconstructedPress
        from ninedtact.simulation.press_sequence import PressSequence

        stage = PressSequence(self.twin, [act], STEPS_HZ, real_time=False)
        contact = stage.contact(int(act.trajectory.lift_start_s * STEPS_HZ - 1e-6))
        image = self.twin.renderer(contact, 1)
        seen = reader(folder.shape.rectify(Frame(image)))
        true = true_height_map_like(contact, seen, self.twin.renderer.light.inverse_distance_per_mm)
        return ReconstructedPress(act.indenter.name, image, true, seen, contact.wrench())

    def write_summary(self, answers: "list[ReconstructedPress]") -> None:
        """Write figure and numbers of all presses, and print a line for each."""
        from ninedtact.atomic_write import write_file_atomically
        from ninedtact.simulation.press_figures import plot_presses_beside_reconstructions

        write_file_atomically(self.out / "presses.png", plot_presses_beside_reconstructions(answers))
        presses = [_comparison_to_json_dict(each) for each in answers]
        figures = {"sensor": str(self.folder.path), "twin": self.twin.name, "presses": presses}
        write_file_atomically(self.out / "summary.json", json.dumps(figures, indent=2, ensure_ascii=False).encode())
        for figure in presses:
            print("  {object}: {true_mm:.2f} mm deep, reconstructed {reconstructed_mm:.2f} mm".format(**figure))
        print(f"  figure: {self.out / 'presses.png'}", flush=True)


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


def _comparison_to_json_dict(answer: "ReconstructedPress") -> dict[str, Any]:
    """Return the numbers of one press for JSON."""
    true, seen = answer.peaks_mm
    wrench = {name: value.tolist() for name, value in asdict(answer.wrench).items() if name != "stamp_ns"}
    return {
        "object": answer.name,
        "true_mm": true,
        "reconstructed_mm": seen,
        "mean_error_mm": answer.mean_error_mm,
        "wrench": wrench,
    }
