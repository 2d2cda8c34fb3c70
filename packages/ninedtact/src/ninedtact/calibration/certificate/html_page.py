"""The certificate as one HTML page: the quality of the calibration, the images and figures that it rests on, and advice.
`render_certificate_html` takes a `Calibration` and returns the page; `render_page_with_images` fills in a template,
also that of a comparison.
"""

import re
from base64 import b64encode
from collections.abc import Mapping
from typing import Any

from ninedtact.calibration.certificate.checks import (
    certificate_headline,
    compute_certificate_checks,
    overall_check_level,
    uses_in_words,
)
from ninedtact.calibration.certificate.plot_ball import (
    plot_ball_cross_sections,
    plot_ball_residual,
    plot_contact_disc,
    plot_depth_curve,
    plot_radial_profile,
    plot_twin_residual,
)
from ninedtact.calibration.certificate.plot_board import plot_leave_one_out_errors, plot_pin_detection
from ninedtact.calibration.gel_fit_to_known_loads import MODULUS_STD
from ninedtact.calibration.procedure import Calibration
from ninedtact.calibration.sensor_toml_schema import (
    BallQuality,
    BoardPressFitTable,
    BoardQuality,
    KnownLoadTable,
    SecondPressQuality,
    SensorTomlRecord,
    TwinTable,
)
from ninedtact.design import SecondKind, SensorDesign
from ninedtact.force.estimator_and_scale import force_scale_of_ball
from ninedtact.page_template import render_page

BOARD_IMAGES = {"detection": plot_pin_detection, "left_out": plot_leave_one_out_errors}
BALL_IMAGES = {
    "disc": plot_contact_disc,
    "curve": plot_depth_curve,
    "residual": plot_ball_residual,
    "cuts": plot_ball_cross_sections,
}
LENS_MODEL_TEXT = {"model": "homography with radial and tangential terms", "paper": "the paper's map through the pins"}
DEPTH_METHOD_TEXT = {
    "physics": "contact mechanics and light, fitted to the whole image",
    "ratio": "the ball's cap against the fraction of the reference brightness",
    "table": "the ball's cap against grey-level difference (the paper's)",
}
UNITS = ("mm", "px", "deg")
Rows = list[tuple[str, str]]
_FORCE_SECTION = re.compile(r'<section id="force">.*?</section>', re.DOTALL)
_TYPICAL_LOAD_N = 5.0


def render_certificate_html(calibration: Calibration) -> str:
    """Return the page as one self-contained HTML document: images are embedded, and nothing is loaded or executed."""
    record = calibration.record
    assert record.certificate is not None, "a calibration that was made here has its figures"
    return render_page_with_images(
        "certificate.html.jinja",
        _plot_certificate_images(calibration),
        record=record,
        headline=certificate_headline(record.certificate),
        level=overall_check_level(record.certificate),
        lines=compute_certificate_checks(record.certificate),
        uses_in_words=uses_in_words,
        cause=record.certificate.cause,
        warnings=record.certificate.warnings,
        board_rows=[*_board_table_rows(record.certificate.board), *_view_table_rows(record)],
        ball_rows=[
            *_ball_table_rows(record.certificate.ball),
            *(row for each in record.certificate.second_presses.items() for row in _second_press_table_rows(*each)),
            *_second_press_hint_rows(record),
        ],
        twin_rows=_twin_table_rows(record.twin) if record.twin else [],
        design_rows=_design_table_rows(record.design),
        **_force_section_values(record),
    )


def replace_force_section(page: str, record: SensorTomlRecord) -> str:
    """Return a certificate whose section on force is replaced by that of this record."""
    section = render_page_with_images("force_section.html.jinja", {}, **_force_section_values(record))
    return _FORCE_SECTION.sub(lambda match: section.strip(), page)


def render_page_with_images(template: str, images: Mapping[str, bytes], **values: Any) -> str:
    """Return a template of this package as one self-contained HTML document, with PNG images embedded by their names."""
    embedded = {name: b64encode(content).decode() for name, content in images.items()}
    return render_page("ninedtact.calibration.certificate", template, images=embedded, **values)


