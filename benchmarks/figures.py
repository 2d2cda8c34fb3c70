"""Measured figures beside what they must reach and what a peer reaches: a table for a person, JSON for a script."""

import json as json_text
import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from itertools import zip_longest
from textwrap import wrap

import cv2
import numpy as np

Value = float | int | str

WIDEST = 64
"""Characters of a cell."""


@dataclass(frozen=True)
class Figure:
    """One line of a benchmark's answer."""

    figure: str
    measured: Value
    required: str = ""
    peer: Value = ""
    verdict: str = ""
    """`met`, `SHORT`, or nothing where nothing is required."""


def at_most(figure: str, measured: float, limit: float, unit: str = "", peer: Value = "") -> Figure:
    return Figure(figure, measured, f"≤ {limit:.3g} {unit}".strip(), peer, verdict(measured <= limit))


def at_least(figure: str, measured: float, limit: float, unit: str = "", peer: Value = "") -> Figure:
    return Figure(figure, measured, f"≥ {limit:.3g} {unit}".strip(), peer, verdict(measured >= limit))


def holds(figure: str, measured: Value, required: str, met: bool, peer: Value = "") -> Figure:
    return Figure(figure, measured, required, peer, verdict(met))


def verdict(met: bool) -> str:
    return "met" if met else "SHORT"


def answer(title: str, figures: Sequence[Figure], json: bool) -> None:
    """Print the figures, as JSON or as a table."""
    if json:
        whole = {"benchmark": title, "machine": machine(), "specification": [asdict(figure) for figure in figures]}
        print(json_text.dumps(whole, indent=2, ensure_ascii=False, default=float))
        return
    print(f"{title}\n{machine()}\n")
    print("\n".join(table(figures)))


def table(figures: Sequence[Figure]) -> list[str]:
    """The figures in columns; a column that nobody uses is left out, a long cell goes on in the next line."""
    names = [field.name for field in fields(Figure)]
    rows = [names] + [[shown(getattr(figure, name)) for name in names] for figure in figures]
    columns = [column for column in zip(*rows, strict=True) if any(column[1:])]
    folded = [[wrap(cell, WIDEST) or [""] for cell in column] for column in columns]
    widths = [max(len(line) for cell in column for line in cell) for column in folded]
    return [line for row in zip(*folded, strict=True) for line in lines(row, widths)]


def lines(row: Sequence[list[str]], widths: Sequence[int]) -> list[str]:
    """The lines of one row, whose cells may have several."""
    return [
        "  ".join(cell.ljust(width) for cell, width in zip(cells, widths, strict=True)).rstrip()
        for cells in zip_longest(*row, fillvalue="")
    ]


def shown(value: Value) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def machine() -> str:
    """What the figures were measured on and with, in words."""
    versions = f"Python {platform.python_version()}, NumPy {np.__version__}, OpenCV {cv2.__version__}"
    return f"{os.cpu_count()} cores, {platform.machine()}, {platform.system()}; {versions}"
