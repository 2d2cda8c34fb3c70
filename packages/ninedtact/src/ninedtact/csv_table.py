"""Tables as CSV files."""

import csv
from collections.abc import Iterable
from io import StringIO
from typing import Any

from ninedtact.errors import printable_text


def to_csv(header: Iterable[str], rows: Iterable[Iterable[Any]]) -> bytes:
    """Return a table as the content of a CSV file.

    Text that a spreadsheet would compute as a formula gets an apostrophe before it.
    """
    text = StringIO()
    csv.writer(text).writerows([list(header), *(map(_to_cell, row) for row in rows)])
    return text.getvalue().encode()


def _to_cell(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    text = printable_text(value)
    return f"'{text}" if text.lstrip().startswith(("=", "+", "-", "@")) else text
