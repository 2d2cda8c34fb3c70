"""KiCad's coordinates, layers and net numbers."""

from dataclasses import dataclass
from uuid import NAMESPACE_URL, uuid5

from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.placement import Side
from ninedtact.hardware.led_board.sexpr import Expression, quoted

MIDDLE_MM = 148.5, 105.0
"""Of an A4 sheet."""
COPPER: dict[Side, str] = {"top": "F.Cu", "bottom": "B.Cu"}


@dataclass(frozen=True)
class Names:
    """Nets are numbered from one; zero is no net."""

    nets: list[str]

    def number(self, net: str) -> int:
        """Of a net."""
        return self.nets.index(net) + 1

    @property
    def declared(self) -> tuple[Expression, ...]:
        """The list of all."""
        return (("net", 0, quoted("")), *(("net", n + 1, quoted(net)) for n, net in enumerate(self.nets)))


def xy(word: str, place: Place) -> Expression:
    """A place on the sheet."""
    return (word, MIDDLE_MM[0] + place[0], MIDDLE_MM[1] - place[1])


def at(place: Place) -> Expression:
    """Where something is."""
    return xy("at", place)


def beside(word: str, place: Place, origin: Place) -> Expression:
    """A place told from another."""
    return (word, place[0] - origin[0], origin[1] - place[1])


def stamp(words: str) -> Expression:
    """An identity that stays the same."""
    return ("tstamp", str(uuid5(NAMESPACE_URL, f"ninedtact/led_board/{words}")))
