"""Print how much code there is, and through how many files a command leads.

    python scripts/report_size.py                                           lines of each distribution and its packages
    python scripts/report_size.py estimate --sensor S --reference R IMAGE   files in which this command calls a function

Lines are those of Python files, with docstrings, comments and empty lines. Functions are counted in this process alone.
"""

import sys
import threading
from collections import Counter, defaultdict
from pathlib import Path
from types import FrameType

ROOT = Path(__file__).parents[1]
_IS_FUNCTION = 0x2
"""CPython's flag of code with local variables, which bodies of modules and classes have not."""


def count_lines() -> dict[str, Counter[str]]:
    """Return the lines of each package, by its distribution; tests and benchmarks are packages of "checks"."""
    lines: dict[str, Counter[str]] = defaultdict(Counter)
    for path in (
        one for folder in ("packages", "plugins", "tests", "benchmarks") for one in (ROOT / folder).rglob("*.py")
    ):
        parts, count = path.relative_to(ROOT).parts, path.read_text(encoding="utf-8").count("\n")
        if "src" in parts:
            inner = parts[parts.index("src") + 2 :]
            lines[parts[parts.index("src") + 1]][inner[0].removesuffix(".py")] += count
        else:
            lines["checks"]["benchmarks" if parts[0] == "benchmarks" else "tests"] += count
    return lines


def trace_command(arguments: list[str]) -> dict[str, set[str]]:
    """Run a command in this process and return the files in which it calls a function, by package."""
    from ninedtact.cli import main

    found: dict[str, set[str]] = defaultdict(set)

    def note(frame: FrameType, event: str, _: object) -> None:
        code = frame.f_code
        is_named = not code.co_qualname.endswith("<locals>") and code.co_name not in ("<module>", "<lambda>")
        if event == "call" and is_named and code.co_flags & _IS_FUNCTION and "ninedtact" in code.co_filename:
            parts = Path(code.co_filename).parts
            first = max(place for place, part in enumerate(parts) if part.startswith("ninedtact"))
            found["/".join(parts[first:-1])].add(parts[-1])

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        main(arguments)
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type]
    return found


def main(arguments: list[str]) -> None:
    """Print one of the two reports."""
    if arguments:
        found = trace_command(arguments)
        for package, files in sorted(found.items()):
            print(f"{package}: {', '.join(sorted(files))}")
        print(f"{sum(map(len, found.values()))} files in {len(found)} packages")
        return
    counted = count_lines()
    for name, packages in sorted(counted.items()):
        print(
            f"{name}: {packages.total()} = {', '.join(f'{package} {count}' for package, count in packages.most_common())}"
        )
    print(f"source in all: {sum(packages.total() for name, packages in counted.items() if name != 'checks')}")


if __name__ == "__main__":
    main(sys.argv[1:])
