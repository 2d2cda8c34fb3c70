"""The cards of the live page: measured values, status and wrenches as HTML, which follows the light or dark theme; curves of the
wrenches, the marks of labels on the time slider, and a moment as a page of its own.

All HTML of the pages stands in `page_cards.html.jinja`, one macro for each card; `card_html` fills it in.
"""

from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from viser import ViserServer

from ninedtact.live.reading_recorder import RecorderState
from ninedtact.live.wrench_history import WrenchSourceSnapshot, WrenchWithUncertainty
from ninedtact.page_template import load_template, render_page
from ninedtact.quantities import DISPLAY_FACTORS, DISPLAY_UNITS, WRENCH_AXES, Wrench
from ninedtact.shape.coloured_height_map import ColourScale
from ninedtact.shape.surface import ShapeSummary
from ninedtact.studio.followed_object import FollowedObject, ObjectPath
from ninedtact.studio.page_controller import SensorStatusMessage
from ninedtact.studio.page_server import standalone_scene_html
from ninedtact.studio.reading_view import (
    JPEG_QUALITY,
    HeightProfile,
    ImageKind,
    ReadingView,
    ShownTraction,
    SkinColouring,
)
from ninedtact.studio.scene_3d import (
    ARC_DEG_PER_NMM,
    MM_PER_N,
    SEEN,
    TRUE,
    GelBlock,
    SkinScene,
    format_signed_tenths,
    set_up_view,
)
from ninedtact.studio.skin_fields import NO_CONTACT, SLIP, STICK
from ninedtact.tracking import SlipState

if TYPE_CHECKING:
    from ninedtact.studio.recording_player import RecordingPlayer

_SLIP_TONES = {SlipState.STATIC: "live", SlipState.INCIPIENT: "busy", SlipState.GROSS: "lost", SlipState.UNKNOWN: ""}
"""Colours of the slip lamp, which is out where slip is unknown."""
_SLIP_WORDS = {SlipState.STATIC: "no slip", SlipState.INCIPIENT: "incipient slip", SlipState.GROSS: "gross slip"}
_CARDS: Any = load_template("ninedtact.studio", "page_cards.html.jinja").module


def card_html(card: str, **values: object) -> str:
    """Return a piece of HTML by the name of its macro in `page_cards.html.jinja`; texts are escaped there."""
    return str(getattr(_CARDS, card)(**values))


def status_html(status: SensorStatusMessage) -> str:
    """Return the state of the sensor as HTML, in its colour."""
    return card_html("status", sentence=status.sentence, tone=status.tone)


def shape_summary_html(summary: ShapeSummary | None, is_past: bool, doubt: str = "") -> str:
    """Return maximum indentation, contact area, contact centre and warnings as HTML; dashes before the first reading.

    doubt: about where the object is.
    """
    if summary is None:
        unknown = ("maximum indentation", "–", "mm"), ("contact area", "–", "mm²")
        return card_html("shape_summary", measures=unknown, where="", warning="", is_past=is_past)
    centre = summary.contact_centre_mm
    place = centre and "centre at x {:z.1f}, y {:z.1f} mm".format(*centre).replace("-", "\N{MINUS SIGN}")
    measures = (
        ("maximum indentation", format_max_indentation(summary), "mm"),
        ("contact area", f"{summary.contact_area_mm2:.1f}", "mm²"),
    )
    warning = "; ".join((*summary.warnings, *([doubt] if doubt else [])))
    where = place or ("" if summary.is_deepest_clipped else "nothing touches")
    return card_html("shape_summary", measures=measures, where=where, warning=warning, is_past=is_past)


def followed_object_html(followed: FollowedObject, is_past: bool) -> str:
    """Return how far the object has moved and turned and how much of it sticks, as seen and on a twin as it is; with slip lamps."""
    states = (followed.slip.state, followed.true_slip)
    rows = [
        (name, _hex_colour(colour), _SLIP_TONES[state], _SLIP_WORDS.get(state, ""), _format_path(path))
        for name, colour, path, state in zip(
            ("estimated", "true"), (SEEN, TRUE), (followed.seen, followed.true), states, strict=True
        )
        if path is not None or name == "estimated"
    ]
    return card_html("followed_object", state=_SLIP_WORDS.get(states[0], ""), rows=rows, is_past=is_past)


