"""Member k of a seed: the same whichever others are asked for."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from typing import Any

import msgspec
import numpy as np

from ninedtact.design import Gel, SensorDesign
from ninedtact.mechanics.contact import Contact
from ninedtact.simulation.designed import lit_alike
from ninedtact.simulation.image import Renderer
from ninedtact.simulation.light import Light
from ninedtact.simulation.noise import Noise
from ninedtact.simulation.population.mechanics import Kind, compliance_below, drawn_base, felt
from ninedtact.simulation.population.parts import (
    Kinds,
    Misreading,
    PopulationImpossible,
    Untouched,
    drawn_misreading,
    drawn_untouched,
)
from ninedtact.simulation.population.spread import drawn_gel, drawn_lens, drawn_light
from ninedtact.simulation.twin import PITCH_MM, Twin
from ninedtact.simulation.untouched import untouched_image
from ninedtact.simulation.view import View, WideLens

RAW_SHAPE = (480, 640)
GOLDEN = 0.618034
"""Its multiples, modulo one, fill the unit evenly from the first on: shares hold among few members too."""


@dataclass(frozen=True)
class SensorMember:
    """All numbers of one sensor."""

    name: str
    kind: Kind
    gel: Gel
    base: Gel | None
    """What the gel lies on, where that yields."""
    friction: float
    light: Light
    lens: WideLens
    noise_grey_levels: float
    untouched: Untouched
    misreading: Misreading = field(default_factory=Misreading)
    design: SensorDesign = SensorDesign()
    """What it was meant to be."""

    @property
    def view(self) -> View:
        """Of the raw image."""
        return self.lens.view(RAW_SHAPE)

    def renderer(self) -> Renderer:
        """To raw images."""
        view = self.view
        return Renderer(
            view,
            untouched_image(lit_alike(view, self.design), **asdict(self.untouched)),
            self.light,
            Noise(self.noise_grey_levels, RAW_SHAPE),
        )

    def twin(self, pitch_mm: float = PITCH_MM) -> Twin:
        """Ready to be pressed and looked at."""
        yields = self.gel.thickness_mm + (self.base.thickness_mm if self.base else 0.0)
        return Twin(
            self.name,
            compliance_below(self.gel, self.base),
            self.renderer(),
            self.friction,
            pitch_mm,
            area_mm=self.design.sensing_area.size_mm,
            thickness_mm=yields,
            gel_mm=self.design.sensing_area.gel_mm,
            felt=self.felt,
        )

    def felt(self, contact: Contact) -> Contact:
        """As it is seen and weighed: what the twin solved, corrected where this member's mechanics are not linear."""
        return felt(contact, self.kind, self.gel)

    def as_table(self) -> dict[str, Any]:
        """Plain numbers, for JSON; `member_from` reads them back."""
        return asdict(self)


def member_from(table: dict[str, Any]) -> SensorMember:
    """The sensor that `as_table` wrote."""
    return msgspec.convert(table, SensorMember)


def member(number: int, seed: int = 0, kinds: Kinds = Kinds(), design: SensorDesign = SensorDesign()) -> SensorMember:
    """Draw one sensor of this design; raises `PopulationImpossible` for numbers below zero."""
    if number < 0 or seed < 0:
        raise PopulationImpossible(f"expected number and seed of zero or more, got {number} and {seed}; correct them")
    rng = np.random.default_rng([seed, number])
    kind = kinds.at((0.5 + GOLDEN * number) % 1)
    gel = drawn_gel(rng, design.gel)
    base = drawn_base(rng, gel)
    return SensorMember(
        name=f"twin_{seed}_{number:03d}",
        kind=kind,
        gel=gel,
        base=base if kind == "compliant_base" else None,
        friction=float(rng.uniform(0.5, 1.2)),
        light=drawn_light(rng, gel.thickness_mm, design),
        lens=drawn_lens(rng, design),
        noise_grey_levels=float(rng.uniform(0.5, 1.0)),
        untouched=drawn_untouched(rng),
        misreading=drawn_misreading(rng),
        design=design,
    )


def population(seed: int = 0, kinds: Kinds = Kinds()) -> Iterator[SensorMember]:
    """All members of a seed, without end."""
    number = 0
    while True:
        yield member(number, seed, kinds)
        number += 1
