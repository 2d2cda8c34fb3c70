"""How annotations are checked while the tests run: at the first calls of every function, and at some of the later ones.

A quarter of the time of all tests would pass with checking calls of the same functions again and again.
"""

from collections.abc import Callable
from functools import wraps
from inspect import isfunction
from itertools import count
from typing import Any

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
"""With the numeric tower, as mypy has it: an int is a float."""

FIRST_CALLS = 50
EVERY = 50
"""Of the calls after the first ones, every fiftieth is checked."""


def check_some_calls(jaxtyped: Callable[..., Any]) -> Callable[..., Any]:
    """Return a decorator that is used like `jaxtyped`; classes are checked as before."""

    def decorator(*, typechecker: Callable[..., Any]) -> Callable[[Any], Any]:
        def decorate(function: Any) -> Any:
            with_checks = jaxtyped(function, typechecker=typechecker)
            if not isfunction(function):
                return with_checks
            calls = count()

            @wraps(function)
            def call(*args: Any, **kwargs: Any) -> Any:
                number = next(calls)
                is_checked = number < FIRST_CALLS or number % EVERY == 0
                return (with_checks if is_checked else function)(*args, **kwargs)

            return call

        return decorate

    return decorator
