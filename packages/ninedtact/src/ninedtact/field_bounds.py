"""Bounds of settings and dimensions, declared once beside the field that they bound, for objects and files alike.

    @dataclass(frozen=True)
    class CollectSettings:
        tolerance_ms: Annotated[float, Meta(gt=0, le=1000)] = 10.0
        ranges: tuple[Annotated[float, Meta(gt=0)], ...] = (6.0, 6.0, 12.0)
        schedule: Literal["constant", "one cycle"] = "one cycle"

        def __post_init__(self) -> None:
            require_within_bounds(self)

`Meta` is that of msgspec, so that the same declaration is checked where a file is read (`checked_reading.convert_tables_to_class`)
and shown where a command line is made. Not-a-number is within no bounds. None is within all, where the type allows it.
"""

from collections.abc import Iterator
from dataclasses import fields
from functools import cache
from numbers import Real
from operator import ge, gt, le, lt
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from msgspec import Meta

from ninedtact.errors import InputError, NinedtactError

_COMPARISONS = (("ge", "of at least", ge), ("gt", "above", gt), ("le", "of at most", le), ("lt", "below", lt))
"""The attributes of `Meta`, the words for them, and what a value within the bound fulfils."""


def require_within_bounds(part: object, table: str = "", refusal: type[NinedtactError] = InputError) -> None:
    """Raise `refusal` for the first field of a dataclass whose value is outside of the bounds or choices declared beside it.

    table: name of the part in a file or of its settings, for the message.
    """
    for name, kind in _bounded_fields(type(part)):  # type: ignore[arg-type]  # classes are hashable
        for expected, got in _violations(getattr(part, name), kind):
            place = f"{table}.{name}" if table else name
            raise refusal(expected=f"{place} {expected}", got=got, remedy="correct it")


@cache
def _bounded_fields(kind: type) -> tuple[tuple[str, Any], ...]:
    """Return name and type of every field that declares bounds or choices."""
    hints = get_type_hints(kind, include_extras=True)
    return tuple((field.name, hints[field.name]) for field in fields(kind) if _has_bounds(hints[field.name]))


def _has_bounds(kind: Any) -> bool:
    if get_origin(kind) is Literal:
        return True
    if any(isinstance(each, Meta) for each in getattr(kind, "__metadata__", ())):
        return True
    return any(map(_has_bounds, get_args(kind)))


def _violations(value: Any, kind: Any) -> Iterator[tuple[str, str]]:
    """Yield what is expected and what is given in its place, in words, for every bound that a value violates."""
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        if value not in arguments:
            yield f"to be one of {', '.join(map(repr, arguments))}", repr(value)
    elif origin is Annotated:
        for meta in arguments[1:]:
            if isinstance(meta, Meta) and not _keeps(value, meta):
                yield describe_bounds(meta), f"{value:g}" if isinstance(value, float) else repr(value)
        yield from _violations(value, arguments[0])
    elif origin is tuple:
        kinds = arguments[:1] * len(value) if Ellipsis in arguments else arguments
        for number, each in zip(value, kinds, strict=True):
            yield from _violations(number, each)
    elif origin in (Union, UnionType) and value is not None:
        members = [list(_violations(value, each)) for each in arguments if each is not NoneType]
        yield from min(members, key=len)


def _keeps(value: Any, meta: Meta) -> bool:
    """Return whether a value keeps all bounds; text keeps none, and neither does not-a-number."""
    if not isinstance(value, Real):
        return all(getattr(meta, name) is None for name, _, _ in _COMPARISONS)
    return all(keeps(value, bound) for name, _, keeps in _COMPARISONS if (bound := getattr(meta, name)) is not None)


def describe_bounds(meta: Meta) -> str:
    """Return the bounds in words, such as `from 0.3 to 15` or `above 0`."""
    if meta.ge is not None and meta.le is not None:
        return f"from {meta.ge:g} to {meta.le:g}"
    bounds = ((word, getattr(meta, name)) for name, word, _ in _COMPARISONS)
    return " and ".join(f"{word} {bound:g}" for word, bound in bounds if bound is not None)