def _plot_certificate_images(calibration: Calibration) -> dict[str, bytes]:
    """Return every image of the page as PNG; those of the twin where there is one."""
    fits = calibration.fits
    draws = {**({} if fits.board is None else BOARD_IMAGES), **({} if fits.ball is None else BALL_IMAGES)}
    images = {name: draw(calibration) for name, draw in draws.items()}
    if fits.twin is not None:
        images |= {"rest": plot_twin_residual(fits.twin), "profile": plot_radial_profile(fits.twin)}
    return images


def _board_table_rows(board: BoardQuality | None) -> Rows:
    """Return the figures of the camera calibration, named and with their units."""
    if board is None:
        return [("lens", "imported from the original project, not tested by pins")]
    return [
        ("pins found", f"{board.pins_found} of {board.pins_expected}"),
        ("left-out error, RMS", f"{board.leave_one_out_rms_mm:.3f} mm"),
        ("the same, the original project's way", _published_error_in_words(board)),
        ("left-out error, largest", f"{board.leave_one_out_max_mm:.3f} mm"),
        ("scale", f"{board.mm_per_px:.5f} ± {board.mm_per_px_std:.5f} mm per pixel"),
        ("imprint of a pin (median)", f"{board.contrast_grey_levels:.1f} grey levels"),
        ("noise of a raw pixel", f"{board.noise_grey_levels:.2f} grey levels"),
        ("lens", _lens_in_words(board)),
        ("sensor's x axis, from the image's", f"{board.camera_rotation_deg}° clockwise"),
    ]


def _lens_in_words(board: BoardQuality) -> str:
    """Return the kind of the lens, and whether a smooth correction is used on top of it."""
    words, before_mm = LENS_MODEL_TEXT[board.lens], board.uncorrected_rms_mm
    if before_mm is None:
        return words
    return f"{words}, and a smooth correction, without which the left-out error is {before_mm:.3f} mm"


def _published_error_in_words(board: BoardQuality) -> str:
    """Return the error of the original method on the same images, compared with that of this lens."""
    words = f"{board.published_method_rms_mm:.3f} mm"
    if board.lens == "paper":
        return words
    change = board.leave_one_out_rms_mm / board.published_method_rms_mm - 1
    return f"{words}; the lens above is {abs(change):.0%} {'better' if change < 0 else 'worse'}"


def _view_table_rows(record: SensorTomlRecord) -> Rows:
    """Return the scale and extent of the view."""
    view, grid = record.design.field_of_view, record.grid
    return [
        (
            "field of view",
            f"{view.cols * grid.mm_per_px:.2f} \N{MULTIPLICATION SIGN} {view.rows * grid.mm_per_px:.2f} mm",
        ),
        ("rectified image", f"{view.cols} \N{MULTIPLICATION SIGN} {view.rows} pixels"),
        ("raw image", f"{grid.raw_cols} \N{MULTIPLICATION SIGN} {grid.raw_rows} pixels"),
    ]


def _ball_table_rows(ball: BallQuality | None) -> Rows:
    """Return the figures of the depth calibration, named and with their units; nothing where no ball was pressed."""
    if ball is None:
        return []
    return [
        ("range", f"0 to {ball.range_mm:.2f} mm"),
        ("ball read back, mean absolute error", f"{ball.reconstruction_mae_mm:.3f} mm"),
        ("half of it by the other half's curve", f"{ball.cross_validation_mae_mm:.3f} mm"),
        ("noise of a pixel's depth", f"{ball.noise_mm:.4f} mm"),
        ("ball's radius", f"{ball.ball_radius_mm:g} mm"),
        ("contact circle's radius", f"{ball.contact_radius_mm:.2f} mm, {ball.contact_radius_px:.1f} pixels"),
        ("maximum indentation", f"{ball.max_indentation_mm:.2f} mm"),
        ("darkening there", f"{ball.darkening_grey_levels:.1f} grey levels"),
        ("mean depth per grey level", f"{ball.max_indentation_mm / ball.darkening_grey_levels:.3f} mm"),
        ("unevenness of the bulge", f"{ball.asymmetry:.1%} of the darkening"),
        ("overexposed skin", f"{ball.overexposed_fraction:.1%} of the image"),
        ("method", DEPTH_METHOD_TEXT[ball.method]),
    ]


