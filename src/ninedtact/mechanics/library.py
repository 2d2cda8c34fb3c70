"""Which array library an array belongs to: NumPy or torch, behind one set of names (the array API standard)."""

from typing import Any

from array_api_compat import array_namespace

KNOWN: dict[type, Any] = {}
"""By the arrays' type: asking costs more than adding two small arrays."""


def library_of(array: Any) -> Any:
    """Its functions."""
    kind = type(array)
    if kind not in KNOWN:
        KNOWN[kind] = array_namespace(array)
    return KNOWN[kind]
