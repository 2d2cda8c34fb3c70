"""Everything that is known of a built design: what is checked, listed and exported."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from ninedtact.hardware.assembly.bodies import Body, bodies
from ninedtact.hardware.assembly.pairs import Meeting, meetings
from ninedtact.hardware.bom import Item, bill, cost_usd
from ninedtact.hardware.clearances import Clearance, clearances
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.disagreements import DISAGREEMENTS
from ninedtact.hardware.figures import DIGIT, PAPER, SensorFigures, sensor_figures, table_one
from ninedtact.hardware.led_board.check import problems, sound_layout
from ninedtact.hardware.led_board.layout import Layout
from ninedtact.hardware.mounted_board import led_board_of
from ninedtact.hardware.optics import corner_mm, reach_mm
from ninedtact.hardware.parts.catalogue import BuiltPart, built
from ninedtact.hardware.rules.book import require_buildable


@dataclass(frozen=True)
class BuiltSensor:
    """A design that keeps all rules and for which there is a LED board; its solids are built when they are first asked for.

    Raises `RulesBroken`, `BoardImpossible`.
    """

    design: HardwareDesign

    def __post_init__(self) -> None:
        require_buildable(self.design)
        _ = self.circuit

    @cached_property
    def parts(self) -> dict[str, BuiltPart]:
        """By name."""
        return built(self.design)

    @cached_property
    def bodies(self) -> list[Body]:
        """Of the finished sensor."""
        return bodies(self.design, self.parts)

    @cached_property
    def meetings(self) -> list[Meeting]:
        """Pairs of bodies that are near each other."""
        return [*meetings(self.bodies)]

    @property
    def interferences(self) -> list[Meeting]:
        """Pairs that claim the same room."""
        return [meeting for meeting in self.meetings if meeting.interferes]

    @cached_property
    def clearances(self) -> list[Clearance]:
        """Room between parts, by their dimensions."""
        return [*clearances(self.design)]

    @cached_property
    def circuit(self) -> Layout:
        """The LED board that fits."""
        return sound_layout(led_board_of(self.design))

    @cached_property
    def bill(self) -> list[Item]:
        """Of materials."""
        return bill(self.design, {name: part.volume_mm3 for name, part in self.parts.items()})

    @cached_property
    def figures(self) -> SensorFigures:
        """As a row of the paper's table."""
        return sensor_figures(self.design, (body.mass_g for body in self.bodies), cost_usd(self.bill))

    def as_table(self) -> dict[str, Any]:
        """For scripts."""
        return {
            "variant": self.design.variant,
            "figures": {**asdict(self.figures), "ratio_mm": self.figures.ratio_mm},
            "paper": {**asdict(PAPER), "ratio_mm": PAPER.ratio_mm},
            "others": [{**asdict(DIGIT), "ratio_mm": DIGIT.ratio_mm}],
            "lens_reach_mm": reach_mm(self.design),
            "corner_mm": corner_mm(self.design),
            "interferences": [asdict(meeting) for meeting in self.interferences],
            "meetings": [asdict(meeting) for meeting in self.meetings],
            "led_board_faults": [*map(str, problems(self.circuit))],
            "clearances": [{**asdict(room), "tight": room.tight} for room in self.clearances],
            "masses_g": {body.name: body.mass_g for body in self.bodies},
            "disagreements": [asdict(each) for each in DISAGREEMENTS],
        }

    def lines(self) -> Iterator[str]:
        """For a person."""
        tight = sum(room.tight for room in self.clearances)
        kept = f"no rule broken, but {tight} clearances are tight" if tight else "all rules kept"
        yield f"design {self.design.variant}: {kept}; {len(self.bodies)} bodies"
        yield from interference_lines(self)
        faults = problems(self.circuit)
        yield f"  the LED board breaks {len(faults)} of its own rules{f', the first {faults[0]}' if faults else ''}"
        yield from clearance_lines(self.clearances)
        yield f"the lens reaches {reach_mm(self.design):.2f} mm, the sensing area's corner is at {corner_mm(self.design):.2f} mm"
        yield "beside the paper and others (masses of this design by assumed densities, its cost by estimated prices):"
        yield from ("  " + line for line in table_one((PAPER, self.figures, DIGIT)))
        yield "where the paper and its files disagree (here: the published size):"
        for each in DISAGREEMENTS:
            yield f"  {each.thing}: paper {each.paper or 'says nothing'}; files {each.files}; here {each.here}"


def interference_lines(sensor: BuiltSensor) -> Iterator[str]:
    """Pairs that overlap, and those that are meant to."""
    for pair in sensor.interferences:
        yield f"  INTERFERES: {pair.first} and {pair.second} share {pair.shared_mm3:.3f} mm³"
    meant = sum(pair.shared_mm3 > 0 and pair.meant for pair in sensor.meetings)
    many = len(sensor.interferences)
    yield f"  {'1 pair interferes' if many == 1 else f'{many} pairs interfere'}; {meant} inserts are meant to melt into their bores"


def clearance_lines(rooms: list[Clearance]) -> Iterator[str]:
    """The table."""
    yield "clearances, mm (needed):"
    for room in rooms:
        yield f"  {room.mm:7.3f} ({room.least_mm:.2f}) {room.between}{'   TIGHT' if room.tight else ''}"
