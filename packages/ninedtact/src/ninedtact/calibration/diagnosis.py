"""The most probable cause of what is wrong with the images of a calibration, or with the calibration itself.

`find_image_cause` compares the images with each other, by the measurements that `ninedtact check` makes of a reference image of
today (`drift`), and needs no fit: it also explains why a board or a ball was refused. `find_probable_cause` adds the checks of the
certificate. A cause that explains others precedes them: blur moves and widens imprints, changed light feigns depth, and either
makes right lengths suspicious.
"""

import cv2
import numpy as np

from ninedtact.calibration.brightness_change import dim_warning, find_exposure_fault
from ninedtact.calibration.certificate.checks import WRONG_RADIUS, compute_certificate_checks
from ninedtact.calibration.drift.diagnosis import diagnose_drift
from ninedtact.calibration.drift.measurement import FLIPS, CalibratedReference, measure_drift
from ninedtact.calibration.drift.reference_check import change_in_words
from ninedtact.calibration.sensor_toml_schema import Certificate, ProbableCause
from ninedtact.design import PUBLISHED_MM_PER_PX, RectifiedImageSize
from ninedtact.quantities import BgrImage, Frame
from ninedtact.shape.image_plausibility import MAX_BORDER_SPREAD, border_light_unevenness
from ninedtact.shape.lens_and_rectification import Rectification, to_grey_float
from ninedtact.shape.light_change import LightCorrection
from ninedtact.shape.sharpness import is_pair_smoothed, is_smoother, measure_sharpness
from ninedtact.shape.skin_identity import (
    HIGH_SIMILARITY,
    fine_structure,
    log_brightness,
    shows_another_skin,
    structure_similarity,
)

ImagePair = tuple[BgrImage, BgrImage]
"""The skin without contact and the pressed skin."""

_MAX_GAIN_CHANGE = {"ball": 0.02, "board": 0.06}
"""Change of the brightness under a press, where nothing moves: real and simulated balls have up to 0.008, boards, under which
hardly any skin is flat, up to 0.042."""
_MIN_GAMMA_CHANGE = 0.1
"""Change of gamma under a press below which it may be the rounding of a gain to whole levels."""
_MARGIN = 0.12
"""Part of the image on every side that is not compared."""
_FOCUS = "focus the camera on the skin, switch its autofocus off, clean lens and window, and take all images again"
_LIGHT = "fix exposure, gain and white balance, let the light warm up, and take all images again"


def find_image_cause(board: ImagePair | None, ball: ImagePair | None) -> ProbableCause | None:
    """Return what is wrong with the images of a calibration as images; None where nothing is.

    board, ball: raw images (rows, cols, 3) of the skin before each press and under it.
    """
    pairs = {name: pair for name, pair in (("board", board), ("ball", ball)) if pair is not None}
    if len({image.shape for pair in pairs.values() for image in pair}) != 1:
        return None
    return (
        _find_bad_exposure(pairs)
        or (None if board is None or ball is None else _compare_references(board[0], ball[0]))
        or next(filter(None, (_judge_press(name, pair, pairs) for name, pair in pairs.items())), None)
    )


def find_probable_cause(
    certificate: Certificate, of_images: ProbableCause | None, out_of_view_warning: str | None, is_impossible: bool
) -> ProbableCause | None:
    """Return the most probable cause of what is wrong with a calibration; None where all checks pass.

    of_images: what `find_image_cause` returned. out_of_view_warning: that much of the height map is out of view, in words, or None.
    is_impossible: whether the ball would have been pressed through the gel.
    """
    if of_images is not None:
        return of_images
    if out_of_view_warning is not None:
        because, _, remedy = out_of_view_warning.partition("; ")
        return ProbableCause("board turned", because, remedy)
    checks = [check for check in compute_certificate_checks(certificate) if check.level != "pass"]
    if is_impossible and not checks:
        return ProbableCause(
            WRONG_RADIUS,
            "the ball would have been pressed through the gel",
            "measure ball and gel, and calibrate again",
        )
    # A failed check says more than one that warns; those of lengths are last, because every other fault bends lengths too.
    worst = next((check for level in ("fail", "warn") for check in checks if check.level == level), None)
    if worst is None:
        return None
    evidence = worst.text.partition(" To do:")[0].rstrip(".")
    return ProbableCause(worst.cause, evidence, f"{worst.remedy}, and calibrate again")


def _find_bad_exposure(pairs: dict[str, ImagePair]) -> ProbableCause | None:
    """Return that an image is dark or overexposed, or that all reference images are dim."""
    for name, pair in pairs.items():
        for what, image in zip((f"image before the {name}", f"image of the {name}"), pair, strict=True):
            fault = find_exposure_fault(image)
            if fault is not None:
                evidence, _, remedy = fault.sentence.partition("; ")
                return ProbableCause(fault.kind, f"the {what} has {evidence}", remedy)
    dim = [dim_warning(pair[0]) for pair in pairs.values()]
    if dim[0] is None or None in dim:
        return None
    evidence, _, remedy = dim[0].removeprefix("dim: ").partition("; ")
    return ProbableCause("dim", evidence, remedy)


