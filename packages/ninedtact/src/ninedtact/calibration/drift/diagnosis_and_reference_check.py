"""Diagnosis of drift in words, and the check whether a session's reference image belongs to the calibrated sensor.

`diagnose_drift` turns a `DriftMeasurement` into a list of `DriftFinding`: each with its figure, the height error that it would
cause, and advice. The limits are wide enough that reference images of real sensors, taken before the board and before the ball,
give none.

`ReferenceImageChecker` checks a reference image once, before anything is measured against it. Heights and forces are changes since
the reference image. A reference image of another sensor, a mirrored one or one that was taken while something touched the gel makes
all of them wrong without a sign of it. Slow changes of light and small motions of the camera do not count here: a new reference
image takes them up, and `ninedtact check` reports them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from ninedtact.calibration.brightness_change import (
    MAX_UNEVENNESS,
    ChangedSkinRegion,
    estimate_pixel_noise,
    find_exposure_fault,
    separate_brightness_change,
)
from ninedtact.calibration.drift.drift_measurement import (
    CalibratedReference,
    DriftMeasurement,
    load_calibrated_reference,
    measure_drift,
)
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.capture.strict_image_reading import average_images, read_image
from ninedtact.errors import InputError
from ninedtact.quantities import Frame, Rectified, centred_axis_mm

DriftDiagnosis = Literal[
    "fine",
    "another sensor's gel",
    "something touches the gel",
    "camera moved",
    "light uneven",
    "gel changed",
    "light dimmer",
    "light brighter",
    "light colour changed",
]

_MIN_PRESSED_SHARE = 0.2
"""Changed fraction of the view above which a skin that is not recognised may be pressed all over, as by the pin board."""
_MIN_FOREIGN_UNEVENNESS = 0.07
"""Change of the light across the view above which such a skin counts as that of another sensor. It is at most 0.066 where boards
and objects press their own sensor, and 0.07 to 0.5 between most sensors."""
_MAX_BRIGHTNESS_CHANGE = 0.03
"""Largest change of the whole brightness; 0.011 between two sessions of a real sensor."""
_MAX_COLOUR_CHANGE = 0.03
"""Largest change of one colour relative to the others; 0.004 between two sessions."""
_MAX_NAMED_MARKS = 3


@dataclass(frozen=True)
class DriftFinding:
    """One change of the sensor since its calibration."""

    diagnosis: DriftDiagnosis
    sentence: str
    height_mm: float | None
    """Height error that it would cause with the calibration's reference image; None where it causes none."""


def diagnose_drift(drift: DriftMeasurement) -> list[DriftFinding]:
    """Return all findings, most serious first; on a pressed, unknown or mirrored skin, light and gel are not diagnosed."""
    for grave in (_find_another_gel(drift), _find_contact(drift), _find_mirrored_image(drift)):
        if grave is not None:
            return [grave]
    rest = (
        _find_camera_motion(drift),
        _find_uneven_light(drift),
        _find_gel_marks(drift),
        _find_brightness_change(drift),
        _find_colour_change(drift),
    )
    return [finding for finding in rest if finding is not None]


