"""ninedtact check: is today's sensor still the one that was calibrated?"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from ninedtact.cli.result_and_interrupt import load_sensor_with_notices, print_result
from ninedtact.cli.shared_options import JsonOption, SensorOption
from ninedtact.errors import InputError

if TYPE_CHECKING:
    from ninedtact.calibration.drift.measurement import DriftMeasurement
    from ninedtact.calibration.drift.reference_check import DriftFinding


@dataclass(frozen=True)
class CheckCommand:
    """Compare today's reference image (no contact) with the calibrated one: light, camera and gel.

    Exit code 0: fine; 1: something has changed, or an image or the sensor folder cannot be read.
    """

    sensor: SensorOption
    reference: tyro.conf.Positional[tuple[Path, ...]]
    """Reference images (no contact) taken today; each is checked by itself."""
    json: JsonOption = False

    def run(self) -> int:
        """Judge every image; 1 where one is not fine."""
        from ninedtact.calibration.drift.diagnosis import diagnose_drift
        from ninedtact.calibration.drift.measurement import load_calibrated_reference, measure_drift
        from ninedtact.capture.strict_image_reading import read_image

        if not self.reference:
            raise InputError(
                expected="at least one reference image (no contact)", got="none", remedy="name it after the options"
            )
        folder = load_sensor_with_notices(self.sensor)
        known = load_calibrated_reference(folder)
        measured = [measure_drift(known, read_image(path)) for path in self.reference]
        results = [
            _check_result(path, one, diagnose_drift(one)) for path, one in zip(self.reference, measured, strict=True)
        ]
        print_result(self.json, _to_json_dict(self.sensor, results), _format_results(results))
        return int(any(found["findings"] for found in results))


def _check_result(path: Path, drift: "DriftMeasurement", found: "list[DriftFinding]") -> dict[str, Any]:
    return {
        "image": str(path),
        "diagnosis": found[0].diagnosis if found else "fine",
        "most_probable_cause": found[0].cause.sentence if found else None,
        "findings": [{**asdict(finding), "sentence": finding.sentence} for finding in found],
        **_drift_to_dict(drift),
    }


def _drift_to_dict(drift: "DriftMeasurement") -> dict[str, Any]:
    """What was measured, whether it amounts to a finding or not; null where the skin's motion could not be observed."""
    skin, change = drift.moved, drift.change
    seen = skin.is_same_skin
    return {
        "brightness_percent": 100 * (change.gain - 1),
        "uneven_percent": 100 * change.unevenness,
        "colour_percent": dict(zip(("blue", "green", "red"), (100 * part for part in drift.colour), strict=True)),
        "shift_px": list(skin.shift_px) if seen else None,
        "shift_mm": [part * drift.known.mm_per_raw_px for part in skin.shift_px] if seen else None,
        "shift_error_px": skin.shift_error_px if seen else None,
        "turn_deg": skin.turn_deg if seen else None,
        "correlation": drift.nearest.correlation,
        "sharpness": None if drift.sharpness is None else drift.sharpness.fine,
        "gamma": None if drift.gamma is None else drift.gamma.gamma,
        "changed_area_mm2": change.changed_area_mm2,
        "marks": [asdict(mark) for mark in change.marks],
        "old_reference_height_mm": drift.height_mm,
    }


def _to_json_dict(sensor: Path, results: list[dict[str, Any]]) -> dict[str, Any]:
    """The first diagnosis that is not fine, and everything behind it."""
    worst = next((found for found in results if found["findings"]), results[0])
    return {
        "sensor": str(sensor),
        "diagnosis": worst["diagnosis"],
        "most_probable_cause": worst["most_probable_cause"],
        "findings": worst["findings"],
        "images": results,
    }


def _format_results(results: list[dict[str, Any]]) -> Iterator[str]:
    for found in results:
        yield f"{found['image']}: {found['diagnosis']}"
        for number, finding in enumerate(found["findings"]):
            effect = f"height off by up to {finding['height_mm'] or 0:.2f} mm with the calibration's reference image"
            sentence = found["most_probable_cause"] if number == 0 else f"also: {finding['sentence']}"
            yield f"  {sentence}" + (f" ({effect})" if finding["height_mm"] is not None else "")
        yield from _format_measurement(found)


def _format_measurement(found: dict[str, Any]) -> Iterator[str]:
    """The figures that can be compared; of another sensor's gel only the light."""
    light = f"brightness {found['brightness_percent']:+.1f} %, light even to {found['uneven_percent']:.1f} %"
    if found["diagnosis"] == "another sensor's gel":
        yield f"  measured: {light}"
        return
    sharp = "sharpness not observable"
    if found["sharpness"] is not None:
        sharp = f"sharpness {max(found['sharpness'], 0):.0%}"
    skin = "motion of the skin not observable"
    if found["shift_px"] is not None:
        px, mm = hypot(*found["shift_px"]), hypot(*found["shift_mm"])
        skin = (
            f"skin {px:.2f} ± {found['shift_error_px']:.2f} px ({mm:.3f} mm) and {found['turn_deg']:.2f}° from where the board was "
            "pressed"
        )
    yield f"  measured: {light}, {sharp}, {skin}, marks on {found['changed_area_mm2']:.1f} mm²"
    of_today = {"something touches the gel": "", "gamma changed": "; with today's all depths are off by that gamma"}
    today = of_today.get(found["diagnosis"], "; with today's they are not")
    yield (
        f"  heights measured against the calibration's reference image would be off by up to "
        f"{found['old_reference_height_mm']:.2f} mm on 99 % of the view{today}"
    )
