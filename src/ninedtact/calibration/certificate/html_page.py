"""A calibration → one page that a person reads: how good the sensor is, from what that is known, and what to do."""

from base64 import b64encode

from ninedtact.calibration.certificate.checks import headline, verdict, worst
from ninedtact.calibration.certificate.plot_ball import (
    curve_image,
    cuts_image,
    disc_image,
    profile_image,
    residual_image,
    rest_image,
    twin_rows,
)
from ninedtact.calibration.certificate.plot_board import detection_image, left_out_image
from ninedtact.calibration.procedure import Calibration
from ninedtact.calibration.sensor_record import BallFigures, BoardFigures, SensorRecord
from ninedtact.design import SensorDesign

IMAGES = {
    "detection": detection_image,
    "left_out": left_out_image,
    "disc": disc_image,
    "curve": curve_image,
    "residual": residual_image,
    "cuts": cuts_image,
}
LENS = {"lens": "homography with radial and tangential terms", "paper": "the paper's map through the pins"}
METHOD = {
    "physics": "contact mechanics and light, fitted to the whole image",
    "ratio": "the ball's cap against the fraction of the untouched brightness",
    "table": "the ball's cap against grey-level difference (the paper's)",
}
UNITS = ("mm", "px", "deg")
Rows = list[tuple[str, str]]


def certificate_html(calibration: Calibration) -> str:
    """The page as one HTML document that needs nothing else: images are inside it, it loads and runs nothing."""
    # jinja2 is slow to import, and only this function needs it.
    from jinja2 import Environment, PackageLoader, StrictUndefined

    pages = Environment(
        loader=PackageLoader("ninedtact.calibration.certificate", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    record = calibration.record
    assert record.certificate is not None, "a calibration that was made here has its figures"
    return pages.get_template("certificate.html.jinja").render(
        record=record,
        headline=headline(record.certificate),
        level=worst(record.certificate),
        lines=verdict(record.certificate),
        warnings=record.certificate.warnings,
        images={name: b64encode(content).decode() for name, content in drawn(calibration).items()},
        board_rows=[*board_rows(record.certificate.board), *view_rows(record)],
        ball_rows=ball_rows(record.certificate.ball),
        twin_rows=twin_rows(record.twin) if record.twin else [],
        design_rows=design_rows(record.design),
    )


def drawn(calibration: Calibration) -> dict[str, bytes]:
    """Every image of the page as PNG; those of the twin where there is one."""
    images = {name: draw(calibration) for name, draw in IMAGES.items()}
    physical = calibration.ball.physical
    if physical is not None:
        images |= {"rest": rest_image(physical.fit), "profile": profile_image(physical.fit)}
    return images


def board_rows(board: BoardFigures) -> Rows:
    """The camera calibration's figures, named and with their units."""
    return [
        ("pins found", f"{board.pins_found} of {board.pins_expected}"),
        ("left-out error, RMS", f"{board.loo_rms_mm:.3f} mm"),
        ("the same, the original project's way", original_in_words(board)),
        ("left-out error, largest", f"{board.loo_max_mm:.3f} mm"),
        ("scale", f"{board.mm_per_px:.5f} ± {board.mm_per_px_error:.5f} mm per pixel"),
        ("imprint of a pin (median)", f"{board.contrast_grey_levels:.1f} grey levels"),
        ("noise of a raw pixel", f"{board.noise_grey_levels:.2f} grey levels"),
        ("lens", LENS[board.lens]),
        ("sensor's x axis, from the image's", f"{board.mounting_deg}° clockwise"),
    ]


def original_in_words(board: BoardFigures) -> str:
    """The original's error on the same images, and how this lens compares."""
    words = f"{board.loo_rms_mm_original:.3f} mm"
    if board.lens == "paper":
        return words
    change = board.loo_rms_mm / board.loo_rms_mm_original - 1
    return f"{words}; the lens above is {abs(change):.0%} {'better' if change < 0 else 'worse'}"


def view_rows(record: SensorRecord) -> Rows:
    """What a reading shows, and of what."""
    view, grid = record.design.field_of_view, record.grid
    return [
        (
            "field of view",
            f"{view.cols * grid.mm_per_px:.2f} \N{MULTIPLICATION SIGN} {view.rows * grid.mm_per_px:.2f} mm",
        ),
        ("rectified image", f"{view.cols} \N{MULTIPLICATION SIGN} {view.rows} pixels"),
        ("raw image", f"{grid.raw_cols} \N{MULTIPLICATION SIGN} {grid.raw_rows} pixels"),
    ]


def ball_rows(ball: BallFigures) -> Rows:
    """The depth calibration's figures, named and with their units."""
    return [
        ("range", f"0 to {ball.range_mm:.2f} mm"),
        ("ball read back, mean absolute error", f"{ball.fit_mae_mm:.3f} mm"),
        ("half of it by the other half's curve", f"{ball.half_mae_mm:.3f} mm"),
        ("noise of a pixel's depth", f"{ball.noise_mm:.4f} mm"),
        ("ball's radius", f"{ball.ball_radius_mm:g} mm"),
        ("contact circle's radius", f"{ball.radius_mm:.2f} mm, {ball.radius_px:.1f} pixels"),
        ("pressed at its deepest", f"{ball.deepest_mm:.2f} mm"),
        ("darkening there", f"{ball.drop_grey_levels:.1f} grey levels"),
        ("mean depth per grey level", f"{ball.deepest_mm / ball.drop_grey_levels:.3f} mm"),
        ("unevenness of the bulge", f"{ball.asymmetry:.1%} of the darkening"),
        ("overexposed skin", f"{ball.overexposed:.1%} of the image"),
        ("method", METHOD[ball.method]),
    ]


def design_rows(design: SensorDesign) -> Rows:
    """Every dimension of the design, part by part."""
    return [
        (part.replace("_", " "), ", ".join(dimension(name, value) for name, value in vars(dimensions).items()))
        for part, dimensions in vars(design).items()
    ]


def dimension(name: str, value: float | tuple[float, ...]) -> str:
    """A field whose name ends in its unit, as a person writes it."""
    *words, unit = name.split("_")
    number = f"({', '.join(f'{part:g}' for part in value)})" if isinstance(value, tuple) else f"{value:g}"
    return f"{' '.join(words)} {number} {unit}" if unit in UNITS else f"{name.replace('_', ' ')} {number}"
