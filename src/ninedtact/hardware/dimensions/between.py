"""Ranges that dimensions state beside their type: `Annotated[float, Between(0.8, 6.0)]`."""

from dataclasses import dataclass, fields
from typing import Any, get_type_hints

from ninedtact.design import DesignImpossible


@dataclass(frozen=True)
class Between:
    """From the smallest to the largest value that can be made."""

    smallest: float
    largest: float


def require_between(part: Any) -> None:
    """Refuse a dimension out of its range; raises `DesignImpossible`."""
    hints = get_type_hints(type(part), include_extras=True)
    for field in fields(part):
        for limits in getattr(hints[field.name], "__metadata__", ()):
            if isinstance(limits, Between):
                require_one(f"{named(part)}.{field.name}", getattr(part, field.name), limits)


def require_one(name: str, value: float | tuple[float, ...], limits: Between) -> None:
    """The same for one dimension, or for each of several."""
    for each in value if isinstance(value, tuple) else (value,):
        if not limits.smallest <= each <= limits.largest:
            raise DesignImpossible(
                f"expected {name} from {limits.smallest:g} to {limits.largest:g}, got {each:g}; correct the design"
            )


def named(part: Any) -> str:
    """A part as files name it: `LedBody` is `led_body`."""
    return "".join(f"_{letter.lower()}" if letter.isupper() else letter for letter in type(part).__name__).lstrip("_")
