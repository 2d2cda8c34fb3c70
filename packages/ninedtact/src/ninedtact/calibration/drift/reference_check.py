"""The check whether a session's reference image shows the calibrated sensor without contact, by the measurement of all that has
changed since the reference images of the calibration.

    image → what has changed (`measurement`) → findings

`ReferenceImageChecker` checks a reference image once, before anything is measured against it. Heights and forces are changes since
the reference image. A reference image of another sensor, a mirrored one or one that was taken while something touched the gel makes
all of them wrong without a sign of it (`find_reference_image_fault`). Slow changes of light and small motions of the camera do not
count here: a new reference image takes them up, and `ninedtact check` reports them (`diagnosis`).
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
from ninedtact.calibration.drift.measurement import (
    CalibratedReference,
    DriftMeasurement,
    load_calibrated_reference,
    measure_drift,
)
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.calibration.sensor_toml_schema import ProbableCause
from ninedtact.capture.strict_image_reading import average_images, read_image
from ninedtact.errors import InputError
from ninedtact.quantities import Frame, Rectified
from ninedtact.reading import Reading
from ninedtact.shape.image_plausibility import MAX_BORDER_SPREAD, ImageImplausible, require_plausible_image
from ninedtact.shape.sharpness import lacks_detail_of

DriftDiagnosis = Literal[
    "another sensor's gel",
    "something touches the gel",
    "out of focus",
    "image mirrored",
    "camera moved",
    "compressed",
    "dim",
    "gamma changed",
    "light uneven",
    "light colour changed",
    "dirt or damage",
    "gain changed",
]


_MIN_PRESSED_SHARE = 0.2
"""Changed fraction of the view above which a skin that is not recognised may be pressed all over, as by the pin board."""
_MIN_FOREIGN_UNEVENNESS = 0.07
"""Change of the light across the view above which such a skin counts as that of another sensor. It is at most 0.066 where boards
and objects press their own sensor, and 0.07 to 0.5 between most sensors."""

_MAX_GAMMA_CHANGE, _LEFT_BY_GAMMA = 0.05, 0.006
"""Change of gamma, and what it may leave of the light: whole grey levels leave 0.001, and a failing LED 0.02."""
_MIN_GAMMA_EFFECT = 0.0025
"""Effect of gamma over the view below which it may be the rounding of a gain to whole levels."""
_MAX_REFERENCE_GAMMA_CHANGE = 0.1
"""Change of gamma above which an image cannot be a reference image: all darkening, and so all depth, changes by about as much."""
EXPLAINED_BY_GAMMA: tuple[DriftDiagnosis, ...] = ("something touches the gel", "out of focus", "gamma changed")
"""Findings that a changed gamma feigns."""


@dataclass(frozen=True)
class DriftFinding:
    """One change of the sensor since its calibration."""

    diagnosis: DriftDiagnosis
    because: str
    remedy: str
    height_mm: float | None
    """Height error that it would cause with the calibration's reference image; None where it causes none."""

    @property
    def sentence(self) -> str:
        """Evidence and remedy."""
        return f"{self.because}; {self.remedy}"

    @property
    def cause(self) -> ProbableCause:
        """The finding as the most probable cause."""
        return ProbableCause(self.diagnosis, self.because, self.remedy)


def find_reference_image_fault(drift: DriftMeasurement) -> DriftFinding | None:
    """Return why an image cannot be a reference image of the calibrated sensor: blur, another gel, a contact, a flip, or gamma."""
    findings = _find_blur(drift), _find_another_gel(drift), _find_contact(drift), _find_mirrored_image(drift)
    found = next((finding for finding in findings if finding is not None), None)
    gamma = find_gamma_change(drift, _MAX_REFERENCE_GAMMA_CHANGE)
    return gamma if gamma is not None and (found is None or found.diagnosis in EXPLAINED_BY_GAMMA) else found


