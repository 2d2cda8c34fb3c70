"""Types and bounds of arguments, settings and options, declared once beside the field or argument that they bound.

    @checks_arguments
    @dataclass(frozen=True)
    class CollectSettings:
        tolerance_ms: Annotated[float, Meta(gt=0, le=1000)] = 10.0
        ranges: tuple[Annotated[float, Meta(gt=0)], ...] = (6.0, 6.0, 12.0)
        schedule: Literal["constant", "one cycle"] = "one cycle"

`Meta` is that of msgspec, so that the same declaration is checked where a file is read (`checked_reading`) and shown where a
command line is made. Not-a-number is within no bounds. None is within all, where the type allows it.
"""

import re
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import fields, is_dataclass
from functools import cache, wraps
from inspect import formatannotation, signature
from numbers import Real
from operator import ge, gt, le, lt
from types import UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from beartype import BeartypeConf
from beartype.door import is_bearable
from msgspec import Meta

import ninedtact
from ninedtact.errors import InputError, NinedtactError

Checked = TypeVar("Checked", bound=Callable[..., Any])
_INTEGERS_ARE_NUMBERS = BeartypeConf(is_pep484_tower=True)
_MODULES = re.compile(r"\b(?:\w+\.)+(?=\w)")
_BOUNDED_KIND = re.compile(r"Annotated\[(.*?), Meta\([^()]*\)\]")
_COMPARISONS = (("ge", "of at least", ge), ("gt", "above", gt), ("le", "of at most", le), ("lt", "below", lt))
"""The attributes of `Meta`, the words for them, and what a value within the bound fulfils."""


def require_within_bounds(part: object, table: str = "", refusal: type[NinedtactError] = InputError) -> None:
    """Raise `refusal` for the first field of a dataclass whose value is of another type, or outside of the bounds beside it.

    table: name of the part in a file or of its settings, for the message.
    """
    place = f"{table}.{{}}" if table else "{}"
    for name, expected, got in _field_violations(part):
        raise refusal(expected=f"{place.format(name)} {expected}", got=got, remedy="correct it")


def require_options_within_bounds(command: object) -> None:
    """Raise `InputError` for the first option of a command, or of a group of options in it, whose value is out of its bounds."""
    for name, expected, got in _field_violations(command):
        raise InputError(expected=f"--{name.replace('_', '-')} {expected}", got=got, remedy="correct it")
    for group in vars(command).values():
        if is_dataclass(group):
            require_options_within_bounds(group)


def _field_violations(part: object) -> Iterator[tuple[str, str, str]]:
    kinds = _kinds(type(part))  # type: ignore[arg-type]  # classes are hashable
    for field in fields(part):  # type: ignore[arg-type]  # parts are dataclasses
        for expected, got in _violations(getattr(part, field.name), kinds[field.name]):
            yield field.name, expected, got


def checks_arguments(item: Checked) -> Checked:
    """Let a function of the Python API, or the constructor of a class, refuse what its annotations do not allow.

    Raises `InputError`, in one sentence, for an argument of another type or out of its bounds, and for arrays whose axes of one
    name differ in length.
    """
    if isinstance(item, type):
        item.__init__ = checks_arguments(item.__init__)  # type: ignore[misc]
        return item
    function: Callable[..., Any] = item
    names = tuple(signature(function).parameters)
    owner = function.__qualname__.removesuffix(".__init__").rpartition(".")[2]

    @wraps(function)
    def call(*arguments: Any, **named: Any) -> Any:
        kinds = _kinds(function)
        with _scope_of_axes():
            for name, value in (*zip(names, arguments, strict=False), *named.items()):
                for expected, got in _violations(value, kinds.get(name, Any)):
                    place = f"{name} of {owner}" if expected.startswith("to be") else name
                    raise InputError(expected=f"{place} {expected}", got=got, remedy="correct it")
        return function(*arguments, **named)

    return call  # type: ignore[return-value]


def _scope_of_axes() -> AbstractContextManager[Any]:
    """Return a block in which an axis of one name has one length.

    jaxtyping imports NumPy, which commands do without until they run; before it is there, no argument can be an array.
    """
    jaxtyping = sys.modules.get("jaxtyping")
    return nullcontext() if jaxtyping is None else jaxtyping.jaxtyped("context")


@cache
def _kinds(item: Callable[..., Any]) -> dict[str, Any]:
    """Return the types of a function's arguments, or of the fields of a class."""
    return get_type_hints(item, localns=_PublicNames(), include_extras=True)


class _PublicNames(dict[str, Any]):
    """What annotations may name that their module imports for type checkers alone."""

    def __missing__(self, name: str) -> Any:
        try:
            return getattr(ninedtact, name)
        except AttributeError:
            raise KeyError(name) from None


def _violations(value: Any, kind: Any) -> Iterator[tuple[str, str]]:
    """Yield what is expected and what is given in its place, in words, where a value has another type, or violates a bound."""
    if isinstance(value, Real) and hasattr(value, "item"):
        value = value.item()  # numbers of NumPy count as numbers
    for each in (value, tuple(value)) if isinstance(value, list) else (value,):  # a list counts as a tuple
        if is_bearable(each, kind, conf=_INTEGERS_ARE_NUMBERS):
            yield from _violated_bounds(each, kind)
            return
    yield f"to be {_describe_kind(kind)}", describe_value(value)


def _violated_bounds(value: Any, kind: Any) -> Iterator[tuple[str, str]]:
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is float and value != value:
        yield "to be a number", "nan"
    elif origin is Annotated:
        for meta in arguments[1:]:
            if isinstance(meta, Meta) and not _keeps(value, meta):
                yield describe_bounds(meta), describe_value(value)
        yield from _violated_bounds(value, arguments[0])
    elif origin is tuple:
        kinds = arguments[:1] * len(value) if Ellipsis in arguments else arguments
        for each, member in zip(value, kinds, strict=True):
            yield from _violated_bounds(each, member)
    elif origin in (Union, UnionType):
        members = (each for each in arguments if is_bearable(value, each, conf=_INTEGERS_ARE_NUMBERS))
        yield from min((list(_violated_bounds(value, each)) for each in members), key=len, default=())


def _describe_kind(kind: Any) -> str:
    """Return a type as a program would write it, without its modules and bounds."""
    if get_origin(kind) is Annotated:
        return _describe_kind(get_args(kind)[0])
    if get_origin(kind) is Literal:
        return f"one of {', '.join(map(repr, get_args(kind)))}"
    bare = _BOUNDED_KIND.sub(r"\1", _MODULES.sub("", formatannotation(kind)))
    return f"{bare} (axes of one name have one length)" if "ndarray" in bare else bare


def describe_value(value: Any) -> str:
    """Return a value in words, for the message that refuses it."""
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        return f"an array of {value.dtype} with shape {value.shape}"
    if isinstance(value, float):
        return f"{value:g}"
    if value is None or isinstance(value, str | bytes | int | tuple | list):
        return text if len(text := repr(value)) <= 60 else f"{text[:57]}..."
    return f"a {type(value).__name__}"


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
