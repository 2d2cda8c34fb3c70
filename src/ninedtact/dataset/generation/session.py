"""One sensor for some fifty pairs: untouched skin, light touches, and what the sampling rule keeps of longer ones."""

from dataclasses import dataclass, field

import numpy as np

from ninedtact.capture.sampling_rule import SamplingRule
from ninedtact.dataset.generation.deck import dealt, object_of
from ninedtact.dataset.generation.pair import Kind, Pair, png, quotas
from ninedtact.dataset.generation.settings import DatasetImpossible, DatasetSettings
from ninedtact.dataset.generation.touch import Touch
from ninedtact.simulation.batched.requests import Asking, Bench, Felt, Look
from ninedtact.simulation.rectified import mm_per_px

STEP_NS = 100_000_000
"""Between two steps of a touch: ten a second."""
LIGHTEST_N = 0.02
VAIN_TOUCHES = 30
"""In a row, after which there is no hope."""


@dataclass
class Session:
    """Session `number` of a data set: the same whichever others are made, and whoever answers it."""

    number: int
    settings: DatasetSettings
    bench: Bench
    """Sensors take turns."""
    made: list[Pair] = field(default_factory=list, init=False)
    touches: int = field(default=0, init=False)
    steps: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng([self.settings.seed, 1, self.number])
        self.rule = SamplingRule(self.settings.rule, self.rng)
        self.left = quotas(self.number, self.settings)

    def asking(self) -> Asking[list[Pair]]:
        """All pairs of the session; raises `DatasetImpossible` where nothing can be collected."""
        deck = dealt(self.settings, self.number)
        vain = 0
        while any(self.left.values()):
            before = len(self.made)
            yield from self.one_touch(next(deck))
            vain = vain + 1 if len(self.made) == before else 0
            if vain > VAIN_TOUCHES:
                raise DatasetImpossible(
                    f"expected pairs from presses, got none from {VAIN_TOUCHES} of them; press harder, or loosen the rule"
                )
        return self.made

    def one_touch(self, name: str) -> Asking[None]:
        """The skin before it, then one object's touch, as long as pairs of its kinds are missing."""
        self.touches += 1
        if self.left["no_contact"]:
            yield from self.keep(None, "none", "no_contact")
        if self.left["light_touch"]:
            touch = self.touch(name)
            felt = yield from touch.lightly(float(self.rng.uniform(LIGHTEST_N, self.settings.light_below_n)))
            if felt and self.is_light(felt):
                yield from self.keep(felt, name, "light_touch")
        if self.left["rule"]:
            self.touches += 1
            yield from self.kept(name)

    def kept(self, name: str) -> Asking[None]:
        """What the rule keeps of one touch."""
        self.rule.end_contact()
        touch = self.touch(name)
        for aim in touch.aims():
            felt = yield from touch.stepped(aim)
            if felt is None:
                return
            self.steps += 1
            if self.rule.keeps(felt.wrench):
                yield from self.keep(felt, name, "rule")
            if not self.left["rule"]:
                return

    def touch(self, name: str) -> Touch:
        """An object in the hand."""
        return Touch(self.bench, object_of(name, self.settings.objects_seed), self.settings.hand, self.rng)

    def is_light(self, felt: Felt) -> bool:
        """Whether it weighs as little as it was meant to: gel that stiffens weighs more."""
        return bool(-self.settings.light_below_n < felt.wrench.force_n[2] < 0)

    def keep(self, felt: Felt | None, name: str, kind: Kind) -> Asking[None]:
        """What is seen and weighed now."""
        self.left[kind] -= 1
        six = felt.wrench.six if felt else np.zeros(6)
        factor = yield Look(self.bench, felt.seen if felt else None)
        sensor = self.bench.member.name
        pair = Pair(
            png(self.bench.eye.shot(factor, self.rng)),
            *(sensor, six.astype(np.float32), name, f"{self.number:05d}-{self.touches:03d}"),
            *(self.steps, self.steps * STEP_NS, sensor, kind),
            mm_per_px(self.settings.size, self.settings.design),
        )
        self.made.append(pair)
