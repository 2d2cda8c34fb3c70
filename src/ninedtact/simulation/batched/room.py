"""The questions of many sessions, answered in batches on one device; in smaller ones when its memory runs out."""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from array_api_compat import to_device

from ninedtact.errors import DeviceError
from ninedtact.simulation.batch import BatchRenderer
from ninedtact.simulation.batched.device import Device, ran_out
from ninedtact.simulation.batched.judging import Judge, Told, refused_before
from ninedtact.simulation.batched.objects import Shelf
from ninedtact.simulation.batched.requests import Asked, Bench, Factor, Look, Step
from ninedtact.simulation.batched.skins import Skins
from ninedtact.simulation.batched.steps import Steps
from ninedtact.simulation.batched.weighing import stacked


class DeviceMemoryExhausted(DeviceError):
    """Not even one contact fits in the memory of the device."""


@dataclass
class Room:
    """Some sensors side by side, with many hands at work."""

    numbers: Sequence[int]
    """Of the sensors in the population."""
    benches: Sequence[Bench]
    device: Device
    at_once: int
    """Most contacts of one batch; halved when memory runs out."""
    tell: Callable[[str], None]
    shelf: Shelf = field(init=False)
    skins: Skins = field(init=False)
    eyes: dict[Bench, BatchRenderer] = field(default_factory=dict, init=False)
    said: str = field(default="", init=False)
    """By torch, when memory ran out."""

    def __post_init__(self) -> None:
        like = self.device.like()
        self.shelf, self.skins = Shelf(like), Skins(self.benches, like)

    def bench(self, number: int) -> Bench:
        """The sensor of this number."""
        return self.benches[self.numbers.index(number)]

    def answers(self, asked: Sequence[Asked]) -> list[Any]:
        """To steps, or to looks. An answer that is itself a question is to be asked in its place."""
        answers: list[Any] = []
        while len(answers) < len(asked):
            part = asked[len(answers) :][: self.at_once]
            tried = self.tried(part)
            if tried is None:
                self.halve(len(part))
            else:
                answers += tried
        return answers

    def tried(self, asked: Sequence[Asked]) -> list[Any] | None:
        """The answers, or none where memory ran out. (An error keeps all arrays that led to it; it ends here.)"""
        try:
            return self.answered(asked)
        except RuntimeError as trouble:
            if not ran_out(trouble):
                raise
            self.said = str(trouble).partition("\n")[0]
            return None

    def halve(self, many: int) -> None:
        """Smaller batches from now on; raises `DeviceMemoryExhausted` when there is nothing to halve."""
        if many == 1:
            raise DeviceMemoryExhausted(
                f"expected room for one contact in the memory of {self.device.name}, got {self.said!r}; end what else uses it, "
                f"or give a coarser --pitch-mm, or --device cpu"
            )
        self.at_once = many // 2
        self.device.freed()
        self.tell(
            f"the memory of {self.device.name} is too small for {many} contacts at once; going on with {many // 2}"
        )

    def answered(self, asked: Sequence[Asked]) -> list[Any]:
        """One batch."""
        looks = [look for look in asked if isinstance(look, Look)]
        return self.shown(looks) if looks else self.stepped([step for step in asked if isinstance(step, Step)])

    def stepped(self, steps: Sequence[Step]) -> list[Told]:
        """What every hand feels, or why it cannot."""
        refusals = [refused_before(step) for step in steps]
        going = [step for step, refusal in zip(steps, refusals, strict=True) if refusal is None]
        told = iter(Judge(Steps(going, self.skins, self.shelf)).told() if going else [])
        return [next(told) if refusal is None else refusal for refusal in refusals]

    def shown(self, looks: Sequence[Look]) -> list[Factor | None]:
        """What every eye sees, sensor by sensor."""
        factors: list[Factor | None] = [None] * len(looks)
        of_bench: dict[Bench, list[int]] = defaultdict(list)
        for number, look in enumerate(looks):
            if look.seen is not None:
                of_bench[look.bench].append(number)
        for bench, numbers in of_bench.items():
            contacts = stacked([seen for k in numbers if (seen := looks[k].seen) is not None])
            shown = np.asarray(to_device(self.eye(bench).factors(contacts), "cpu"), np.float32)
            for number, factor in zip(numbers, shown, strict=True):
                factors[number] = factor
        return factors

    def eye(self, bench: Bench) -> BatchRenderer:
        """Of this sensor, for many contacts."""
        if bench not in self.eyes:
            self.eyes[bench] = BatchRenderer(bench.eye.renderer, self.skins.like)
        return self.eyes[bench]
