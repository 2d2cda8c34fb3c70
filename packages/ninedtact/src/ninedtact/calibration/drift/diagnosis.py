"""Diagnosis of drift in words: `diagnose_drift` turns a `DriftMeasurement` into a list of `DriftFinding`, each with its evidence,
the height error that it would cause, and advice. The first is the most probable cause of all that differs: a cause that explains
others precedes them. The limits are wide enough that reference images of real sensors, taken before the board and before the
ball, give none.
"""

import numpy as np

from ninedtact.calibration.brightness_change import MAX_UNEVENNESS
from ninedtact.calibration.drift.measurement import DriftMeasurement
from ninedtact.calibration.drift.reference_check import (
    EXPLAINED_BY_GAMMA,
    DriftDiagnosis,
    DriftFinding,
    change_in_words,
    find_gamma_change,
    find_reference_image_fault,
    position_in_words,
)
from ninedtact.quantities import centred_axis_mm
from ninedtact.shape.light_change import LightBands
from ninedtact.shape.skin_identity import MAX_SHIFT_PX, MAX_TURN_DEG

_MAX_BRIGHTNESS_CHANGE = 0.03
"""Largest change of the whole brightness; 0.011 between two sessions of a real sensor."""
_MAX_COLOUR_CHANGE = 0.03
"""Largest change of one colour relative to the others; 0.004 between two sessions."""
_MAX_LIGHT_MOTION = 4.0
"""Motion, in units of its limit, that uneven light may feign."""
_MAX_NAMED_MARKS = 3


_FEIGNED_BY_COMPRESSION: tuple[DriftDiagnosis, ...] = (
    "another sensor's gel",
    "something touches the gel",
    "camera moved",
    "dirt or damage",
)
"""Findings that compression feigns: it hides the structure of the skin, and its blocks show another one."""


_FEIGNED_BY_BANDS: tuple[DriftDiagnosis, ...] = (
    "camera moved",
    "dirt or damage",
    "light uneven",
    "gain changed",
    "light colour changed",
)
"""Findings that what is left of bands may feign."""


def diagnose_drift(drift: DriftMeasurement) -> list[DriftFinding]:
    """Return all findings, the most probable cause first; of a pressed, unknown or mirrored skin nothing else is diagnosed."""
    found = _findings_without_compression(drift)
    if drift.bands is not None and (not found or found[0].diagnosis in _FEIGNED_BY_BANDS):
        found = [_find_bands(drift.bands), *found]
    if not drift.is_compressed or not found or found[0].diagnosis not in _FEIGNED_BY_COMPRESSION:
        return found
    because = f"the images are compressed in blocks, which hide the skin: {found[0].because}"
    remedy = "save PNG images, from a camera in an uncompressed mode or in motion JPEG of a higher quality"
    return [DriftFinding("compressed", because, remedy, None)]


def _findings_without_compression(drift: DriftMeasurement) -> list[DriftFinding]:
    """Return all findings on images that show the skin."""
    grave = find_reference_image_fault(drift)
    dim = _find_dim_light(drift)
    if dim is not None and (
        grave is None or grave.diagnosis in ("another sensor's gel", "out of focus", "gamma changed")
    ):
        return [dim]
    gamma = find_gamma_change(drift)
    if gamma is not None and (grave is None or grave.diagnosis in EXPLAINED_BY_GAMMA):
        return [gamma]
    if grave is not None:
        return [grave]
    skin, change, uneven = drift.moved, drift.change, _find_uneven_light(drift)
    motion = skin.distance_px / MAX_SHIFT_PX + abs(skin.turn_deg) / MAX_TURN_DEG
    if drift.sharpness is None:  # the structure of a skin without detail is that of its light, and moves with it
        motion /= _MAX_LIGHT_MOTION
    rest = (
        (motion, _find_camera_motion(drift)),
        # A gain alone leaves the light as even as it was.
        (np.inf if uneven and motion < _MAX_LIGHT_MOTION else change.unevenness / MAX_UNEVENNESS, uneven),
        (max((abs(mark.change) for mark in change.marks), default=0) / change.mark_level, _find_gel_marks(drift)),
        (max(map(abs, drift.colour)) / _MAX_COLOUR_CHANGE, _find_colour_change(drift)),
        (abs(change.gain - 1) / _MAX_BRIGHTNESS_CHANGE, _find_brightness_change(drift)),
    )
    # Each bends the measures of the others a little: what is furthest beyond its limit is the cause.
    by_weight = sorted(rest, key=lambda weighed: -weighed[0])
    return [finding for _, finding in by_weight if finding is not None]