def _format_path(path: ObjectPath | None) -> tuple[str, str, str, str]:
    """Return displacement along x and y, turn, and the share that sticks; a dash where one is not known."""
    if path is None:
        return "–", "–", "–", "–"
    x_mm, y_mm = (f"{value + 0.0:+.2f}".replace("-", "\N{MINUS SIGN}") for value in path.moved_mm.round(2).tolist())
    error = f" ± {np.degrees(path.turn_std_rad):.1f}" if path.turn_std_rad else ""
    turn_deg = f"{np.degrees(path.turn_rad):+.1f}{error}°".replace("-", "\N{MINUS SIGN}")
    turn = turn_deg if np.isfinite(path.turn_rad) else "–"
    return x_mm, y_mm, turn, f"{path.sticking_share:.0%}" if np.isfinite(path.sticking_share) else "–"


def format_max_indentation(summary: ShapeSummary) -> str:
    """Return the maximum indentation in mm, marked where it is a lower limit."""
    return f"{'≥ ' if summary.is_deepest_clipped else ''}{summary.max_indentation_mm:.2f}"


def height_legend_html(scale: ColourScale) -> str:
    """Return the colours of heights with their mm as HTML."""
    deepest, half = format_signed_tenths(-scale.pressed_mm), format_signed_tenths(-scale.pressed_mm / 2)
    zero = 100 * scale.pressed_mm / (scale.pressed_mm + scale.bulged_mm)
    marks = ((deepest, 0, 0), (half, zero / 2, -50), ("0 mm", zero, -50), (f"+{scale.bulged_mm:g}", 100, -100))
    return card_html("height_legend", colours=map(_hex_colour, scale.table[1::6].tolist()), marks=marks)


def magnitude_legend_html(name: str, end_mpa: float) -> str:
    """Return the colours of pressure or shear with the MPa at their end as HTML."""
    levels = cv2.applyColorMap(np.arange(0, 256, 17, dtype=np.uint8)[None], cv2.COLORMAP_CIVIDIS)[0, :, ::-1]
    return card_html("magnitude_legend", colours=map(_hex_colour, levels.tolist()), name=name, end=f"{end_mpa:g} MPa")


def sticking_legend_html() -> str:
    """Return the colours of stick and slip as HTML."""
    parts = {"sticks": STICK, "slips": SLIP, "no contact": NO_CONTACT}
    return card_html("sticking_legend", colours={name: _hex_colour(bgr[::-1]) for name, bgr in parts.items()})


def _hex_colour(rgb: Sequence[int]) -> str:
    return f"#{bytes(rgb).hex()}"


def profile_summary_html(profile: HeightProfile) -> str:
    """Return the heights at both ends and the lowest point of a line as HTML."""
    rows = {"A": _format_height(profile, 0), "B": _format_height(profile, -1)}
    if np.isfinite(profile.height_mm).any():
        lowest = int(np.nanargmin(profile.height_mm))
        rows[f"lowest, {profile.distance_mm[lowest]:.1f} mm from A"] = _format_height(profile, lowest)
    return card_html("name_value_table", rows=rows)


def _format_height(profile: HeightProfile, number: int) -> str:
    height = profile.height_mm[number]
    seen = f"{height:+.2f} mm" if np.isfinite(height) else "out of view"
    true = "" if profile.true_mm is None else f" (true {profile.true_mm[number]:+.2f} mm)"
    return (seen + true).replace("-", "\N{MINUS SIGN}")


COLOURS = {"x": "#d55e00", "y": "#009e73", "z": "#0072b2"}
"""Vermilion, green and blue of Okabe and Ito, which colour-blind readers can distinguish."""


