"""The cards of the live page: measured values, status and wrenches as HTML, which follows the light or dark theme; curves of the
wrenches, the marks of labels on the time slider, and a moment as a page of its own.

All HTML of the pages stands in `page_cards.html.jinja`, one macro for each card; `card_html` fills it in.
"""

from base64 import b64encode
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from jaxtyping import Float64
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy import ndarray as Array
from viser import GuiApi, GuiUplotHandle, SceneApi, ViserServer, uplot

from ninedtact.quantities import DISPLAY_FACTORS, DISPLAY_UNITS, WRENCH_AXES, Wrench
from ninedtact.shape.coloured_height_map import ColourScale
from ninedtact.shape.measures import ShapeSummary
from ninedtact.studio.page_controller import SensorStatusMessage
from ninedtact.studio.reading_view import HeightProfile, ImageKind, ReadingView, ShownTraction, SkinColouring
from ninedtact.studio.scene_3d import ARC_DEG_PER_NMM, MM_PER_N, GelBlock, SkinScene, format_signed_tenths
from ninedtact.studio.sensor_poller import HISTORY_S
from ninedtact.studio.skin_fields import NO_CONTACT, SLIP, STICK
from ninedtact.studio.viser_internals import standalone_scene_html
from ninedtact.studio.wrench_history import WrenchHistory, WrenchSourceSnapshot, WrenchWithUncertainty

if TYPE_CHECKING:  # a page without recordings does not need its libraries
    from ninedtact.studio.page_recorder import RecorderState
    from ninedtact.studio.recording_player import RecordingPlayer

_TEMPLATES = Environment(
    loader=PackageLoader("ninedtact.studio", "."),
    autoescape=True,
    undefined=StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
)
_CARDS: Any = _TEMPLATES.get_template("page_cards.html.jinja").module


def card_html(card: str, **values: object) -> str:
    """Return a piece of HTML by the name of its macro in `page_cards.html.jinja`; texts are escaped there."""
    return str(getattr(_CARDS, card)(**values))


def status_html(status: SensorStatusMessage) -> str:
    """Return the state of the sensor as HTML, in its colour."""
    return card_html("status", sentence=status.sentence, tone=status.tone)


def shape_summary_html(summary: ShapeSummary, is_past: bool) -> str:
    """Return maximum indentation, contact area, contact centre and a warning as HTML."""
    x_y = summary.contact_centre_mm
    centre = x_y and f"centre at x {format_signed_tenths(x_y[0])}, y {format_signed_tenths(x_y[1])} mm"
    measures = (
        ("maximum indentation", format_max_indentation(summary), "mm"),
        ("contact area", f"{summary.contact_area_mm2:.1f}", "mm²"),
    )
    warning = "; ".join(summary.warnings)
    where = centre or ("" if summary.is_deepest_clipped else "nothing touches")
    return card_html("shape_summary", measures=measures, where=where, warning=warning, is_past=is_past)


def format_max_indentation(summary: ShapeSummary) -> str:
    """Return the maximum indentation in mm, marked where it is a lower limit."""
    return f"{'≥ ' if summary.is_deepest_clipped else ''}{summary.max_indentation_mm:.2f}"


def name_value_table_html(rows: dict[str, str]) -> str:
    """Return a table of names and values as HTML."""
    return card_html("name_value_table", rows=rows)


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
    """Return a colour as CSS writes it."""
    return f"#{bytes(rgb).hex()}"


def profile_summary_html(profile: HeightProfile) -> str:
    """Return the heights at both ends and the lowest point of a line as HTML."""
    rows = {"A": _format_height(profile, 0), "B": _format_height(profile, -1)}
    if np.isfinite(profile.height_mm).any():
        lowest = int(np.nanargmin(profile.height_mm))
        rows[f"lowest, {profile.distance_mm[lowest]:.1f} mm from A"] = _format_height(profile, lowest)
    return name_value_table_html(rows)


def _format_height(profile: HeightProfile, number: int) -> str:
    """Return the height at one point of a line, with the true one where it is known."""
    height = profile.height_mm[number]
    seen = f"{height:+.2f} mm" if np.isfinite(height) else "out of view"
    true = "" if profile.true_mm is None else f" (true {profile.true_mm[number]:+.2f} mm)"
    return (seen + true).replace("-", "\N{MINUS SIGN}")