def _find_bands(bands: LightBands) -> DriftFinding:
    remedy = "dim the LEDs by current, not by pulses, or expose for a multiple of their period"
    return DriftFinding("light uneven", f"the image has {bands.sentence}", remedy, None)


def _find_dim_light(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the image is so much dimmer that neither its skin nor its motion can be told."""
    finding = _find_brightness_change(drift)
    if finding is None or drift.dim is None or drift.change.gain > 1:
        return None
    evidence, _, remedy = drift.dim.removeprefix("dim: ").partition("; ")
    return DriftFinding("dim", f"{evidence}, and {finding.because}", remedy, finding.height_mm)


def _find_camera_motion(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the camera has moved."""
    skin = drift.moved
    if not skin.is_displaced:
        return None
    return DriftFinding(
        "camera moved",
        f"the skin appears {skin.distance_px:.1f} ± {skin.shift_error_px:.1f} px "
        f"({skin.distance_px * drift.known.mm_per_raw_px:.2f} mm) away and turned by {skin.turn_deg:.1f}° since the board was "
        "pressed: positions are off by that",
        "fix camera and gel in their housing and calibrate again",
        drift.known.worst_height_mm(skin.undone(drift.known.depth_image)),
    )


def _find_uneven_light(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the distribution of the light has changed."""
    change = drift.change
    if change.unevenness <= MAX_UNEVENNESS:
        return None
    field = np.where(change.seen, change.field, 0)
    row, col = np.unravel_index(np.abs(field).argmax(), field.shape)
    y, x = (centred_axis_mm(size, change.mm_per_px) for size in field.shape)
    return DriftFinding(
        "light uneven",
        f"the light is {change_in_words(float(field[row, col]))} at ({x[col]:.0f}, {y[row]:.0f}) mm, beside the whole",
        "check that every LED lights and that no other light falls on the sensor, and calibrate again if it stays",
        drift.equivalent_height_mm(change.unevenness),
    )


def _find_gel_marks(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where there are local marks on the gel."""
    marks = drift.change.marks
    if not marks:
        return None
    named = "; ".join(
        f"{change_in_words(mark.change)} over {mark.area_mm2:.1f} mm² at {position_in_words(mark)}"
        for mark in marks[:_MAX_NAMED_MARKS]
    )
    more = f" and {len(marks) - _MAX_NAMED_MARKS} smaller" if len(marks) > _MAX_NAMED_MARKS else ""
    return DriftFinding(
        "dirt or damage",
        f"the skin has changed in {len(marks)} place{'s' if len(marks) > 1 else ''}: {named}{more}",
        "take away what may lie on it and clean it; a tear, bubble or stain that stays needs a new gel, or a new calibration",
        drift.equivalent_height_mm(max((mark.change for mark in marks), key=abs)),
    )


def _find_brightness_change(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the light has become stronger or weaker."""
    change = drift.change.gain - 1
    if abs(change) <= _MAX_BRIGHTNESS_CHANGE:
        return None
    return DriftFinding(
        "gain changed",
        f"the whole image is {change_in_words(change)} than when calibrated",
        "fix exposure and gain, check the LEDs and their supply, and let the light warm up",
        drift.equivalent_height_mm(change),
    )


def _find_colour_change(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the colour has changed: white balance, or an LED of another kind."""
    if max(map(abs, drift.colour)) <= _MAX_COLOUR_CHANGE:
        return None
    parts = ", ".join(f"{name} {part:+.1%}" for name, part in zip(("blue", "green", "red"), drift.colour, strict=True))
    return DriftFinding(
        "light colour changed",
        f"the colour of the light has changed ({parts})",
        "fix the camera's white balance, and check the LEDs",
        None,
    )