def wrench_table_html(moments: Sequence[WrenchSourceSnapshot], is_past: bool) -> str:
    """Return the wrenches in columns, with warnings, as HTML."""
    known = [(moment, moment.sample) for moment in moments if moment.sample is not None]
    rows = [
        (letter, axis, unit, COLOURS[axis], [format_component(sample, number) for _, sample in known])
        for number, ((letter, axis), unit) in enumerate(zip(map(tuple, WRENCH_AXES), DISPLAY_UNITS, strict=True))
    ]
    return card_html(
        "wrench_table",
        sources=[moment for moment, _ in known],
        rows=rows,
        warnings=[warning for _, sample in known for warning in sample.warnings],
        troubles=[moment.trouble for moment in moments if moment.trouble is not None],
        notices=[notice for moment in moments for notice in moment.notices],
        is_past=is_past,
    )


def wrench_meaning_html(moments: Sequence[WrenchSourceSnapshot], has_curves: bool = False) -> str:
    """Return what the columns of wrenches mean, and the scale of the arrow, as HTML. has_curves: says how curves are drawn, too."""
    dashed = [one.name for one in moments if has_curves and len(moments) > 1 and not one.states_errors]
    parts = [f"{one.name}{' (dashed)' if one.name in dashed else ''}: {one.meaning}" for one in moments]
    parts.append(f"about the skin's centre; arrow {MM_PER_N:g} mm/N, arc of twist {ARC_DEG_PER_NMM:g}°/(N·mm)")
    parts += ["time in s"] if has_curves else []
    return card_html("line", text="; ".join(parts), margin="0.3em", size="0.7em", is_dim=True)


def format_component(sample: WrenchWithUncertainty, number: int, unknown: str = "unknown") -> tuple[str, str]:
    """Return a component and its standard deviation, which may be empty; nothing is known where it is infinite."""
    scale = DISPLAY_FACTORS[number]
    std = scale * sample.std[number]
    if np.isinf(std):
        return unknown, ""
    return format_signed_hundredths(scale * sample.wrench.six[number], "+"), f"{std:.2f}" if np.isfinite(std) else ""


def format_signed_hundredths(number: float, sign: str = "-") -> str:
    """Return a number as text, rounded to hundredths, with a true minus sign; zero is not negative. sign: "+" shows it always."""
    return f"{round(number, 2) + 0.0:{sign}.2f}".replace("-", "\N{MINUS SIGN}")


def recorder_html(state: RecorderState) -> str:
    """Return length, size, drops and labels of the recording, and why it ended."""
    if state.path is None:
        return ""
    begun = "recording" if state.is_running else "recorded"
    said = f"{begun} {state.path.name}: {state.seconds:.1f} s, {state.written_bytes / 1e6:.1f} MB, {state.dropped} images dropped"
    if state.is_running:  # labels of a recording that has ended are added to its file
        said += f", {state.labels} labels"
    return card_html("recorder", said=said, trouble=state.trouble)


def time_slider_marks(player: "RecordingPlayer") -> Iterator[float | tuple[float, str]]:
    """Yield what is drawn on the time slider: both ends of every label, and its own end with the time."""
    duration_s = player.duration_s
    yield from sorted(min(max(at_s, 0.0), duration_s) for span in player.spans for at_s in player.span_s(span))
    yield duration_s, f"{duration_s:.1f} s"


def standalone_moment_html(
    view: ReadingView,
    cards: Iterable[str],
    block: GelBlock,
    title: str,
    wrench: Wrench | None = None,
) -> str:
    """Return one HTML page of a moment that needs no other file: the surface in 3D, camera image, heights and cards.

    cards: HTML beside the images. wrench: is drawn as an arrow; None draws none.
    """

    def draw_scene(server: ViserServer) -> None:
        set_up_view(server, block)
        skin = SkinScene(server.scene, block)
        skin.show_surface(view.surface(SkinColouring.HEIGHT, 1, ShownTraction.ESTIMATED), True, False)
        skin.show_lines(view.outline_mm(), None)
        skin.show_wrench(wrench)

    images = {}
    for kind in (ImageKind.CAMERA, ImageKind.HEIGHT):
        jpeg = cv2.imencode(".jpg", view.image(kind, True), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
        images[kind] = b64encode(jpeg.tobytes()).decode()
    scene_page = standalone_scene_html(draw_scene)
    return render_page(
        "ninedtact.studio",
        "exported_moment.html.jinja",
        title=title,
        scene_page=scene_page,
        cards=cards,
        images=images,
    )
