"""The kinds of mechanics that simulated sensors have, and the share of each."""

from dataclasses import dataclass
from typing import Literal

from ninedtact.errors import InputError

MechanicsKind = Literal["layered", "rigid_base", "linear"]
"""Neo-Hookean gel on a base that yields; the same on a rigid base; a linear layer on a rigid base."""


@dataclass(frozen=True)
class MechanicsShares:
    """Shares of sensors that do not have a neo-Hookean gel on a base that yields."""

    rigid_base: float = 0.2
    """Share of sensors whose gel lies on a rigid base."""
    linear: float = 0.1
    """Share of sensors with a linear gel on a rigid base, which does not stiffen as it thins."""

    def __post_init__(self) -> None:
        if not (min(self.rigid_base, self.linear) >= 0 and self.rigid_base + self.linear <= 1):
            raise InputError(
                expected="shares of sensors from 0 to 1, together at most 1",
                got=f"{self.rigid_base} on a rigid base and {self.linear} with a linear gel",
                remedy="correct them",
            )

    def kind_at(self, quantile: float) -> MechanicsKind:
        """Return the kind at a quantile, 0 to 1."""
        if quantile < self.rigid_base:
            return "rigid_base"
        return "linear" if quantile < self.rigid_base + self.linear else "layered"
