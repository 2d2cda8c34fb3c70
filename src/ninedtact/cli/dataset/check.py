"""ninedtact dataset check: what is wrong with the pairs of a data set, listed and counted."""

from dataclasses import dataclass
from pathlib import Path

import tyro

from ninedtact.cli.dataset.limits import Limits
from ninedtact.cli.terminal import print_result


@dataclass(frozen=True)
class Check:
    """Look at every pair of a data set. Nothing is changed: `build --drop` makes one without what is listed."""

    folder: tyro.conf.Positional[Path]
    """The data set."""
    report: Path | None = None
    """File for the list, JSON; check.json in the data set where nothing is said."""
    strict: bool = False
    """Exit with 1 where anything is listed."""
    workers: int = 2
    """Processes; one for each core."""
    limits: Limits = Limits()
    json: bool = False
    """Print the figures as one JSON object."""

    def run(self) -> int:
        """Check, list, count."""
        from ninedtact.dataset.check import check_folder
        from ninedtact.dataset.report import require_nothing_listed, require_usable, write_report

        found = check_folder(self.folder, self.limits.settings(), self.workers, progress=not self.json)
        path = self.report or self.folder / "check.json"
        write_report(path, found)
        figures = {
            "folder": str(self.folder),
            "pairs": found.pairs,
            "without_fault": found.without_fault,
            "findings": found.counts,
            "report": str(path),
        }
        told = [*found.lines(), f"{path} lists each"] if found.listed else found.lines()
        print_result(self.json, figures, told)
        require_usable(found, path)
        if self.strict:
            require_nothing_listed(found, path)
        return 0
