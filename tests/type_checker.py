"""How annotations are checked while the tests run: the arguments and the answer of some calls of each function in a test.

A solver calls its inner functions ten thousand times with the same types. Of the calls of one function in one test, the first,
second, fourth, eighth and so on are checked.
"""

import dataclasses
import inspect
from collections.abc import Callable
from functools import wraps
from types import FunctionType
from typing import Any, get_type_hints

from beartype import BeartypeConf, beartype
from jaxtyping import config, jaxtyped

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""With the numeric tower, as mypy has it: an int is a float."""

_calls: dict[int, int] = {}
"""How often the code of each function was called since the test began."""


def begin_test() -> None:
    """Check all functions anew."""
    _calls.clear()


def check_calls(*, typechecker: Callable[..., Any]) -> Callable[[Any], Any]:
    """Return a decorator that does for the calls that are checked what `jaxtyped(typechecker=typechecker)` does."""

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
        code, checked_item = id(item.__code__), None

        @wraps(item)
        def call(*args: Any, **kwargs: Any) -> Any:
            nonlocal checked_item
            number = _calls[code] = _calls.get(code, 0) + 1
            if number & (number - 1) or config.jaxtyping_disable:
                return item(*args, **kwargs)
            if checked_item is None:
                checked_item = typechecker(_with_known_types(item))
            with jaxtyped("context"):  # an axis has one length in the arguments and in the answer of a call
                return checked_item(*args, **kwargs)

        return call

    return decorate


def _with_known_types(function: FunctionType) -> FunctionType:
    """Return a copy in whose annotations a name that is only known to type checkers stands for anything."""
    copy = FunctionType(
        function.__code__, function.__globals__, function.__name__, function.__defaults__, function.__closure__
    )
    copy.__kwdefaults__ = function.__kwdefaults__
    copy.__annotations__ = {
        name: _resolve(hint, function.__globals__) for name, hint in function.__annotations__.items()
    }
    copy.__module__, copy.__qualname__ = function.__module__, function.__qualname__
    return copy


def _resolve(hint: Any, names: dict[str, Any]) -> Any:
    def holder(value: hint) -> None: ...

    try:
        return get_type_hints(holder, names, include_extras=True)["value"]
    except Exception:
        return Any
