"""Dimensions of each part: frozen dataclasses in which every field states its bounds and its reason. Lengths in mm.

Tables of a design file go in, checked dimensions come out: `made_parts` (base, shell, isolation ring, window, calibration board,
gels and moulds), `bought_parts` (camera, LED board, fasteners). Bounds stand beside the type: `Annotated[float, Bounds(0.8, 6.0)]`.
"""

from dataclasses import dataclass
from typing import ClassVar, get_type_hints

from ninedtact.design import DesignImpossible


@dataclass(frozen=True)
class Bounds:
    """The smallest and the largest value of a dimension that can be manufactured."""

    smallest: float
    largest: float


class BoundedDimensions:
    """Base of a frozen dataclass of dimensions, none of which may be out of its bounds.

    table: its name in the design file, for the message. Creation raises `DesignImpossible`.
    """

    _table: ClassVar[str]

    def __init_subclass__(cls, table: str) -> None:
        cls._table = table

    def __post_init__(self) -> None:
        """Refuse a dimension, or one of several in a tuple, that is out of its bounds."""
        hints = get_type_hints(type(self), include_extras=True)
        for name, value in vars(self).items():
            for bounds in getattr(hints[name], "__metadata__", ()):
                for number in value if isinstance(value, tuple) else (value,):
                    if not bounds.smallest <= number <= bounds.largest:
                        raise DesignImpossible(
                            f"expected {self._table}.{name} from {bounds.smallest:g} to {bounds.largest:g}, got {number:g}; "
                            "correct the design"
                        )
