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
from ninedtact.shape.sharpness import (
    find_detail_shift,
    is_pair_smoothed,
    is_smoother,
    measure_sharpness,
    shift_image,
)
from ninedtact.shape.skin_identity import (
    HIGH_SIMILARITY,
    fine_structure,
    log_brightness,
    measure_skin_motion,
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
_FEIGNED_BY_BLUR = "dirt or damage", "out of focus"
"""Findings that blur of one image, or another scale, feigns."""
_MAX_LOG_GAIN = 0.25
"""Logarithm of a change of the brightness that no press makes, and under which no skin is compared."""
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
        or (None if board is None or ball is None else _compare_references(board, ball))
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
    """Return that an image is dark or overexposed, that all are dim, or that a press has another exposure."""
    for name, pair in pairs.items():
        for what, image in zip((f"image before the {name}", f"image of the {name}"), pair, strict=True):
            fault = find_exposure_fault(image)
            if fault is not None:
                evidence, _, remedy = fault.sentence.partition("; ")
                return ProbableCause(fault.kind, f"the {what} has {evidence}", remedy)
    dim = [dim_warning(image) for pair in pairs.values() for image in pair]
    if dim[0] is not None and None not in dim:
        evidence, _, remedy = dim[0].removeprefix("dim: ").partition("; ")
        return ProbableCause("dim", evidence, remedy)
    for name, (before, under) in pairs.items():
        level = float(np.median(to_grey_float(under) / np.maximum(to_grey_float(before), 1)))
        if abs(np.log(level)) > _MAX_LOG_GAIN:
            return _gain_changed(name, level)
    return None


def _compare_references(board: ImagePair, ball: ImagePair) -> ProbableCause | None:
    """Return why the images before the two presses do not show one skin in one light."""
    before_board, before_ball = board[0], ball[0]
    if is_pair_smoothed(before_board, before_ball):
        return _out_of_focus(
            "the images without contact show neither fine detail of the skin nor the noise of a camera"
        )
    known = CalibratedReference(before_board, before_board, _middle_of_image(before_board), None)
    found = diagnose_drift(measure_drift(known, before_ball))
    blurred = None if found and found[0].diagnosis not in _FEIGNED_BY_BLUR else _find_blurred_reference(board, ball)
    if blurred is not None or not found:
        return blurred
    cause = found[0].cause
    because = f"in the image before the ball, compared with that before the board, {cause.because}"
    return ProbableCause(cause.cause, because.replace(" than when calibrated", ""), cause.remedy)


def _find_blurred_reference(board: ImagePair, ball: ImagePair) -> ProbableCause | None:
    """Return that an image without contact lacks detail that the two images of the other press show: blurred, or, where it is so
    of both, at another place or scale.
    """
    seen = {"board": measure_sharpness(ball, board[0]), "ball": measure_sharpness(board, ball[0])}
    lost = [name for name, sharpness in seen.items() if sharpness is not None and sharpness.is_lost]
    if len(lost) == len(seen):
        mirrored = _find_flip(ball[0], board[0], board, "the image before the ball")
        if mirrored is not None:
            return mirrored
        because = "the images of the ball show the skin at another place or scale than those of the board"
        return ProbableCause(
            "camera moved", because, "keep camera, zoom and mode as they are, and take all images again"
        )
    return _out_of_focus(f"the image before the {lost[0]} lacks detail that the other images have") if lost else None


def _judge_press(name: str, pair: ImagePair, pairs: dict[str, ImagePair]) -> ProbableCause | None:
    """Return why a press cannot be compared with the image before it."""
    before, under = pair
    if is_smoother(under, before):
        return _out_of_focus(f"the image of the {name} lacks detail that the one before it has")
    known = pairs.get("board", pair)[0], pairs.get("ball", pair)[0]
    sharpness = measure_sharpness(known, under)
    is_lost = sharpness is not None and sharpness.is_lost
    grey, reference = to_grey_float(under), to_grey_float(before)
    if not is_lost and not shows_another_skin(grey, reference):
        return _find_changed_light(name, pair)
    mirrored = _find_flip(under, before, known, f"the image of the {name}")
    if mirrored is not None:
        return mirrored
    motion, shift_px = measure_skin_motion(before, under), find_detail_shift(before, under)
    for distance_px, there in (
        (motion.distance_px, motion.undone(under)),
        (np.hypot(*shift_px), shift_image(under, shift_px)),
    ):
        if is_lost and _shows_skin(there, before, known):
            because = f"the image of the {name} shows the skin before it {distance_px:.0f} px away"
            return ProbableCause(
                "camera moved", because, "fix camera and gel in their housing, and take all images again"
            )
    if shows_another_skin(grey, reference):
        return ProbableCause(
            "another sensor's gel",
            f"the image of the {name} does not show the skin of the image before it",
            "take all images of one sensor",
        )
    return _out_of_focus(f"the image of the {name} lacks detail that the one before it has")


def _find_flip(image: BgrImage, before: BgrImage, known: ImagePair, name: str) -> ProbableCause | None:
    """Return that an image shows the skin of another one flipped."""
    way = next((way for way, code in FLIPS.items() if _shows_skin(cv2.flip(image, code), before, known)), None)
    if way is None:
        return None
    because = f"{name} shows the skin of the other images {way}"
    return ProbableCause("image mirrored", because, "keep the camera's rotation and mirroring as they are")


def _shows_skin(image: BgrImage, before: BgrImage, known: ImagePair) -> bool:
    """Return whether an image shows the skin of another at the same place: its fine detail, or its structure where it has none."""
    sharpness = measure_sharpness(known, image)
    if sharpness is not None:
        return sharpness.is_sharp
    of_skin, of_image = (fine_structure(log_brightness(to_grey_float(one))) for one in (before, image))
    return structure_similarity(of_skin, of_image) > HIGH_SIMILARITY


def _out_of_focus(because: str) -> ProbableCause:
    return ProbableCause(
        "out of focus",
        because,
        "focus the camera on the skin, switch its autofocus off, clean lens and window, and take all images again",
    )


def _gain_changed(name: str, level: float) -> ProbableCause:
    because = (
        f"between the image before the {name} and that of the {name}, the skin became {change_in_words(level - 1)}"
    )
    return ProbableCause("gain changed", because, _LIGHT)


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
    return _gain_changed(name, light.level) if abs(light.level - 1) > _MAX_GAIN_CHANGE[name] else None


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