def _compare_references(before_board: BgrImage, before_ball: BgrImage) -> ProbableCause | None:
    """Return why the images before the two presses do not show one skin in one light."""
    if is_pair_smoothed(before_board, before_ball):
        return ProbableCause(
            "out of focus",
            "the images without contact show neither fine detail of the skin nor the noise of a camera",
            _FOCUS,
        )
    known = CalibratedReference(before_board, before_board, _middle_of_image(before_board), None)
    found = diagnose_drift(measure_drift(known, before_ball))
    if not found:
        return None
    cause = found[0].cause
    because = f"in the image before the ball, compared with that before the board, {cause.because}"
    return ProbableCause(cause.cause, because.replace(" than when calibrated", ""), cause.remedy)


def _judge_press(name: str, pair: ImagePair, pairs: dict[str, ImagePair]) -> ProbableCause | None:
    """Return why a press cannot be compared with the image before it."""
    before, under = pair
    sharpness = measure_sharpness((pairs["board"][0], pairs["ball"][0]), under) if len(pairs) == 2 else None
    blurred = ProbableCause("out of focus", f"the image of the {name} lacks detail that the one before it has", _FOCUS)
    if is_smoother(under, before) or (sharpness is not None and sharpness.is_out_of_focus):
        return blurred
    grey, reference = to_grey_float(under), to_grey_float(before)
    if shows_another_skin(grey, reference):
        of_skin = fine_structure(log_brightness(reference))
        for way, code in FLIPS.items():
            if structure_similarity(of_skin, fine_structure(log_brightness(cv2.flip(grey, code)))) > HIGH_SIMILARITY:
                because = f"the image of the {name} shows the skin before it {way}"
                return ProbableCause("image mirrored", because, "keep the camera's rotation and mirroring as they are")
        return ProbableCause(
            "another sensor's gel",
            f"the image of the {name} does not show the skin of the image before it",
            "take all images of one sensor",
        )
    return blurred if sharpness is not None and sharpness.is_lost else _find_changed_light(name, pair)


def _find_changed_light(name: str, pair: ImagePair) -> ProbableCause | None:
    """Return what changed in the light between the two images of a press, or the dirt that came."""
    rectify = _middle_of_image(pair[0])
    before, under = (rectify(Frame(image)) for image in pair)
    corrected, light = LightCorrection(rectify)(under, before)
    where = f"between the image before the {name} and that of the {name}"
    if light.dirt_spots:
        return ProbableCause(
            "dirt or damage",
            f"{where}, {light.dirt_spots} sharp spot{'s' * (light.dirt_spots > 1)} appeared that gel cannot make",
            "clean skin, lens and window, and take all images again",
        )
    if abs(light.gamma - 1) >= _MIN_GAMMA_CHANGE:
        return ProbableCause("gamma changed", f"{where}, gamma changed to {light.gamma:.2f}", _LIGHT)
    if name == "ball" and light.bands is not None:  # rows of pins look like bands
        return ProbableCause("light uneven", f"{where}, bands of ±{light.bands.amplitude:.1%} appeared", _LIGHT)
    if name == "ball" and border_light_unevenness(corrected, before) > MAX_BORDER_SPREAD:
        return ProbableCause(
            "light uneven", f"{where}, the light along the border of the view changed unevenly", _LIGHT
        )
    if abs(light.level - 1) > _MAX_GAIN_CHANGE[name]:
        return ProbableCause("gain changed", f"{where}, the skin became {change_in_words(light.level - 1)}", _LIGHT)
    return None


def _middle_of_image(image: BgrImage) -> Rectification:
    """Return a rectification that takes the middle of a raw image as it is, with the published scale: the border shows housing."""
    rows, cols = image.shape[:2]
    own_px = np.moveaxis(np.indices((rows, cols), np.float32)[::-1], 0, -1)
    margins = [round(_MARGIN * size) for size in (rows, cols)]
    middle_px = np.ascontiguousarray(own_px[margins[0] : rows - margins[0], margins[1] : cols - margins[1]])
    mm_per_px = PUBLISHED_MM_PER_PX * RectifiedImageSize().raw_long_side_px / max(rows, cols)
    height_mm, width_mm = (size * mm_per_px for size in middle_px.shape[:2])
    area_mm = (-width_mm / 2, width_mm / 2, -height_mm / 2, height_mm / 2)
    return Rectification(middle_px, mm_per_px, (rows, cols), area_mm)
