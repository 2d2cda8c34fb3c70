"""ninedtact adapt: presses with known loads, or free pressing with a force/torque sensor → gel and force of one sensor."""

import sys
from collections.abc import Iterator
from contextlib import nullcontext, redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

from ninedtact.cli.calibration_page import CalibrationPageOptions, GuidedPages
from ninedtact.cli.result_and_interrupt import load_sensor_with_notices, print_notice, print_result
from ninedtact.cli.shared_options import CameraOption, CameraOptions, JsonOption, ReferenceOption
from ninedtact.errors import InputError
from ninedtact.quantities import DISPLAY_FACTORS, WRENCH_AXES
from ninedtact.recording.errors import require_recording_libraries

if TYPE_CHECKING:
    from ninedtact.calibration.force_calibration import ForceCalibration
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.recording.recorded_pressing import RecordedPressing

_UNEXPLAINED = 2.0
"""Deviation of the samples, in stated errors, from which the alignment is doubtful."""
_TURNED_DEG = 5.0
"""Angle from the design's orientation that is remarked."""


@dataclass(frozen=True)
class AdaptCommand:
    """Calibrate the force of a sensor with presses whose load is known, from images, a recording, or on a page that guides.

    A kitchen scale is enough: put the sensor on it, take an image without contact, set the scale to zero, then press with something
    blunt and note the grams of each image. One press tells the modulus of the gel, four from 50 g to 800 g also narrow down how far
    its base yields. A recording of free pressing on a force/torque sensor tells shear, too, and how the two are aligned.
    """

    sensor: Path
    """Sensor folder that `ninedtact calibrate` wrote. The gel that is found is kept there, in sensor.toml; the factor of a force
    model in force.toml."""
    reference: ReferenceOption = ()
    press: tyro.conf.UseAppendAction[tuple[tuple[Path, float], ...]] = ()
    """An image and its load in grams, such as --press five.png 512. Give it once for every press."""
    ball_grams: float | None = None
    """Load in grams on the ball of the calibration when its image was taken, as one more press."""
    recording: Path | None = None
    """A recording of free pressing by 'ninedtact record --force-torque …': minutes of contacts with different objects, light to
    strong, also dragged, with the skin free for the first second and between them. Among several sensors grasp.mcap#left."""
    force: str = "physics"
    """Estimator that is calibrated: physics, or a force model (.onnx)."""
    source: str | None = None
    """The camera that the page shows first: a camera, a stream, a recording; or sim, the sensor's twin, whose gel is softer or
    stiffer than the calibration assumes."""
    camera: CameraOption = CameraOptions()
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
        with nullcontext() if self.recording is None else open_pressing(self.recording, folder) as pressing:
            found = calibrate_force(
                folder, self.reference, self.press, self.force, self.ball_grams, not self.dry_run, pressing
            )
        return print_result(self.json, _to_json_dict(found), _format_force_calibration(found))

    def _require_one_way(self) -> None:
        """Refuse images beside the page, and neither of both; raises `InputError`."""
        given = {
            "--reference": self.reference,
            "--press": self.press,
            "--ball-grams": self.ball_grams,
            "--recording": self.recording,
            "--source": self.source,
            "--dry-run": self.dry_run,
            "--page": self.on_page.page,
        }
        got = ", ".join(name for name, value in given.items() if value) or "none of them"
        has_others = self.ball_grams is not None or self.recording is not None
        has_images = bool(self.reference) == bool(self.press) and bool(self.press or has_others)
        takes_images = has_images and not (self.on_page.page or self.source)
        takes_page = self.on_page.page and not (self.reference or self.press or has_others or self.dry_run)
        if not (takes_images or takes_page):
            raise InputError(
                expected="--reference and --press with images, --ball-grams, --recording, or --page alone or with --source",
                got=f"{got}",
                remedy="give the images, or let the page take them",
            )

    def _calibrate_on_page(self) -> int:
        """Serve the guided calibration in the browser until Ctrl-C, and print its result."""
        folder = load_sensor_with_notices(self.sensor)
        with redirect_stdout(sys.stderr if self.json else sys.stdout):
            file = GuidedPages(self.on_page, self.source, self.camera.settings()).calibrate_force(folder, self.force)
        if file is None:
            print_notice(f"stopped before anything was saved; {self.sensor} is as it was")
            return 1
        return print_result(self.json, {"file": str(file)}, iter((f"saved: {file}",)))


def open_pressing(path: Path, sensor: "SensorFolder") -> "RecordedPressing":
    """Return free pressing of a recording, opened; raises what `RecordedPressing` raises."""
    require_recording_libraries()
    from ninedtact.recording.recorded_pressing import RecordedPressing

    return RecordedPressing(path, sensor)


