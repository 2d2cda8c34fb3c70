"""What the checks found, listed in a file and counted."""

from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import msgspec

from ninedtact.atomic_write import write_file_atomically
from ninedtact.dataset.rows import MEANINGS, UNUSABLE, Finding
from ninedtact.errors import NinedtactError

REPORT = "report.json"


class NothingUsable(NinedtactError):
    """Not one pair is left to train with."""


class FindingsListed(NinedtactError):
    """Something was found where nothing was wished for."""


class Report(msgspec.Struct, frozen=True):
    """All findings of a data set."""

    pairs: int
    """Rows that were looked at."""
    without_fault: int
    usable: int
    """Pairs in the data set that something can be learnt from."""
    counts: dict[str, int]
    """Findings by fault."""
    dropped: bool
    """Whether the pairs that are listed were left out."""
    listed: list[Finding]

    def lines(self) -> Iterator[str]:
        """For a person."""
        if not self.listed:
            yield f"{self.pairs} pairs checked, nothing found"
            return
        fate = "left out" if self.dropped else "kept all the same"
        faulty = self.pairs - self.without_fault
        yield f"{self.pairs} pairs checked; {faulty} have something against them and are {fate}:"
        for fault, meaning in MEANINGS.items():
            if count := self.counts.get(fault.value):
                yield f"{count:8d} {fault.value}: {meaning}"


def report_of(pairs: int, findings: Iterable[Finding], dropped: bool = False) -> Report:
    """Count and list them."""
    listed = list(findings)
    rows = [finding for finding in listed if finding.row is not None]
    faulty = {(finding.part, finding.row) for finding in rows}
    unusable = faulty if dropped else {(finding.part, finding.row) for finding in rows if finding.fault in UNUSABLE}
    counts = Counter(finding.fault.value for finding in listed)
    return Report(pairs, pairs - len(faulty), pairs - len(unusable), dict(sorted(counts.items())), dropped, listed)


def write_report(path: Path, report: Report) -> None:
    """As JSON, a finding a line; raises `FileNotWritten`."""
    write_file_atomically(path, msgspec.json.format(msgspec.json.encode(report), indent=1), b"\n")


def read_report(path: Path) -> Report:
    """What `write_report` wrote."""
    return msgspec.json.decode(path.read_bytes(), type=Report)


def require_usable(report: Report, where: Path) -> None:
    """Refuse a data set of nothing; raises `NothingUsable`."""
    if report.usable < 1:
        worst = ", ".join(f"{count} {fault}" for fault, count in sorted(report.counts.items(), key=lambda it: -it[1]))
        raise NothingUsable(
            f"expected pairs to train with, got none that is usable ({worst or 'the sources are empty'}); {where} lists "
            "them all: mend the sources, or state what they lack"
        )


def require_nothing_listed(report: Report, where: Path) -> None:
    """Refuse any finding; raises `FindingsListed`."""
    if report.listed:
        counted = ", ".join(f"{count} {fault}" for fault, count in report.counts.items())
        raise FindingsListed(f"expected nothing to be found, got {counted}; {where} lists them, --drop leaves them out")
