"""S-expressions, in which KiCad keeps its files."""

from typing import Any, NewType

Quoted = NewType("Quoted", str)
"""Words that are written in quotation marks."""
Expression = str | float | bool | tuple[Any, ...]
"""Words, numbers, yes or no, and lists of these."""


def quoted(words: str) -> Quoted:
    """Words in quotation marks."""
    return Quoted('"' + words.replace("\\", "\\\\").replace('"', '\\"') + '"')


def written(expression: Expression, depth: int = 0) -> str:
    """An expression as text; lists that hold lists take a line each."""
    match expression:
        case bool():
            return "yes" if expression else "no"
        case float() | int():
            return number(expression)
        case str():
            return expression
    inner = [written(part, depth + 1) for part in expression]
    if not any(isinstance(part, tuple) for part in expression) or sum(map(len, inner)) < 90:
        return f"({' '.join(inner)})"
    gap = "\n" + "  " * (depth + 1)
    return f"({inner[0]}{gap}{gap.join(inner[1:])})"


def number(value: float) -> str:
    """With as many decimals as it needs, six at most."""
    return f"{round(value, 6) + 0.0:.6f}".rstrip("0").rstrip(".")