COLOURS = {"x": "#d55e00", "y": "#009e73", "z": "#0072b2"}
"""Vermilion, green and blue of Okabe and Ito, which colour-blind readers can distinguish."""
LEAST_N, LEAST_NMM = 2.0, 4.0
"""Smallest half range of the curves, so that noise stays small."""
CURVE_POINTS = 400
"""Number of points of a curve over the last seconds."""
BAND_OPACITY = "22"
"""Opacity of the band of one standard deviation, in hexadecimal."""


class WrenchCurves:
    """The last seconds of the wrenches of all sources, on top of each other in two plots.

    Where there are several sources, wrenches without stated errors (true, measured) are drawn dashed.
    """

    def __init__(self, gui: GuiApi, sources: Sequence[WrenchHistory]) -> None:
        self._forces = _add_curves(gui, "force (N)", "F", LEAST_N, sources)
        self._torques = _add_curves(gui, "torque (N·mm)", "T", LEAST_NMM, sources)
        gui.add_html(card_html("line", text=_describe_lines(sources), size="0.75em", is_dim=True))

    def draw(self, moments: Sequence[WrenchSourceSnapshot]) -> None:
        """Draw the last seconds of every source."""
        at_s = np.linspace(-HISTORY_S, 0.0, CURVE_POINTS)
        for plot, first, unit, least in ((self._forces, 0, 1.0, LEAST_N), (self._torques, 3, 1e3, LEAST_NMM)):
            curves = [curve for moment in moments for curve in _curves_of(moment, at_s, first, unit)]
            largest = max((float(np.nanmax(np.abs(curve), initial=0.0)) for curve in curves), default=0.0)
            plot.data = (at_s, *curves)
            plot.scales = _curve_scales(max(largest * 1.1, least))


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


def wrench_meaning_html(moments: Sequence[WrenchSourceSnapshot]) -> str:
    """Return what the columns of wrenches mean, and the scale of the arrow, as HTML."""
    meaning = "; ".join(f"{moment.name}: {moment.meaning}" for moment in moments)
    scale = f"about the skin's centre; arrow {MM_PER_N:g} mm per N, arc {ARC_DEG_PER_NMM:g}° per N·mm of twist"
    return card_html("line", text=f"{meaning}; {scale}", margin="0.3em", size="0.75em", is_dim=True)


def explained_wrench_table_html(moments: Sequence[WrenchSourceSnapshot], is_past: bool) -> str:
    """Return the wrenches in columns, with warnings and what the columns mean, as HTML; empty without wrenches."""
    return wrench_table_html(moments, is_past) + wrench_meaning_html(moments) if moments else ""


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


def _add_curves(gui: GuiApi, title: str, letter: str, half: float, sources: Sequence[WrenchHistory]) -> GuiUplotHandle:
    """Add a plot of three curves of each source, with a band of one standard deviation where it is stated."""
    series, bands = [uplot.Series(label="s ago")], []
    for source in sources:
        dash = (5.0, 4.0) if len(sources) > 1 and not source.states_errors else ()
        for axis, colour in COLOURS.items():
            label = f"{letter}_{axis} {source.name}"
            series.append(uplot.Series(label=label, stroke=colour, width=1.5, dash=dash))
            if source.states_errors:
                bands.append(uplot.Band(series=(len(series), len(series) + 1), fill=colour + BAND_OPACITY))
                series += [uplot.Series(label=f"{label} {sign} std", width=0) for sign in ("+", "−")]
    return gui.add_uplot(
        (np.zeros(2),) * len(series),
        tuple(series),
        bands=tuple(bands),
        scales=_curve_scales(half),
        legend=uplot.Legend(show=False),
        title=f"{title}: x orange, y green, z blue",
        height=150,
    )


def _describe_lines(sources: Sequence[WrenchHistory]) -> str:
    """Return how the curves of each source are drawn, as `_add_curves` does."""
    solid = "solid, with a band of one standard deviation"
    dashed = "dashed" if len(sources) > 1 else "solid"
    return "; ".join(f"{source.name}: {solid if source.states_errors else dashed}" for source in sources)


