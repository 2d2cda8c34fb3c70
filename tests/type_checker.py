"""How annotations are checked while the tests run: the arguments and the answer of every call, each of them once.

`jaxtyping.jaxtyped` binds the arguments of a call to its signature and checks them twice, before the call and beside its answer. A
quarter of the time of all tests passed with that.
"""

import dataclasses
import inspect
import re
from collections.abc import Callable
from functools import wraps
from types import CellType, FunctionType
from typing import Any, get_args, get_origin, get_type_hints

from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray, config, jaxtyped
from jaxtyping._storage import get_shape_memo

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
        checked_item, names_arrays = _check_item(item, typechecker)

        @wraps(item)
        def call(*args: Any, **kwargs: Any) -> Any:
            return (item if config.jaxtyping_disable else checked_item)(*args, **kwargs)

        @wraps(item)
        def call_with_arrays(*args: Any, **kwargs: Any) -> Any:
            """An axis has one length in the arguments and in the answer of a call."""
            if config.jaxtyping_disable:
                return item(*args, **kwargs)
            with _OWN_AXES:
                return checked_item(*args, **kwargs)

        return call_with_arrays if names_arrays else call

    return decorate


_OWN_AXES = jaxtyped("context")
"""While it is entered, axes have lengths of their own; it keeps nothing itself, so that one serves all calls."""

_inner_functions: dict[Any, tuple[Callable[..., Any], bool]] = {}
"""Checked copies of functions within functions, without what they close over: each call of the outer one defines them anew, and
beartype takes a millisecond to write the checks of one."""


def _check_item(item: FunctionType, typechecker: Callable[..., Any]) -> tuple[Callable[..., Any], bool]:
    """Return the function with its calls checked, and whether an annotation names an array."""
    hints = tuple((name, _structure(hint)) for name, hint in item.__annotations__.items())
    key = item.__module__, item.__code__, hints, typechecker
    if "<locals>" not in item.__qualname__ or not _is_hashable(key):
        return _write_checks(item, typechecker)
    if key not in _inner_functions:
        _inner_functions[key] = _write_checks(_without_closure(item), typechecker)
    written, names_arrays = _inner_functions[key]
    if _CHECKED_FUNCTION not in (written.__kwdefaults__ or {}):
        return _write_checks(item, typechecker)
    copy = FunctionType(written.__code__, written.__globals__, item.__name__, written.__defaults__)
    copy.__kwdefaults__ = {**written.__kwdefaults__, _CHECKED_FUNCTION: item}
    return copy, names_arrays


_CHECKED_FUNCTION = "__beartype_func"
"""The parameter by which beartype gives its checks the function that they check."""


def _write_checks(item: FunctionType, typechecker: Callable[..., Any]) -> tuple[Callable[..., Any], bool]:
    hints = {name: _resolve(hint, item.__globals__) for name, hint in item.__annotations__.items()}
    return typechecker(_with_annotations(item, hints)), any(map(_names_arrays, hints.values()))


def _structure(hint: Any) -> Any:
    """Return what is the same for two annotations of arrays that read the same: jaxtyping makes a class of each."""
    if inspect.isclass(hint) and issubclass(hint, AbstractArray):
        return hint.dtype, hint.array_type, hint.dim_str
    parts = get_args(hint)
    return (get_origin(hint), *map(_structure, parts)) if parts else hint


def _is_hashable(key: object) -> bool:
    try:
        hash(key)
    except TypeError:
        return False
    return True


def _without_closure(item: FunctionType) -> FunctionType:
    cells = tuple(CellType() for _ in item.__closure__ or ())
    hollow = FunctionType(item.__code__, item.__globals__, item.__name__, item.__defaults__, cells)
    hollow.__kwdefaults__, hollow.__annotations__ = item.__kwdefaults__, item.__annotations__
    hollow.__module__, hollow.__qualname__ = item.__module__, item.__qualname__
    return hollow


def check_plain_arrays_faster() -> None:
    """Let arrays whose axes are names and numbers pass sooner; every other array is judged by jaxtyping itself, as before.

    Jaxtyping finds the name of the element type anew and copies all lengths of axes for every array. A type of elements that an
    annotation has once let pass is not asked for again. The lengths of axes are compared, and bound to their names, in every call.
    """
    meta = type(AbstractArray)
    judge = meta.__instancecheck__
    plans: dict[tuple[Any, Any, Any], tuple[str | int, ...] | None] = {}

    def passes(hint: Any, value: Any) -> bool:
        kind = hint, type(value), getattr(value, "dtype", None)
        axes = plans.get(kind)
        if axes is None:
            passed = judge(hint, value)
            if passed and kind not in plans:
                plans[kind] = _plain_axes(hint.dim_str)
            return passed
        lengths = get_shape_memo()[0]
        if len(value.shape) != len(axes):
            return judge(hint, value)
        for axis, length in zip(axes, value.shape, strict=True):
            if length != (axis if type(axis) is int else lengths.get(axis, length)):
                return judge(hint, value)
        for axis, length in zip(axes, value.shape, strict=True):
            if type(axis) is str:
                lengths[axis] = length
        return True

    meta.__instancecheck__ = passes


_PLAIN_AXIS = re.compile(r"\d+|[A-Za-z]\w*")


def _plain_axes(axes: str) -> tuple[str | int, ...] | None:
    """Return the name or the length of every axis, or None where one is something else or a name comes twice."""
    words = axes.split()
    names = [word for word in words if not word.isdigit()]
    if len(set(names)) < len(names) or not all(map(_PLAIN_AXIS.fullmatch, words)):
        return None
    return tuple(int(word) if word.isdigit() else word for word in words)


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
