"""The plan of a second press for a person, and for a script (`ninedtact calibrate --plan`)."""

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from ninedtact.cli.result_and_interrupt import print_result

if TYPE_CHECKING:
    from ninedtact.calibration.second_press_plan import CandidatePress, PlannedErrors, PressPlan
    from ninedtact.design import SensorDesign

_COLUMNS = f"{'':52}{'pressed':>8}{'ball depth':>12}{'base':>9}{'thickness':>12}{'load':>8}"


def print_press_plan(out: Path, design: "SensorDesign", json: bool) -> int:
    """Print what a second press would tell of the sensor at `out`, or of a design where none is there; return the exit code."""
    from ninedtact.calibration.second_press_plan import known_press_of_design, known_press_of_sensor, plan_second_press
    from ninedtact.calibration.sensor_folder import SENSOR_FILE, load_sensor

    is_calibrated = (out / SENSOR_FILE).is_file()
    known = known_press_of_sensor(load_sensor(out)) if is_calibrated else known_press_of_design(design)
    plan, subject = plan_second_press(known), str(out) if is_calibrated else "the design"
    print_result(json, press_plan_json_dict(subject, plan), format_press_plan(subject, plan))
    return 0


def format_press_plan(subject: str, plan: "PressPlan") -> Iterator[str]:
    """Yield the plan as a table: the standard deviations that are left, the best candidate first."""
    press, ratio = plan.known.press, plan.known.press.gel_to_base_modulus_ratio
    is_rigid = plan.known.design.gel.has_rigid_base
    base = "on a rigid base by design" if is_rigid else f"its modulus {ratio:.3f} of that of the base"
    yield f"what a second press would tell of {subject} (± that is left; one standard deviation)"
    yield (
        f"expected: ball of radius {plan.known.design.ball.radius_mm:g} mm, {press.depth_mm:.2f} mm deep; gel of "
        f"{press.thickness_mm:.2f} mm; {base}"
    )
    yield _COLUMNS
    yield _row("the ball alone", press.depth_mm, plan.alone)
    yield from (_row(candidate.name, candidate.depth_mm, errors) for candidate, errors in plan.candidates)
    calibrating = "; ".join(f"{one.name}, {one.depth_mm:.1f} mm deep ({_options(one)})" for one in plan.calibrating)
    yield f"best among those that calibrate: {calibrating}; a load: ninedtact adapt"


def _options(candidate: "CandidatePress") -> str:
    """Return the options of `ninedtact calibrate` for a press."""
    assert candidate.second is not None
    option, radius_mm = "--" + candidate.second.kind.replace("_", "-"), candidate.second.radius_mm
    depth = "" if candidate.second.known_depth is None else f" {option}-depth-mm {candidate.depth_mm:.2g}"
    return f"{option} IMAGE {option}-radius-mm {radius_mm:g}{depth}"


def _row(name: str, depth_mm: float, errors: "PlannedErrors") -> str:
    return (
        f"{name:52}{depth_mm:5.2f} mm{errors.depth_mm:9.3f} mm{errors.modulus_ratio:9.3f}{errors.thickness_mm:9.3f} mm"
        f"{errors.relative_load:8.1%}"
    )


def press_plan_json_dict(subject: str, plan: "PressPlan") -> dict[str, object]:
    """Return the plan for scripts."""
    return {
        "subject": subject,
        "alone": asdict(plan.alone),
        "best": plan.calibrating[0].name,
        "candidates": [
            {
                "name": candidate.name,
                "depth_mm": candidate.depth_mm,
                **{f"{name}_std": value for name, value in asdict(errors).items()},
            }
            for candidate, errors in plan.candidates
        ],
    }
