"""Bounds that dimensions state beside their type: `Annotated[float, Bounds(0.8, 6.0)]`."""

from dataclasses import dataclass, fields
from typing import Any, get_type_hints

from ninedtact.design import DesignImpossible


@dataclass(frozen=True)
class Bounds:
    """The smallest and the largest value of a dimension that can be manufactured."""

    smallest: float
    largest: float


def require_within_bounds(table: str, dimensions: Any) -> None:
    """Refuse a dataclass in which a dimension, or one of several in a tuple, is out of its bounds.

    table: its name in the design file, for the message. Raises `DesignImpossible`.
    """
    hints = get_type_hints(type(dimensions), include_extras=True)
    for field in fields(dimensions):
        value = getattr(dimensions, field.name)
        for bounds in getattr(hints[field.name], "__metadata__", ()):
            for number in value if isinstance(value, tuple) else (value,):
                if isinstance(bounds, Bounds) and not bounds.smallest <= number <= bounds.largest:
                    raise DesignImpossible(
                        f"expected {table}.{field.name} from {bounds.smallest:g} to {bounds.largest:g}, got {number:g}; "
                        "correct the design"
                    )
