"""ninedtact adapt: a few presses with known loads → modulus and base of the gel of one sensor."""

import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
    blunt and note the grams of each image. One press tells the modulus of the gel, four from 50 g to 800 g also narrow down how far
    its base yields.
    """

    sensor: Path
    """Sensor folder that `ninedtact calibrate` wrote. The gel that is found is kept there, in sensor.toml; the factor of a force
    model in force.toml."""
    reference: ReferenceOption = ()
    press: tyro.conf.UseAppendAction[tuple[tuple[Path, float], ...]] = ()
    """An image and its load in grams, such as --press five.png 512. Give it once for every press."""
    ball_grams: float | None = None
    """Load in grams on the ball of the calibration when its image was taken, as one more press."""
    force: str = "physics"
    """Estimator that is calibrated: physics, or a force model (.onnx)."""
    source: str | None = None
    """The camera that the page shows first: a camera, a stream, a recording; or sim, the sensor's twin, whose gel is softer or
    stiffer than the calibration assumes."""
    automatic: AutomaticOption = False
    on_page: Annotated[CalibrationPageOptions, tyro.conf.arg(name="")] = CalibrationPageOptions()
    dry_run: bool = False
    """Print what was found without keeping it."""
    json: JsonOption = False

    def run(self) -> int:
        """Calibrate, and print the error of presses that were left out of the fit."""
        from ninedtact.calibration.force_calibration import calibrate_force

        self._require_one_way()
        if self.on_page.page:
            return self._calibrate_on_page()
        folder = load_sensor_with_notices(self.sensor)
        found = calibrate_force(folder, self.reference, self.press, self.force, self.ball_grams, save=not self.dry_run)
        return print_result(self.json, _to_json_dict(found), _format_force_calibration(found))

    def _require_one_way(self) -> None:
        """Refuse images beside the page, and neither of both; raises `InputError`."""
        given = {
            "--reference": self.reference,
            "--press": self.press,
            "--ball-grams": self.ball_grams,
            "--source": self.source,
            "--dry-run": self.dry_run,
            "--page": self.on_page.page,
        }
        got = ", ".join(name for name, value in given.items() if value) or "none of them"
        weighs_ball = self.ball_grams is not None
        has_images = bool(self.reference) == bool(self.press) and bool(self.press or weighs_ball)
        takes_images = has_images and not (self.on_page.page or self.source)
        takes_page = self.on_page.page and not (self.reference or self.press or weighs_ball or self.dry_run)
        if not (takes_images or takes_page):
            raise InputError(
                expected="--reference and --press with images, --ball-grams, or --page alone or with --source",
                got=f"{got}",
                remedy="give the images, or let the page take them",
            )

    def _calibrate_on_page(self) -> int:
        """Serve the guided calibration in the browser until Ctrl-C, and print its result."""
        folder = load_sensor_with_notices(self.sensor)
        with redirect_stdout(sys.stderr if self.json else sys.stdout):
            file = GuidedPages(self.on_page, self.source, self.automatic).calibrate_force(folder, self.force)
        if file is None:
            print_notice(f"stopped before anything was saved; {self.sensor} is as it was")
            return 1
        return print_result(self.json, {"file": str(file)}, iter((f"saved: {file}",)))


def _to_json_dict(found: "ForceCalibration") -> dict[str, Any]:
    gel = found.sensor.gel
    return {
        "estimator": found.estimator,
        **asdict(found.fit),
        "modulus_std": found.fit.modulus_std,
        "ratio_std": found.fit.ratio_std,
        "shear_modulus_mpa": gel.shear_modulus_mpa,
        "gel_to_base_modulus_ratio": gel.gel_to_base_modulus_ratio,
        "presses": [asdict(press) for press in found.presses],
        "file": None if found.file is None else str(found.file),
    }


def _format_force_calibration(found: "ForceCalibration") -> Iterator[str]:
    fit, known = found.fit, found.sensor.record.known_loads
    for press, after_n, deviation in zip(found.presses, fit.estimated_n, fit.deviations, strict=True):
        warned = f"  ({', '.join(press.warnings)})" if press.warnings else ""
        yield (
            f"{press.name}: {press.weighed_n:6.2f} N load, {press.calibrated_n:6.2f} N estimated, {after_n:6.2f} N calibrated, "
            f"{deviation:+.1f}σ{warned}"
        )
    if not found.finds_gel or known is None:
        yield f"forces times {fit.factor:.3f} ± {fit.factor * fit.modulus_std:.3f}"
    else:
        gel, assumed_mpa = found.sensor.gel, found.sensor.record.design.gel.shear_modulus_mpa
        yield f"shear modulus {gel.shear_modulus_mpa:.4f} MPa ± {known.modulus_std:.0%} (design: {assumed_mpa:.4f})"
        if known.modulus_ratio_std > 0:
            yield (
                f"gel over base {gel.gel_to_base_modulus_ratio:.3f} ± {known.modulus_ratio_std:.3f} "
                f"(by the ball's image {known.calibrated_modulus_ratio:.3f} ± {known.calibrated_modulus_ratio_std:.3f}; 0 is rigid)"
            )
    left_out = "" if fit.left_out is None else f", {fit.left_out:.1%} of each press as the others predict it"
    yield f"error of these loads: {fit.unadapted:.1%} before{left_out}; ± {fit.error:.0%} remain on all forces like these"
    yield "not saved (--dry-run)" if found.file is None else f"saved: {found.file}"