def _find_contact(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the gel is pressed."""
    place = drift.change.contact
    if place is None or drift.flipped:
        return None
    depth_mm = _equivalent_height_mm(drift, place.change)
    return DriftFinding(
        "something touches the gel",
        f"the skin is pressed about {depth_mm:.2f} mm deep over {place.area_mm2:.1f} mm² around {_position_in_words(place)}; take "
        "everything off the sensor and take the image again; if it stays, the gel is damaged or has taken the shape",
        depth_mm,
    )


def _find_another_gel(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the image shows another sensor or another gel; no height can be told from it."""
    skin, change = drift.nearest, drift.change
    if drift.flipped or skin.is_same_skin or not (change.marks or change.unevenness > MAX_UNEVENNESS):
        return None
    other_light = change.unevenness > _MIN_FOREIGN_UNEVENNESS
    pressed_all_over = change.contact is not None and change.changed_share > _MIN_PRESSED_SHARE
    if skin.observable and (other_light or not pressed_all_over):
        reason = f"the fine structure of the calibrated skin is not there (correlation {skin.correlation:.2f})"
    elif not skin.observable and other_light and change.contact is not None:
        reason = f"light and skin differ all over (light by up to {change.unevenness:.0%})"
    else:
        return None
    return DriftFinding(
        "another sensor's gel",
        f"{reason}: this shows another sensor, a new gel, or comes from a camera that sits elsewhere; name the right sensor, or "
        "calibrate again; if it is the right one, take away what covers the gel",
        None,
    )


def _find_mirrored_image(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the camera or its driver rotates or mirrors the image."""
    if drift.flipped is None:
        return None
    sentence = f"the image is the calibrated one {drift.flipped}; set the camera's rotation and mirroring as before"
    return DriftFinding("camera moved", sentence, drift.height_mm)


def _find_camera_motion(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the camera has moved."""
    skin = drift.moved
    if not skin.is_displaced:
        return None
    return DriftFinding(
        "camera moved",
        f"the skin appears {skin.distance_px:.1f} ± {skin.shift_error_px:.1f} px "
        f"({skin.distance_px * drift.known.mm_per_raw_px:.2f} mm) away and turned by {skin.turn_deg:.1f}° since the board was "
        "pressed: positions are off by that; fix camera and gel in their housing and calibrate again",
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
        f"the light is {_change_in_words(float(field[row, col]))} at ({x[col]:.0f}, {y[row]:.0f}) mm, beside the whole; check "
        "that every LED lights and that no other light falls on the sensor, and calibrate again if it stays",
        _equivalent_height_mm(drift, change.unevenness),
    )


def _find_gel_marks(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where there are local marks on the gel."""
    marks = drift.change.marks
    if not marks:
        return None
    named = "; ".join(
        f"{_change_in_words(mark.change)} over {mark.area_mm2:.1f} mm² at {_position_in_words(mark)}"
        for mark in marks[:_MAX_NAMED_MARKS]
    )
    more = f" and {len(marks) - _MAX_NAMED_MARKS} smaller" if len(marks) > _MAX_NAMED_MARKS else ""
    return DriftFinding(
        "gel changed",
        f"the skin has changed in {len(marks)} place{'s' if len(marks) > 1 else ''}: {named}{more}; take away what may "
        "lie on it and clean it; a tear, bubble or stain that stays needs a new gel, or a new calibration",
        _equivalent_height_mm(drift, max((mark.change for mark in marks), key=abs)),
    )


def _find_brightness_change(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the light has become stronger or weaker."""
    change = drift.change.gain - 1
    if abs(change) <= _MAX_BRIGHTNESS_CHANGE:
        return None
    return DriftFinding(
        "light dimmer" if change < 0 else "light brighter",
        f"the image is {_change_in_words(change)} than when calibrated; check the LEDs and their supply, fix exposure and "
        "gain, and let the light warm up",
        _equivalent_height_mm(drift, change),
    )


def _find_colour_change(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the colour has changed: white balance, or an LED of another kind."""
    if max(map(abs, drift.colour)) <= _MAX_COLOUR_CHANGE:
        return None
    parts = ", ".join(f"{name} {part:+.1%}" for name, part in zip(("blue", "green", "red"), drift.colour, strict=True))
    return DriftFinding(
        "light colour changed",
        f"the colour of the light has changed ({parts}); fix the camera's white balance, and check the LEDs",
        None,
    )


def _equivalent_height_mm(drift: DriftMeasurement, change: float) -> float:
    """Return the depth that corresponds to a relative change at the image's mean brightness."""
    grey = float(drift.known.rectified_reference.grey.mean())
    return float(drift.known.height_mm(np.array(change), np.array(grey)))


def _change_in_words(change: float) -> str:
    """Return a relative change in words."""
    return f"{abs(change):.1%} {'dimmer' if change < 0 else 'brighter'}"


def _position_in_words(mark: ChangedSkinRegion) -> str:
    """Return the position of a mark in words."""
    return f"({mark.x_mm:.1f}, {mark.y_mm:.1f}) mm"


_DISQUALIFYING: frozenset[DriftDiagnosis] = frozenset(("something touches the gel", "another sensor's gel"))


class ReferenceImplausible(InputError):
    """A reference image does not show the calibrated sensor without contact."""


@dataclass(frozen=True)
class ReferenceImageChecker:
    """Checks whether images can be reference images (no contact) of one calibrated sensor. It reads no file after it was loaded."""

    sensor: str
    """Name of the sensor, for messages."""
    known: CalibratedReference | None
    """Reference images of the calibration; None for an imported sensor, which has none, so that only the exposure is checked."""

    def on_skin_grid(self) -> "ReferenceImageChecker":
        """Return the check of reference images that are rectified already, as those of a data set are."""
        return replace(self, known=self.known and self.known.on_skin_grid())

    def find_faults(self, frames: Sequence[Frame]) -> tuple[str, ...]:
        """Return why the mean of raw images cannot be the reference image of the sensor; empty where it can be.

        Raises `ImageSizeWrong` for images of another size than the calibrated one.
        """
        today = average_images([np.asarray(frame.image) for frame in frames])
        exposure = find_exposure_fault(today)
        if exposure is not None:
            return (f"{exposure.kind}: {exposure.sentence}",)
        if self.known is None:
            return ()
        drift = measure_drift(self.known, today)
        return tuple(
            f"{finding.diagnosis}: {finding.sentence}"
            for finding in diagnose_drift(drift)
            if finding.diagnosis in _DISQUALIFYING or drift.flipped is not None
        )

    def require_faultless(self, frames: Sequence[Frame]) -> None:
        """Raise `ReferenceImplausible` for frames with a fault, and what `find_faults` raises."""
        for fault in self.find_faults(frames):
            raise ReferenceImplausible(
                f"expected a reference image of sensor {self.sensor} without contact, got one with a fault; {fault}"
            )

    def read_images(self, paths: Sequence[Path]) -> list[Frame]:
        """Read the reference images of a session from files; raises `ReferenceImplausible` and what reading an image raises."""
        frames = [Frame(read_image(path)) for path in paths]
        if frames:
            self.require_faultless(frames)
        return frames


def describe_new_contact(before: Rectified, now: Rectified, seen: Bool[Array, "rows cols"]) -> str | None:
    """Return where something touches the gel that did not touch it in an earlier rectified image, or None.

    seen: pixels at which the camera sees the skin. The two images are of one session, so that a lighter contact is found than by
    a comparison with the calibration: 0.1 N of a ball, 0.7 N of a flat punch.
    """
    noise = estimate_pixel_noise(now.grey - before.grey) / float(before.grey.mean())
    contacts = separate_brightness_change(before, now, seen, noise).new_contacts
    if not contacts:
        return None
    most = max(contacts, key=lambda mark: -mark.change)
    return f"the skin is {_change_in_words(most.change)} over {most.area_mm2:.1f} mm² around {_position_in_words(most)}"


def load_reference_image_checker(folder: SensorFolder) -> ReferenceImageChecker:
    """Load the check of a sensor's reference images with everything that it needs; the folder may be deleted afterwards.

    Raises `SensorFolderDamaged`.
    """
    needed = {"ball_reference"} if folder.is_imported else {"board_reference", "ball_reference"}
    has_images = needed <= folder.record.images.keys()
    return ReferenceImageChecker(folder.id, load_calibrated_reference(folder) if has_images else None)