def _find_blur(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the fine detail of the known skin is missing and all else is there."""
    sharpness, change = drift.sharpness, drift.change
    if drift.flipped or not (drift.is_smoothed if sharpness is None else sharpness.is_lost):
        return None
    is_same_light = not change.marks and change.unevenness <= MAX_UNEVENNESS
    is_same_skin = sharpness is not None and drift.nearest.is_same_skin and sharpness.is_out_of_focus
    if not is_same_skin and not is_same_light:
        return None
    evidence = "the image lacks the noise of the camera, as a blurred or smoothed one does"
    if sharpness is not None:
        fine, coarse = (max(part, 0) for part in (sharpness.fine, sharpness.coarse))
        evidence = (
            f"only {fine:.0%} of the fine detail of the calibrated skin is left (its coarse detail: {coarse:.0%})"
        )
    return DriftFinding(
        "out of focus",
        evidence,
        "focus the camera as it was, switch its autofocus off and clean lens and window",
        drift.height_mm,
    )


def find_gamma_change(drift: DriftMeasurement, least: float = _MAX_GAMMA_CHANGE) -> DriftFinding | None:
    """Return a finding where one gamma explains the change of the brightness over the view."""
    fit = drift.gamma
    if fit is None or drift.flipped or not fit.is_certain or abs(fit.gamma - 1) < least:
        return None
    if fit.spread > _LEFT_BY_GAMMA or fit.effect < _MIN_GAMMA_EFFECT:
        return None
    return DriftFinding(
        "gamma changed",
        f"a gamma of {fit.gamma:.2f} ± {fit.error:.2f} explains the change of the light to {fit.spread:.1%}",
        "set gamma, contrast and brightness of the camera as they were",
        drift.height_mm,
    )


def _find_contact(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the gel is pressed."""
    place = drift.change.contact
    if place is None or drift.flipped:
        return None
    depth_mm = drift.equivalent_height_mm(place.change)
    return DriftFinding(
        "something touches the gel",
        f"the skin is pressed about {depth_mm:.2f} mm deep over {place.area_mm2:.1f} mm² around {position_in_words(place)}",
        "take everything off the sensor and take the image again; if it stays, the gel is damaged or has taken the shape",
        depth_mm,
    )


def _find_another_gel(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the image shows another sensor or another gel; no height can be told from it."""
    skin, change = drift.nearest, drift.change
    if drift.flipped or skin.is_same_skin or not (change.marks or change.unevenness > MAX_UNEVENNESS):
        return None
    other_light = change.unevenness > _MIN_FOREIGN_UNEVENNESS or drift.border_light_unevenness > MAX_BORDER_SPREAD
    pressed_all_over = change.contact is not None and change.changed_share > _MIN_PRESSED_SHARE
    if skin.observable and (other_light or not pressed_all_over):
        reason = f"the fine structure of the calibrated skin is not there (correlation {skin.correlation:.2f})"
    elif not skin.observable and other_light and change.contact is not None:
        reason = f"light and skin differ all over (light by up to {change.unevenness:.0%})"
    else:
        return None
    return DriftFinding(
        "another sensor's gel",
        f"{reason}: this shows another sensor, a new gel, or comes from a camera that sits elsewhere",
        "name the right sensor, or calibrate again; if it is the right one, take away what covers the gel",
        None,
    )


def _find_mirrored_image(drift: DriftMeasurement) -> DriftFinding | None:
    """Return a finding where the camera or its driver rotates or mirrors the image."""
    if drift.flipped is None:
        return None
    evidence = f"the image is the calibrated one {drift.flipped}"
    return DriftFinding(
        "image mirrored", evidence, "set the camera's rotation and mirroring as before", drift.height_mm
    )


def change_in_words(change: float) -> str:
    """Return a relative change in words."""
    return f"{abs(change):.1%} {'dimmer' if change < 0 else 'brighter'}"


def position_in_words(mark: ChangedSkinRegion) -> str:
    """Return the position of a mark in words."""
    return f"({mark.x_mm:.1f}, {mark.y_mm:.1f}) mm"


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

        Raises `FileFormatError` for images of another size than the calibrated one.
        """
        today = average_images([np.asarray(frame.image) for frame in frames])
        exposure = find_exposure_fault(today)
        if exposure is not None:
            return (f"{exposure.kind}: {exposure.sentence}",)
        if self.known is None:
            return ()
        fault = find_reference_image_fault(measure_drift(self.known, today))
        return () if fault is None else (f"{fault.diagnosis}: {fault.sentence}",)

    def require_faultless(self, frames: Sequence[Frame]) -> None:
        """Raise `InputError` for frames with a fault, and what `find_faults` raises."""
        for fault in self.find_faults(frames):
            raise reference_image_error("the reference images", self.sensor, fault)

    def require_press(self, name: str, reading: Reading, references: Sequence[Frame]) -> None:
        """Raise `ImageImplausible` for a single image that cannot be a press on this sensor, or is less sharp than its references.

        name: of the image, for the message. references: the raw images without contact that it was read against, if any.
        """
        require_plausible_image(name, reading.rectified, reading.reference, reading.height, reading.light)
        if self.known is None or not references:
            return
        known = self.known.lens_image, self.known.depth_image
        before = average_images([np.asarray(frame.image) for frame in references])
        if lacks_detail_of(known, before, np.asarray(reading.frame.image)):
            raise ImageImplausible(
                f"{name}: expected an image as sharp as its reference image, got one that is out of focus or moved during its "
                "exposure; switch the camera's autofocus off, hold the sensor still, and take it again"
            )

    def read_images(self, paths: Sequence[Path]) -> list[Frame]:
        """Read the reference images of a session from files; raises `InputError` and what reading an image raises."""
        frames = [Frame(read_image(path)) for path in paths]
        if frames:
            self.require_faultless(frames)
        return frames


def reference_image_error(images: str, sensor: str, fault: str) -> InputError:
    """Return the error of images that cannot be the reference images of a sensor.

    images: how they are named to a person. sensor: its name. fault: as `ReferenceImageChecker.find_faults` says it.
    """
    return InputError(expected=f"{images} to show sensor {sensor} without contact", got="a fault", remedy=fault)


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
    return f"the skin is {change_in_words(most.change)} over {most.area_mm2:.1f} mm² around {position_in_words(most)}"


def load_reference_image_checker(folder: SensorFolder) -> ReferenceImageChecker:
    """Load the check of a sensor's reference images with everything that it needs; the folder may be deleted afterwards.

    Raises `SensorFolderDamaged`.
    """
    needed = {"ball_reference"} if folder.is_imported else {"board_reference", "ball_reference"}
    has_images = needed <= folder.record.images.keys()
    return ReferenceImageChecker(folder.id, load_calibrated_reference(folder) if has_images else None)
