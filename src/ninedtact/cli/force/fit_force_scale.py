"""ninedtact adapt: a few presses with known loads → the force scale of one sensor."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from ninedtact.cli.result_and_interrupt import load_sensor_with_notices, print_result

if TYPE_CHECKING:
    from ninedtact.workflows.force_calibration import ForceCalibration


@dataclass(frozen=True)
class Adapt:
    """Calibrate the force of a sensor with images of presses whose load is known.

    A kitchen scale is enough: put the sensor on it, take an image without contact, set the scale to zero, then press with something
    blunt and note the grams of each image. Four presses from 50 g to 800 g are enough.
    """

    sensor: Path
    """Sensor folder that `ninedtact calibrate` wrote. The force scale is kept there, in force.toml."""
    reference: tyro.conf.UseAppendAction[tuple[Path, ...]]
    """Reference image (no contact) of the same session. Several are averaged."""
    press: tyro.conf.UseAppendAction[tuple[tuple[Path, float], ...]]
    """An image and its load in grams, such as --press five.png 512. Give it once for every press."""
    force: str = "physics"
    """Estimator that is calibrated: physics, corrected, or a force model (.onnx)."""
    dry_run: bool = False
    """Print the force scale without keeping it."""
    json: bool = False
    """Print the result as one JSON object."""

    def run(self) -> int:
        """Calibrate, and print the error of presses that were left out of the fit."""
        from ninedtact.workflows.force_calibration import calibrate_force

        folder = load_sensor_with_notices(self.sensor)
        found = calibrate_force(folder, self.reference, self.press, self.force, save=not self.dry_run)
        figures = {
            "estimator": found.estimator,
            **asdict(found.fit),
            "presses": [asdict(press) for press in found.presses],
            "file": None if found.file is None else str(found.file),
        }
        return print_result(self.json, figures, _format_force_calibration(found))


def _format_force_calibration(found: "ForceCalibration") -> Iterator[str]:
    """Yield the lines of a report for a terminal."""
    fit, scale = found.fit, found.fit.adaptation
    for press in found.presses:
        corrected = press.estimated_n * scale.at(press.estimated_n)
        yield f"{press.weighed_n:6.2f} N load, {press.estimated_n:6.2f} N estimated, {corrected:6.2f} N calibrated"
    curve = f", times (load / {scale.about_n:.1f} N)^{scale.curve:+.2f}" if scale.curve else ""
    yield f"forces times {scale.factor:.3f}{curve}"
    yield (
        f"error of a press left out of the fit: {fit.unadapted:.1%} without a scale, {fit.by_factor:.1%} with a factor"
        + ("" if fit.by_curve is None else f", {fit.by_curve:.1%} with a curve")
    )
    yield "not saved (--dry-run)" if found.file is None else f"saved: {found.file}"
