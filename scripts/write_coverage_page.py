"""Write docs/coverage.md from a coverage report: the total line coverage and the ten least covered files.

usage: write_coverage_page.py out/coverage.json
"""

import json
import sys
from pathlib import Path

PAGE = Path(__file__).parents[1] / "docs" / "coverage.md"
LEAST_COVERED = 10
HEADER = """# Test coverage

`make coverage` runs the whole test suite with line coverage and writes this page. Tests that need real images, an extra or a
device are skipped where these are missing, and lower the figures.
"""


def coverage_page(report: dict) -> str:
    """Return the page for a report in coverage.py's JSON format."""
    total = report["totals"]
    files = sorted(report["files"].items(), key=lambda item: item[1]["summary"]["percent_covered"])[:LEAST_COVERED]
    rows = [
        f"| `{Path(name).relative_to('src/ninedtact')}` | {entry['summary']['percent_covered']:.0f} % "
        f"| {entry['summary']['missing_lines']} of {entry['summary']['num_statements']} |"
        for name, entry in files
    ]
    summary = f"**{total['percent_covered']:.1f} %** of {total['num_statements']:,} statements are run by the tests."
    table = ["| least covered files | covered | statements not run |", "|---|---|---|", *rows]
    return "\n".join([HEADER, summary, "", *table, ""])


if __name__ == "__main__":
    PAGE.write_text(coverage_page(json.loads(Path(sys.argv[1]).read_text())), encoding="utf-8")
    print(f"wrote {PAGE}")
