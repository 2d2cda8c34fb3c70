"""ninedtact demo: the twin of a sensor, calibrated from its own images, in the browser; no hardware is needed."""

import json
import sys
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ninedtact.cli.live import (
    PageSettings,
    page_sources_of_twin,
    require_display_rate,
    require_page_library,
    serve_sensor_page,
)
from ninedtact.cli.options import DesignFileOption, read_design_or_default, require_sensor_or_design
from ninedtact.design import SensorDesign
from ninedtact.errors import InputError

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.simulation.press_figures import PressComparison
    from ninedtact.simulation.press_simulation import ObjectTrajectory
    from ninedtact.simulation.twin import Twin

STEPS_HZ = 6.0
"""Of the presses that are drawn: as coarse as friction allows."""


class InvalidDemoOption(InputError):
    """A demo that shows nothing."""


@dataclass(frozen=True)
class Demo:
    """Watch a simulated sensor in the browser while objects press, drag and twist it, its shape and true wrench beside.

    Without a terminal it ends after one round; what it showed is left in a folder either way.
    """

    sensor: Path | None = None
    """Sensor folder whose twin is shown; without one, a twin of no sensor in particular calibrates itself."""
    design_file: DesignFileOption = None
    """Design file (TOML) of a sensor that is not built yet: its twin calibrates itself and is shown."""
    out: Path = Path("out/demo")
    """Folder for the sensor, images and figures that it leaves."""
    rounds: int | None = None
    """End after so many rounds; without it, at a terminal, with Ctrl-C."""
    display_hz: float = 15.0
    """Readings shown per second at most."""
    host: str = "127.0.0.1"
    """Address to serve the page on."""
    port: int = 0
    """Port to serve the page on; 0 takes any free one."""

    def run(self) -> int:
        """Calibrate, reconstruct one press of each object, then show them live."""
        from ninedtact.simulation.simulated_sources import demo_sources

        self.require_rounds()
        require_sensor_or_design(self.sensor, self.design_file)
        require_display_rate(self.display_hz)
        require_page_library()
        self.out.mkdir(parents=True, exist_ok=True)
        folder = self.folder
        self.leave_summary(self.answers(folder))
        sensor, wrenches = page_sources_of_twin(folder.shape, demo_sources(self.twin, self.resolved_rounds))
        with suppress(KeyboardInterrupt):
            serve_sensor_page(folder, sensor, wrenches, PageSettings(self.out, self.display_hz, self.host, self.port))
        print(f"stopped after {sensor.frames_read} images; look at {self.out}")
        return 0

    def require_rounds(self) -> None:
        """Refuse less than one round."""
        if self.rounds is not None and self.rounds < 1:
            raise InvalidDemoOption(f"expected --rounds of at least 1, got {self.rounds}; drop it")

    @property
    def resolved_rounds(self) -> int | None:
        """One where nobody can press Ctrl-C."""
        return self.rounds or (None if sys.stdout.isatty() else 1)

    @cached_property
    def twin(self) -> "Twin":
        """What is pressed."""
        if self.sensor is not None:
            from ninedtact.calibration.twin.sensor_twin import build_sensor_twin

            return build_sensor_twin(self.folder)
        from ninedtact.simulation.twin import twin_from_design

        return twin_from_design(self.design)

    @cached_property
    def design(self) -> SensorDesign:
        """Of the twin that calibrates itself."""
        return read_design_or_default(self.design_file)

    @cached_property
    def folder(self) -> "SensorFolder":
        """The calibrated sensor that looks."""
        from ninedtact.calibration.sensor_folder import load_sensor

        return load_sensor(self.sensor) if self.sensor is not None else self.calibrated()

    def calibrated(self) -> "SensorFolder":
        """The twin as it calibrates itself: four images, as of any other sensor."""
        from ninedtact.calibration.procedure import CalibrationImages, calibrate
        from ninedtact.calibration.save import save_sensor
        from ninedtact.simulation.calibration_images import simulate_calibration_images

        print("pressing the pin board and the ball on the twin, calibrating it from the four images …", flush=True)
        images = CalibrationImages(**vars(simulate_calibration_images(self.twin, self.design)))
        folder = save_sensor(self.out / "sensor", calibrate(images, self.design, sensor_id="twin"))
        print(f"  calibrated: {folder.path / 'certificate.html'}", flush=True)
        return folder

    def answers(self, folder: "SensorFolder") -> "list[PressComparison]":
        """Each object pressed once, looked at and reconstructed."""
        from tqdm import tqdm

        from ninedtact.quantities import Frame
        from ninedtact.simulation.simulated_sources import demo_trajectories

        reader = folder.shape.depth_reader(*(Frame(self.twin.renderer(None, number)) for number in range(-10, 0)))
        progress = tqdm(
            demo_trajectories(), desc="pressing and reconstructing", unit="object", disable=None, leave=False
        )
        return [self.answer(act, folder, reader) for act in progress]

    def answer(self, act: "ObjectTrajectory", folder: "SensorFolder", reader: Any) -> "PressComparison":
        """One of them, at the end of its drag and twist."""
        from ninedtact.quantities import Frame
        from ninedtact.simulation.ground_truth import true_height_map_like
        from ninedtact.simulation.press_figures import PressComparison
        from ninedtact.simulation.press_simulation import PressSimulation

        stage = PressSimulation(self.twin, [act], STEPS_HZ, real_time=False)
        contact = stage.contact(int(act.trajectory.lift_start_s * STEPS_HZ - 1e-6))
        image = self.twin.renderer(contact, 1)
        seen = reader(folder.shape.rectify(Frame(image)))
        true = true_height_map_like(contact, seen, self.twin.renderer.light.inverse_distance_per_mm)
        return PressComparison(act.indenter.name, image, true, seen, contact.wrench())

    def leave_summary(self, answers: "list[PressComparison]") -> None:
        """What was pressed and what was seen of it: an image and its figures."""
        from ninedtact.atomic_write import write_file_atomically
        from ninedtact.simulation.press_figures import plot_press_comparisons

        write_file_atomically(self.out / "presses.png", plot_press_comparisons(answers))
        presses = [_comparison_to_json_dict(each) for each in answers]
        figures = {"sensor": str(self.folder.path), "twin": self.twin.name, "presses": presses}
        write_file_atomically(self.out / "summary.json", json.dumps(figures, indent=2, ensure_ascii=False).encode())
        for figure in presses:
            print("  {object}: {true_mm:.2f} mm deep, seen {seen_mm:.2f} mm".format(**figure))
        print(f"  drawn in {self.out / 'presses.png'}", flush=True)


def _comparison_to_json_dict(answer: "PressComparison") -> dict[str, Any]:
    """The figures of one press."""
    true, seen = answer.peaks_mm
    wrench = {name: value.tolist() for name, value in asdict(answer.wrench).items() if name != "stamp_ns"}
    return {
        "object": answer.name,
        "true_mm": true,
        "seen_mm": seen,
        "mean_error_mm": answer.mean_error_mm,
        "wrench": wrench,
    }