def _curves_of(
    moment: WrenchSourceSnapshot, at_s: Float64[Array, " n"], first: int, unit: float
) -> Iterator[Float64[Array, " n"]]:
    """Yield what `_add_curves` draws of one source: each axis, and its upper and lower end where errors are stated."""
    for axis in range(first, first + 3):
        yield from component_curve_and_error_band(moment, at_s, axis, unit)


def component_curve_and_error_band(
    moment: WrenchSourceSnapshot, at_s: Float64[Array, " n"], axis: int, unit: float
) -> Iterator[Float64[Array, " n"]]:
    """Yield one component of a source over the last seconds, and its upper and lower end where errors are stated.

    Beyond the samples the component is NaN. The ends meet there, because uPlot would fill some of what is between NaNs.
    """
    sampled_s, values, stds = moment.history[0], moment.history[1 + axis] * unit, moment.history[7 + axis] * abs(unit)
    stds = np.where(np.isfinite(stds), stds, 0.0)
    if not sampled_s.size:
        yield from (np.full(at_s.shape, np.nan) for _ in range(3 if moment.states_errors else 1))
        return
    yield np.interp(at_s, sampled_s, values, left=np.nan, right=np.nan)
    for end in (values + stds, values - stds) if moment.states_errors else ():
        yield np.interp(at_s, sampled_s, end, left=values[0], right=values[-1])


def _curve_scales(half: float) -> dict[str, uplot.Scale]:
    """Return the axes of the curves: the last seconds, and values about zero."""
    return {"x": uplot.Scale(time=False, range=(-HISTORY_S, 0.0)), "y": uplot.Scale(range=(-half, half))}


def recorder_html(state: "RecorderState") -> str:
    """Return length, size, drops and labels of the recording, and why it ended."""
    if state.path is None:
        return ""
    begun = "recording" if state.is_running else "recorded"
    said = f"{begun} {state.path.name}: {state.seconds:.1f} s, {state.written_bytes / 1e6:.1f} MB, {state.dropped} images dropped"
    if state.is_running:  # labels of a recording that has ended are added to its file
        said += f", {state.labels} labels"
    return card_html("recorder", said=said, trouble=state.trouble)


_MARK_LETTERS, _MARK_ROOM = 10, 0.2
"""Number of letters of a label that are drawn on the time slider, and the share of it that they take."""


def time_slider_marks(player: "RecordingPlayer") -> Iterator[tuple[float, str | None]]:
    """Yield what is drawn on the time slider: its end, and both ends of every label, with its name where there is room for it."""
    duration_s, free_s = player.duration_s, 0.0
    room_s = _MARK_ROOM * duration_s
    ends = [(player.span_s(span)[end], "" if end else span.label) for span in player.spans for end in (0, 1)]
    for at_s, label in sorted((min(max(at_s, 0.0), duration_s), label) for at_s, label in ends):
        has_room = bool(label) and free_s <= at_s <= duration_s - room_s
        free_s = at_s + room_s if has_room else free_s
        yield at_s, label[:_MARK_LETTERS] if has_room else None
    yield duration_s, f"{duration_s:.1f} s"


def standalone_moment_html(
    view: ReadingView,
    cards: Iterable[str],
    server: ViserServer,
    block: GelBlock,
    title: str,
    wrench: Wrench | None = None,
) -> str:
    """Return one HTML page of a moment that needs no other file: the surface in 3D, camera image, heights and cards.

    cards: HTML beside the images. wrench: is drawn as an arrow; None draws none.
    """
    scene_page = standalone_scene_html(server, lambda scene: _draw_scene(scene, view, block, wrench))
    images = {kind: b64encode(view.jpeg(kind, True)).decode() for kind in (ImageKind.CAMERA, ImageKind.HEIGHT)}
    page = _TEMPLATES.get_template("exported_moment.html.jinja")
    return page.render(title=title, scene_page=scene_page, cards=cards, images=images)


def _draw_scene(scene: SceneApi, view: ReadingView, block: GelBlock, wrench: Wrench | None) -> None:
    """Draw the surface of a view as a new viewer sees it."""
    skin = SkinScene(scene, block)
    skin.show_surface(view.surface(SkinColouring.HEIGHT, 1, ShownTraction.ESTIMATED), True, False)
    skin.show_lines(view.outline_mm(), None)
    skin.show_wrench(wrench)
