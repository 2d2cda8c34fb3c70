"""ninedtact hardware bom: what to buy and to have made."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact.cli.hardware.described import Described
from ninedtact.cli.terminal import answer

if TYPE_CHECKING:
    from ninedtact.hardware.bom import Item


@dataclass(frozen=True)
class Bom:
    """List what one sensor is made of, and the tools that it takes, with estimated prices."""

    described: Annotated[Described, tyro.conf.arg(name="")] = Described()
    json: bool = False
    """Print the list as one JSON object."""

    def run(self) -> int:
        """Measure the parts, and list."""
        from ninedtact.hardware.bom import cost_usd

        items = self.described.built().bill
        table = {"items": [asdict(item) for item in items], "sensor_usd_estimated": cost_usd(items)}
        return answer(self.json, table, lines(items))


def lines(items: "list[Item]") -> Iterator[str]:
    """For a person."""
    from ninedtact.hardware.bom import cost_usd
    from ninedtact.hardware.figures import PAPER

    for kind, heading in (("sensor", "one sensor"), ("tool", "tools, once for many sensors")):
        yield heading
        yield from (
            f"  {item.count} x {item.name:20}{item.usd:7.2f} $  {item.what}" for item in items if item.kind == kind
        )
    yield f"one sensor: about {cost_usd(items):.2f} $ by estimated prices; the paper says about {PAPER.cost_usd:g} $"
