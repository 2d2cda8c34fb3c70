"""A broken rule, and the refusal of a design that breaks some."""

from collections.abc import Iterable
from dataclasses import dataclass

from ninedtact.design import DesignImpossible


@dataclass(frozen=True)
class Broken:
    """One rule that a design breaks."""

    rule: str
    """Its name: `wall_too_thin`."""
    sentence: str
    """Expected, got, do this."""


class RulesBroken(DesignImpossible):
    """A design that cannot be built; `broken` names every rule."""

    def __init__(self, broken: Iterable[Broken]) -> None:
        self.broken = tuple(broken)
        super().__init__("; also ".join(f"{each.sentence} (rule {each.rule})" for each in self.broken))