def _design_table_rows(design: SensorDesign) -> Rows:
    """Return every dimension of the design, part by part."""
    return [
        (
            part.replace("_", " "),
            ", ".join(_dimension_in_words(name, value) for name, value in vars(dimensions).items()),
        )
        for part, dimensions in vars(design).items()
    ]


def _dimension_in_words(name: str, value: float | tuple[float, ...]) -> str:
    """Return the value of a field whose name ends in its unit, formatted with that unit."""
    *words, unit = name.split("_")
    number = f"({', '.join(f'{part:g}' for part in value)})" if isinstance(value, tuple) else f"{value:g}"
    return f"{' '.join(words)} {number} {unit}" if unit in UNITS else f"{name.replace('_', ' ')} {number}"


PARAMETER_MEANINGS = {
    "x_mm": "Where the ball's centre is, along the sensor's x axis.",
    "y_mm": "Where the ball's centre is, along the sensor's y axis.",
    "depth_mm": "How deep the ball was pressed.",
    "drag_x_mm": "How far the ball was dragged along x after it had touched.",
    "drag_y_mm": "How far the ball was dragged along y after it had touched.",
    "thickness_mm": "Thickness with which the gel acts: thinner gel bulges higher and closer to the ball.",
    "point_spread_mm": "How far light scatters in the gel (standard deviation); finer structure is blurred.",
    "saturation": "How much faster thin gel darkens than thick gel; zero is a straight line.",
    "inverse_distance_per_mm": "How much pressed skin appears displaced outwards, per mm of height and mm from the axis.",
    "gel_to_base_modulus_ratio": "How soft the gel is beside the layer below it: 0 on a rigid base, 0.1 on one ten times as stiff.",
    "loss": "Relative change of the whole image's brightness in this press; light is lost where it is negative.",
    "darkening_per_mm": "Relative darkening where thinning begins.",
    "brightening_per_mm": "Relative brightening where the gel is thicker than untouched.",
}
"""What every fitted parameter of the twin is, in one sentence."""


def _second_press_hint_rows(record: SensorTomlRecord) -> Rows:
    """Return how the depth of a ball that was pressed alone becomes more certain; no row after a second press."""
    if record.twin is None or record.certificate is None or record.certificate.second_presses:
        return []
    how = "press a second ball, or the flat end of a rod to a known depth (ninedtact calibrate --plan says what each would add)"
    return [("to know the depth better", how)]


def _second_press_table_rows(kind: SecondKind, second: SecondPressQuality) -> Rows:
    """Return the figures of a second press, and what it adds to the first."""
    name, is_ball = kind.replace("_", " "), kind == "second_ball"
    stop = f"{second.stated_mm:.3f} ± {second.stated_std_mm:.3f} mm from the first touch, its tilt included"
    stated_rows = [] if is_ball else [(f"{name}, depth of its middle by the stop", stop)]
    return [
        (f"{name}, radius", f"{second.radius_mm:g} mm"),
        *stated_rows,
        ("the same by the images", f"{second.likely_mm:.2f} ± {second.likely_std_mm:.2f} mm"),
        (f"{name}, depth", f"{second.max_indentation_mm:.3f} ± {second.max_indentation_std_mm:.3f} mm"),
        (f"{name}, residual (RMS)", f"{second.residual_rms_grey_levels:.2f} grey levels"),
        (
            "depth of the first ball by its own image",
            f"{second.first_alone_mm:.3f} ± {second.first_std_alone_mm:.3f} mm",
        ),
        (
            f"the same with the {name}",
            f"{second.first_mm:.3f} ± {second.first_std_mm:.3f} mm, {second.first_deviation:.1f} standard deviations from that",
        ),
    ]


