"""The skins of several sensors, all on one grid, stacked on one device."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from array_api_compat import device
from jaxtyping import Bool

from ninedtact.mechanics.array_namespace import array_namespace_of
from ninedtact.mechanics.batching import expand_over_grid
from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.contact_model import ContactModel
from ninedtact.mechanics.skin import DisplacementOperators, Skin
from ninedtact.simulation.batched.requests import Bench
from ninedtact.simulation.batched.windows import Rectangle


@dataclass(frozen=True)
class Skins:
    """What each sensor's skin does under tractions."""

    benches: Sequence[Bench]
    like: Any
    softest: dict[tuple[int, tuple[int, int]], float] = field(default_factory=dict)
    """The largest compliance to shear of a sensor's window, as far as any was asked for."""

    @cached_property
    def numbers(self) -> dict[Bench, int]:
        """Of the sensors."""
        return {bench: number for number, bench in enumerate(self.benches)}

    @property
    def processor(self) -> list[Skin]:
        """As they are in NumPy."""
        return [bench.twin.model.skin for bench in self.benches]

    @cached_property
    def here(self) -> list[Skin]:
        """The same on the device."""
        return [replace(skin, like=self.like) for skin in self.processor]

    @property
    def grid(self) -> Skin:
        """Any of them: for what they share, which is places and waves."""
        return self.here[0]

    @cached_property
    def blank(self) -> Contact:
        """Untouched."""
        return ContactModel(self.grid).untouched()

    @cached_property
    def symbols(self) -> tuple[Any, Any, Any, Any]:
        """N, bulge, and the tangential block's diagonal and crossed part, of all sensors."""
        responses = [skin.response for skin in self.processor]
        stacks = (
            [one.normal for one in responses],
            [one.bulge for one in responses],
            [one.tangential[0] for one in responses],
            [one.tangential[1][None] for one in responses],
        )
        xp = array_namespace_of(self.like)
        normal, bulge, diagonal, crossed = (xp.asarray(np.stack(stack), device=device(self.like)) for stack in stacks)
        return normal, bulge, diagonal, crossed

    def response(
        self, which: Sequence[int], windows: Sequence[Rectangle], inside: Bool[Any, "batch rows cols"]
    ) -> DisplacementOperators:
        """Of one skin for each contact of a batch, each answering within its own window."""
        xp, shape = array_namespace_of(self.like), self.grid.patch.shape
        numbers = xp.asarray(np.array(which), device=device(self.like))
        normal, bulge, diagonal, crossed = (xp.take(symbol, numbers, axis=0) for symbol in self.symbols)
        softest = [self.softest_of(number, window.shape) for number, window in zip(which, windows, strict=True)]
        return DisplacementOperators(
            *(normal, bulge, (diagonal, crossed), shape, shape),
            softest_mm_per_mpa=expand_over_grid(np.array(softest), self.like)[..., None],
            inside=xp.astype(inside, self.like.dtype),
        )

    def softest_of(self, number: int, shape: tuple[int, int]) -> float:
        """The largest compliance to shear, as the window alone would have it: the first stride of the search depends on it."""
        if (number, shape) not in self.softest:
            skin = self.benches[number].twin.model.skin
            response = skin.response if shape == skin.patch.shape else skin.new_window(*shape)
            self.softest[number, shape] = response.softest_mm_per_mpa
        return self.softest[number, shape]
