"""Several sensors on one page: their states, their wrenches in one table, and the grip force of opposing ones.

Sensors oppose each other in pairs, in the order in which they are named: the first and the second, the third and the fourth. The
grip force of a pair is the mean of their normal forces −F_z. The readings of the sensors are each the newest, on one clock.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ninedtact.live.wrench_history import WrenchSourceSnapshot, WrenchWithUncertainty
from ninedtact.studio.page_cards import card_html, format_component, format_max_indentation, format_signed_hundredths
from ninedtact.studio.page_controller import SensorMoment

SENSOR_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7")
"""Blue, vermilion, green and purple of Okabe and Ito, one for each sensor; a fifth begins again."""
GRIP_COLOUR = "#e69f00"


@dataclass(frozen=True)
class GripForce:
    """The mean of the normal forces of two opposing sensors, from one kind of source."""

    fingers: tuple[str, str]
    source: str
    """The head of the column: true, measured or estimated."""
    force_n: float | None
    """Positive where both are pressed; None where a sensor is lost or its force unknown."""
    std_n: float
    """One standard deviation: the mean of both, because errors of the method are common to them; NaN where none is stated."""
    missing: str = ""
    """Which sensor has no force."""


def grip_forces(moments: Sequence[SensorMoment]) -> Iterator[GripForce]:
    """Yield the grip force of every pair of opposing sensors, by each kind of source that both have."""
    for one, other in zip(moments[::2], moments[1::2], strict=False):
        for first in one.wrenches:
            for second in other.wrenches:
                if first.name == second.name:
                    yield _grip_force(one, other, first, second)


def _grip_force(
    one: SensorMoment, other: SensorMoment, first: WrenchSourceSnapshot, second: WrenchSourceSnapshot
) -> GripForce:
    fingers, samples = (one.name, other.name), (first.sample, second.sample)
    known = [_has_force(moment, sample) for moment, sample in zip((one, other), samples, strict=True)]
    if samples[0] is None or samples[1] is None or not all(known):
        missing = ", ".join(name for name, is_known in zip(fingers, known, strict=True) if not is_known)
        return GripForce(fingers, first.name, None, np.nan, missing)
    force_n = -float(samples[0].wrench.force_n[2] + samples[1].wrench.force_n[2]) / 2
    return GripForce(fingers, first.name, force_n, float(samples[0].std[2] + samples[1].std[2]) / 2)


def _has_force(moment: SensorMoment, sample: WrenchWithUncertainty | None) -> bool:
    return sample is not None and not moment.status.is_past and not np.isinf(sample.std[2])


def sensor_group_status_html(moments: Sequence[SensorMoment]) -> str:
    """Return the state of every sensor as HTML, with its maximum indentation and contact area."""
    states = [(moment.name, moment.status.sentence, moment.status.tone, _format_measures(moment)) for moment in moments]
    return card_html("group_status", sensors=states)


def _format_measures(moment: SensorMoment) -> str:
    if moment.view is None:
        return ""
    summary = moment.view.summary
    return f"{format_max_indentation(summary)} mm, {summary.contact_area_mm2:.1f} mm²"


def group_wrench_table_html(moments: Sequence[SensorMoment]) -> str:
    """Return the grip forces, then the wrench of every sensor from every source as a row, with errors and warnings, as HTML."""
    if not any(moment.wrenches for moment in moments):
        return ""
    names_of_notice: dict[str, list[str]] = {}
    for moment in moments:
        for source in moment.wrenches:
            for notice in (*([str(source.trouble)] if source.trouble else []), *source.notices):
                names_of_notice.setdefault(notice, []).append(moment.name)
    return card_html(
        "group_wrench_table",
        grips=[(grip, *_format_grip(grip)) for grip in grip_forces(moments)],
        grip_colour=GRIP_COLOUR,
        sensors=[_sensor_rows(number, moment) for number, moment in enumerate(moments)],
        notices=[f"{', '.join(names)}: {notice}" for notice, names in names_of_notice.items()],
        meaning=dict.fromkeys(f"{one.name}: {one.meaning}" for moment in moments for one in moment.wrenches),
    )


def _format_grip(grip: GripForce) -> tuple[str, str]:
    if grip.force_n is None:
        return f"unknown without {grip.missing}", ""
    return f"{format_signed_hundredths(grip.force_n)} N", f"{grip.std_n:.2f}" if np.isfinite(grip.std_n) else ""


def _sensor_rows(number: int, moment: SensorMoment) -> tuple[object, ...]:
    """Return what the table says of one sensor: name, colour, whether it is past, warnings, and the wrench of each source."""
    known = [(source.name, source.sample) for source in moment.wrenches if source.sample is not None]
    warnings = dict.fromkeys(warning for _, sample in known for warning in sample.warnings)
    wrenches = [(name, [format_component(sample, axis, "?") for axis in range(6)]) for name, sample in known]
    return moment.name, colour_of_sensor(number), moment.status.is_past, warnings, wrenches


def colour_of_sensor(number: int) -> str:
    """Return the colour of a sensor in table and plot."""
    return SENSOR_COLOURS[number % len(SENSOR_COLOURS)]
