"""ninedtact hardware check: rules, interference, clearances, and the paper's figures beside this design's."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact.cli.hardware.described import Described
from ninedtact.cli.terminal import answer

if TYPE_CHECKING:
    from ninedtact.hardware.rules.rule import Broken


@dataclass(frozen=True)
class Check:
    """Say whether a design can be built: rules, interference, clearances; its figures beside the paper's Table I.

    Exits with 1 where a rule is broken or two parts claim the same room.
    """

    described: Annotated[Described, tyro.conf.arg(name="")] = Described()
    json: bool = False
    """Print everything as one JSON object."""

    def run(self) -> int:
        """Rules first; what keeps them is built and measured."""
        from ninedtact.hardware.rules.book import broken_rules

        if broken := broken_rules(self.described.hardware()):
            answer(self.json, {"broken": [asdict(each) for each in broken]}, broken_lines(broken))
            return 1
        sensor = self.described.built()
        answer(self.json, {"broken": [], **sensor.as_table()}, sensor.lines())
        return 1 if sensor.interferences else 0


def broken_lines(broken: "list[Broken]") -> Iterator[str]:
    """For a person."""
    yield f"{'1 rule' if len(broken) == 1 else f'{len(broken)} rules'} broken; nothing was built:"
    yield from (f"  {each.rule}: {each.sentence}" for each in broken)
