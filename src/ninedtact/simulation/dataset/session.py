"""One sensor for some fifty pairs: untouched skin, light touches, and what the sampling rule keeps of longer ones."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from ninedtact.capture.sampling_rule import SamplingRule
from ninedtact.mechanics.contact import Contact
from ninedtact.simulation.dataset.deck import dealt, object_of
from ninedtact.simulation.dataset.pair import Kind, Pair, png, quotas
from ninedtact.simulation.dataset.settings import DatasetImpossible, DatasetSettings
from ninedtact.simulation.dataset.touch import Touch
from ninedtact.simulation.population.member import SensorMember, member
from ninedtact.simulation.rectified import GreyEye, grey_eye
from ninedtact.simulation.twin import Twin

STEP_NS = 100_000_000
"""Between two steps of a touch: ten a second."""
LIGHTEST_N = 0.02
VAIN_TOUCHES = 30
"""In a row, after which there is no hope."""


@dataclass(frozen=True)
class Bench:
    """A sensor of the population, set up."""

    member: SensorMember
    twin: Twin
    eye: GreyEye


@lru_cache(maxsize=2)
def bench(number: int, settings: DatasetSettings) -> Bench:
    """The sensor of this number."""
    sensor = member(number, settings.seed, settings.kinds)
    return Bench(sensor, sensor.twin(settings.pitch_mm), grey_eye(sensor, settings.size))


@dataclass
class Session:
    """Session `number` of a data set: the same whichever others are made."""

    number: int
    settings: DatasetSettings
    touches: int = field(default=0, init=False)
    steps: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng([self.settings.seed, 1, self.number])
        self.rule = SamplingRule(self.settings.rule, self.rng)
        self.left = quotas(self.number, self.settings)

    @cached_property
    def bench(self) -> Bench:
        """Sensors take turns."""
        return bench(self.number % self.settings.sensors, self.settings)

    def pairs(self) -> Iterator[Pair]:
        """All pairs of the session; raises `DatasetImpossible` where nothing can be collected."""
        deck = dealt(self.settings, self.number)
        vain = 0
        while any(self.left.values()):
            before = sum(self.left.values())
            yield from self.one_touch(next(deck))
            vain = vain + 1 if sum(self.left.values()) == before else 0
            if vain > VAIN_TOUCHES:
                raise DatasetImpossible(
                    f"expected pairs from presses, got none from {VAIN_TOUCHES} of them; press harder, or loosen the rule"
                )

    def one_touch(self, name: str) -> Iterator[Pair]:
        """The skin before it, then one object's touch, as long as pairs of its kinds are missing."""
        self.touches += 1
        if self.left["no_contact"]:
            yield self.pair(None, "none", "no_contact")
        if self.left["light_touch"]:
            for contact in self.touch(name).lightly(float(self.rng.uniform(LIGHTEST_N, self.settings.light_below_n))):
                if self.is_light(contact):
                    yield self.pair(contact, name, "light_touch")
        if self.left["rule"]:
            self.touches += 1
            yield from self.kept(name)

    def kept(self, name: str) -> Iterator[Pair]:
        """What the rule keeps of one touch."""
        self.rule.lifted()
        for contact in self.touch(name).stations():
            self.steps += 1
            if self.rule.keeps(contact.wrench()):
                yield self.pair(contact, name, "rule")
            if not self.left["rule"]:
                return

    def touch(self, name: str) -> Touch:
        """An object in the hand."""
        indenter = object_of(name, self.settings.objects_seed)
        return Touch(self.bench.member, self.bench.twin, indenter, self.settings.hand, self.rng)

    def is_light(self, contact: Contact) -> bool:
        """Whether it weighs as little as it was meant to: gel that stiffens weighs more."""
        return bool(-self.settings.light_below_n < contact.wrench().force_n[2] < 0)

    def pair(self, contact: Contact | None, name: str, kind: Kind) -> Pair:
        """What is seen and weighed now."""
        self.left[kind] -= 1
        six = contact.wrench().six if contact else np.zeros(6)
        sensor = self.bench.member.name
        return Pair(
            png(self.bench.eye.picture(contact, self.rng)),
            *(sensor, six.astype(np.float32), name, f"{self.number:05d}-{self.touches:03d}"),
            *(self.steps, self.steps * STEP_NS, sensor, kind),
        )
