"""How annotations are checked while the tests run: the arguments and the answer of every call, each of them once.

`jaxtyping.jaxtyped` binds the arguments of a call to its signature and checks them twice, before the call and beside its answer. A
quarter of the time of all tests passed with that.
"""

import dataclasses
import inspect
from collections.abc import Callable
from functools import wraps
from types import FunctionType
from typing import Any, get_args, get_type_hints

from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, config, jaxtyped

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""With the numeric tower, as mypy has it: an int is a float."""


def check_calls(*, typechecker: Callable[..., Any]) -> Callable[[Any], Any]:
    """Return a decorator that does what `jaxtyped(typechecker=typechecker)` does, in less time for functions."""

    def decorate(item: Any) -> Any:
        if isinstance(item, classmethod | staticmethod):
            return type(item)(decorate(item.__func__))
        if isinstance(item, property):
            return property(*(method and decorate(method) for method in (item.fget, item.fset, item.fdel)))
        if dataclasses.is_dataclass(item) and "__init__" in vars(item) and not hasattr(item.__init__, "__wrapped__"):
            item.__init__ = decorate(item.__init__)
        if inspect.isclass(item):
            return item
        if not inspect.isfunction(item) or inspect.isgeneratorfunction(item) or inspect.iscoroutinefunction(item):
            return jaxtyped(item, typechecker=typechecker)
        hints = {name: _resolve(hint, item.__globals__) for name, hint in item.__annotations__.items()}
        checked_item = typechecker(_with_annotations(item, hints))
        if any(map(_names_arrays, hints.values())):
            checked_item = _in_context_of_axes(checked_item)

        @wraps(item)
        def call(*args: Any, **kwargs: Any) -> Any:
            return (item if config.jaxtyping_disable else checked_item)(*args, **kwargs)

        return call

    return decorate


def _in_context_of_axes(function: Callable[..., Any]) -> Callable[..., Any]:
    """An axis has one length in the arguments and in the answer of a call."""

    def call(*args: Any, **kwargs: Any) -> Any:
        with jaxtyped("context"):
            return function(*args, **kwargs)

    return call


def _resolve(hint: Any, names: dict[str, Any]) -> Any:
    """A name that is only known to type checkers stands for anything."""

    def holder(value: hint) -> None: ...

    try:
        return get_type_hints(holder, names, include_extras=True)["value"]
    except Exception:
        return Any


def _with_annotations(function: FunctionType, annotations: dict[str, Any]) -> FunctionType:
    copy = FunctionType(
        function.__code__, function.__globals__, function.__name__, function.__defaults__, function.__closure__
    )
    copy.__kwdefaults__ = function.__kwdefaults__
    copy.__annotations__ = annotations
    copy.__module__, copy.__qualname__ = function.__module__, function.__qualname__
    return copy


def _names_arrays(hint: Any) -> bool:
    return (inspect.isclass(hint) and issubclass(hint, AbstractArray)) or any(map(_names_arrays, get_args(hint)))