def _force_section_values(record: SensorTomlRecord) -> dict[str, Any]:
    """Return the values of the template `force_section`; an empty table where nothing is known of the gel."""
    twin, known = record.twin, record.known_loads
    if twin is None:
        return {"force_sentence": "", "force_rows": []}
    gel, ratio_std = twin.gel, twin.modulus_ratio_std if known is None else known.modulus_ratio_std
    error = force_scale_of_ball(ratio_std).error if known is None else known.error
    rows = [
        (
            f"a load of {_TYPICAL_LOAD_N:g} N is read to",
            f"± {_TYPICAL_LOAD_N * error:.1f} N, and the error of its own image",
        ),
        (
            "shear modulus of the gel",
            f"{gel.shear_modulus_mpa:.3f} MPa ± {MODULUS_STD if known is None else known.modulus_std:.0%}",
        ),
        ("modulus of the gel over that of its base", _ratio_in_words(gel.gel_to_base_modulus_ratio, ratio_std)),
        ("shear beside pressure (Fx, Fy, Tz)", _shear_in_words(known)),
    ]
    if known is None:
        sentence = (
            f"Not calibrated with known loads: the modulus of the gel is that of its design, and all forces share an error of "
            f"± {error:.0%}. A kitchen scale tells it: ninedtact adapt."
        )
    else:
        presses = "one known load" if known.presses == 1 else f"{known.presses} known loads"
        sentence = f"Calibrated with {presses}: all forces like these share an error of ± {error:.0%}."
    return {"force_sentence": sentence, "force_rows": rows}


def _ratio_in_words(ratio: float, std: float | None) -> str:
    return "rigid base by design" if ratio == 0 else f"{ratio:.3f}" + ("" if std is None else f" ± {std:.3f}")


def _shear_in_words(known: KnownLoadTable | None) -> str:
    if known is None or known.shear_std == 0:
        return "as the mechanics say; only a force/torque sensor would test it"
    return f"{known.shear_factor:.2f} times what the mechanics say, ± {known.shear_std:.0%}"


def _twin_table_rows(twin: TwinTable) -> list[tuple[str, str, str]]:
    """Return every parameter with its standard deviation and most correlated parameter, and with a sentence about what it is."""
    fit = twin.fit
    rows = [
        ("residual, whole image (RMS)", f"{fit.image_rmse_grey_levels:.2f} grey levels", ""),
        ("residual, radial profile (RMS)", f"{fit.radial_rmse_grey_levels:.2f} grey levels", ""),
        (
            "effective independent observations",
            f"{fit.effective_observations:.0f}",
            "The residual is smooth, so that neighbouring pixels are correlated.",
        ),
    ]
    if twin.board_press is not None:
        rows += _board_press_table_rows(twin.board_press)
    for name, parameter in fit.parameters.items():
        other = parameter.most_correlated_with
        std = "" if parameter.std is None else f" ± {parameter.std:.3f}"
        correlation = "" if other is None else f", {parameter.correlation:+.2f} with {other.replace('_', ' ')}"
        rows.append((name.replace("_", " "), f"{parameter.value:.3f}{std}{correlation}", PARAMETER_MEANINGS[name]))
    return rows


def _board_press_table_rows(board_press: BoardPressFitTable) -> list[tuple[str, str, str]]:
    """Return the figures of the fit to the board image, and whether it was accepted."""
    outcome = "used for the lens" if board_press.accepted else "not used: the board differs from its design"
    return [
        (
            "board: imprints' depth",
            f"{board_press.depth_mm:.2f} mm ± {board_press.depth_std_mm:.2f}, {outcome}",
            "How deep the pins pressed, from the darkness of their imprints.",
        ),
        (
            "board: inverse viewing distance (1/mm)",
            f"{board_press.inverse_distance_per_mm:.3f} ± {board_press.inverse_distance_std_per_mm:.3f}",
            "How much the imprints appear displaced outwards, for which a lens that uses the fit is corrected.",
        ),
        (
            "board: residual (RMS)",
            f"{board_press.residual_rms_grey_levels:.2f} of {board_press.contrast_grey_levels:.1f} grey levels",
            "",
        ),
    ]