def _to_json_dict(found: "ForceCalibration") -> dict[str, Any]:
    gel = found.sensor.gel
    return {
        **_pressing_to_json_dict(found),
        "estimator": found.estimator,
        **asdict(found.fit),
        "modulus_std": found.fit.modulus_std,
        "ratio_std": found.fit.ratio_std,
        "shear_modulus_mpa": gel.shear_modulus_mpa,
        "gel_to_base_modulus_ratio": gel.gel_to_base_modulus_ratio,
        "presses": [asdict(press) for press in found.presses],
        "file": None if found.file is None else str(found.file),
    }


def _pressing_to_json_dict(found: "ForceCalibration") -> dict[str, Any]:
    if found.pressing is None or found.kept_out is None:
        return {}
    alignment, std = found.pressing.alignment, found.pressing.alignment.std
    return {
        "contacts": found.pressing.contacts,
        "notices": found.pressing.notices,
        "kept_out": asdict(found.kept_out),
        "force_torque": {
            "correlation": alignment.correlation,
            "excess": alignment.excess,
            "delay_s": alignment.delay_s,
            "delay_std_s": float(std[0]),
            "origin_mm": alignment.origin_mm.tolist(),
            "origin_std_mm": (1e3 * std[3:6]).tolist(),
            "rotation_deg": alignment.rotation_deg.tolist(),
            "rotation_std_deg": np.degrees(std[6:]).tolist(),
            "sign": alignment.sign,
            "turned_from_design_deg": alignment.turned_from_deg(found.pressing.mount),
            "bias": alignment.bias[0].tolist(),
            "drift": alignment.drift.tolist(),
        },
    }


def _format_pressing(found: "ForceCalibration") -> Iterator[str]:
    """Yield the lines on free pressing, which end with the table of what it gained."""
    pressing, kept_out = found.pressing, found.kept_out
    if pressing is None or kept_out is None:
        return
    alignment, mount, std = pressing.alignment, pressing.mount, pressing.alignment.std
    yield f"{pressing.name}: {pressing.contacts} contacts, correlation of the forces {alignment.correlation:.2f}"
    yield from (f"  {notice}" for notice in pressing.notices)
    if alignment.excess > _UNEXPLAINED:
        yield f"  it explains the samples poorly: contacts deviate by {alignment.excess:.1f} times their stated errors"
    way = "behind" if alignment.delay_s < 0 else "ahead of"
    yield f"  images {abs(alignment.delay_s) * 1e3:.0f} ± {std[0] * 1e3:.0f} ms {way} the force/torque sensor"
    for name, values, errors, unit in (
        ("its origin", alignment.origin_mm, 1e3 * std[3:6], "mm from the skin's centre"),
        ("its rotation about x, y, z", alignment.rotation_deg, np.degrees(std[6:]), "°"),
    ):
        yield (
            f"  {name} "
            + ", ".join(f"{each:.1f} ± {error:.1f}" for each, error in zip(values, errors, strict=True))
            + f" {unit}"
        )
    turned_deg = alignment.turned_from_deg(mount)
    if alignment.sign != mount.sign:
        yield f"  it reports {'the reaction' if alignment.sign < 0 else 'the load'}, unlike the design (force_torque.sign)"
    if turned_deg > max(_TURNED_DEG, 3 * np.degrees(std[6:].max())):
        upside_down = ", upside down" if alignment.is_upside_down(mount) else ""
        yield f"  it is turned by {turned_deg:.0f}° from the design{upside_down}; see force_torque.rotation_deg of the design"
    drift = DISPLAY_FACTORS * alignment.drift
    yield "  its drift " + " ".join(f"{each:+.2f}" for each in drift) + " N, N·mm"
    yield f"  errors of {kept_out.moments} moments of contacts that were left out of the fit, before → after:"
    skills = zip(WRENCH_AXES, kept_out.skill_before, kept_out.skill_after, strict=True)
    yield "    skill " + "  ".join(f"{axis} {before:.2f} → {after:.2f}" for axis, before, after in skills)
    errors = zip(WRENCH_AXES, DISPLAY_FACTORS, kept_out.mae_before, kept_out.mae_after, strict=True)
    yield "    MAE   " + "  ".join(f"{axis} {each * one:.2f} → {each * two:.2f}" for axis, each, one, two in errors)


def _format_force_calibration(found: "ForceCalibration") -> Iterator[str]:
    fit, known = found.fit, found.sensor.record.known_loads
    yield from _format_pressing(found)
    recorded = set() if found.pressing is None else set(found.pressing.readings)
    for press, after_n, deviation in zip(found.presses, fit.estimated_n, fit.deviations, strict=True):
        if press.name in recorded:
            continue
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
    if found.pressing is not None:
        yield f"shear over pressure {fit.shear_factor:.3f} ± {fit.shear_factor * fit.shear_std:.3f} of what the gel says"
    left_out = "" if fit.left_out is None else f", {fit.left_out:.1%} of each press as the others predict it"
    yield f"error of these loads: {fit.unadapted:.1%} before{left_out}; ± {fit.error:.0%} remain on all forces like these"
    yield "not saved (--dry-run)" if found.file is None else f"saved: {found.file}"
