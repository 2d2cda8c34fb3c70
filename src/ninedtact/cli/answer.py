"""What a command says on standard output: one JSON object for scripts, or lines for a person."""

import json
from collections.abc import Iterable, Mapping
from typing import Any


def answer(as_json: bool, figures: Mapping[str, Any], lines: Iterable[str]) -> int:
    """Print one or the other; the exit code of work that is done."""
    if as_json:
        print(json.dumps(figures, indent=2, ensure_ascii=False))
    else:
        print("\n".join(lines))
    return 0
