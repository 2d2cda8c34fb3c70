"""ninedtact adapt: a few presses with known loads → the force scale of one sensor."""

import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact.cli.calibration_page import CalibrationPageOptions, GuidedPages
from ninedtact.cli.result_and_interrupt import load_sensor_with_notices, print_notice, print_result
from ninedtact.cli.shared_options import AutomaticOption, JsonOption, ReferenceOption
from ninedtact.errors import InputError

if TYPE_CHECKING:
    from ninedtact.calibration.force_calibration import ForceCalibration


@dataclass(frozen=True)
class Adapt:
    """Calibrate the force of a sensor with presses whose load is known, from images or on a page that guides through them.

    A kitchen scale is enough: put the sensor on it, take an image without contact, set the scale to zero, then press with something
    blunt and note the grams of each image. Four presses from 50 g to 800 g are enough.
    """

    sensor: Path
    """Sensor folder that `ninedtact calibrate` wrote. The force scale is kept there, in force.toml."""
    reference: ReferenceOption = ()
    press: tyro.conf.UseAppendAction[tuple[tuple[Path, float], ...]] = ()
    """An image and its load in grams, such as --press five.png 512. Give it once for every press."""
    force: str = "physics"
    """Estimator that is calibrated: physics, or a force model (.onnx)."""
    source: str | None = None
    """The camera that the page shows first: a camera, a stream, a recording; or sim, the sensor's twin, whose gel is softer or
    stiffer than the calibration assumes."""
    automatic: AutomaticOption = False
    on_page: Annotated[CalibrationPageOptions, tyro.conf.arg(name="")] = CalibrationPageOptions()
    dry_run: bool = False
    """Print the force scale without keeping it."""
    json: JsonOption = False

    def run(self) -> int:
        """Calibrate, and print the error of presses that were left out of the fit."""
        from ninedtact.calibration.force_calibration import calibrate_force

        self._require_one_way()
        if self.on_page.page:
            return self._calibrate_on_page()
        folder = load_sensor_with_notices(self.sensor)
        found = calibrate_force(folder, self.reference, self.press, self.force, save=not self.dry_run)
        figures = {
            "estimator": found.estimator,
            **asdict(found.fit),
            "presses": [asdict(press) for press in found.presses],
            "file": None if found.file is None else str(found.file),
        }
        return print_result(self.json, figures, _format_force_calibration(found))

    def _require_one_way(self) -> None:
        """Refuse images beside the page, and neither of both; raises `InputError`."""
        given = {
            "--reference": self.reference,
            "--press": self.press,
            "--source": self.source,
            "--dry-run": self.dry_run,
            "--page": self.on_page.page,
        }
        got = ", ".join(name for name, value in given.items() if value) or "none of them"
        takes_images = bool(self.reference and self.press) and not (self.on_page.page or self.source)
        takes_page = self.on_page.page and not (self.reference or self.press or self.dry_run)
        if not (takes_images or takes_page):
            raise InputError(
                expected="--reference and --press with images, or --page alone or with --source",
                got=f"{got}",
                remedy="give the images, or let the page take them",
            )

    def _calibrate_on_page(self) -> int:
        """Serve the guided calibration in the browser until Ctrl-C, and print its result."""
        folder = load_sensor_with_notices(self.sensor)
        with redirect_stdout(sys.stderr if self.json else sys.stdout):
            file = GuidedPages(self.on_page, self.source, self.automatic).calibrate_force(folder, self.force)
        if file is None:
            print_notice(f"stopped before a force scale was saved; {self.sensor} is as it was")
            return 1
        return print_result(self.json, {"file": str(file)}, iter((f"saved: {file}",)))


def _format_force_calibration(found: "ForceCalibration") -> Iterator[str]:
    fit, scale = found.fit, found.fit.adaptation
    for press in found.presses:
        corrected = press.estimated_n * scale.at(press.estimated_n)
        warned = f"  ({', '.join(press.warnings)})" if press.warnings else ""
        yield f"{press.weighed_n:6.2f} N load, {press.estimated_n:6.2f} N estimated, {corrected:6.2f} N calibrated{warned}"
    curve = f", times (load / {scale.about_n:.1f} N)^{scale.curve:+.2f}" if scale.curve else ""
    yield f"forces times {scale.factor:.3f}{curve}"
    yield (
        f"error of a press left out of the fit: {fit.unadapted:.1%} without a scale, {fit.by_factor:.1%} with a factor"
        + ("" if fit.by_curve is None else f", {fit.by_curve:.1%} with a curve")
    )
    yield "not saved (--dry-run)" if found.file is None else f"saved: {found.file}"
