"""What the checks of a data set found: faults of single pairs, listed in a JSON file and counted."""

from collections import Counter
from collections.abc import Iterable, Iterator
from enum import StrEnum
from pathlib import Path

import msgspec

from ninedtact.atomic_write import write_file_atomically
from ninedtact.bounds_and_checked_reading import CHECKSUM_KEY, mapping_checksum, read_json_object
from ninedtact.errors import DatasetError, FileFormatError


class PairFault(StrEnum):
    """What can be wrong with a pair of image and wrench."""

    MISSING_IMAGE = "missing image"
    MISSING_WRENCH = "missing wrench"
    UNREADABLE = "unreadable"
    MISSING_END = "missing end"
    NO_REFERENCE = "no reference"
    NOT_FINITE = "not finite"
    OUT_OF_RANGE = "out of range"
    PULLING = "pulling"
    UNSYNCHRONISED = "unsynchronised"
    WRONG_SIZE = "wrong size"
    NO_LIGHT = "no light"
    NO_DARKENING = "no darkening"
    NO_MEASURED_FORCE = "no measured force"
    DUPLICATE_IMAGE = "duplicate image"
    DUPLICATE_ID = "duplicate id"
    NORM_DIFFERS = "norm differs"
    MIXED_IMAGE_DIFFERS = "mixed image differs"


FAULT_MEANINGS = {
    PairFault.MISSING_IMAGE: "a wrench without an image; it cannot become a pair",
    PairFault.MISSING_WRENCH: "an image without a wrench; it cannot become a pair",
    PairFault.UNREADABLE: "a file that is damaged or of another kind; it cannot become a pair",
    PairFault.MISSING_END: "a recording that was cut short, or is still being written; the pairs before its end are kept",
    PairFault.NO_REFERENCE: "no reference image (no contact) belongs to it",
    PairFault.NOT_FINITE: "the wrench contains a value that is not a finite number",
    PairFault.OUT_OF_RANGE: "a force or torque is larger than this sensor is used with",
    PairFault.PULLING: "F_z is above zero: the object would pull at the skin; the axes of the force sensor may be turned",
    PairFault.UNSYNCHRONISED: "image and wrench were taken too far apart in time",
    PairFault.WRONG_SIZE: "the image and its reference image differ in size",
    PairFault.NO_LIGHT: "the image is dark or overexposed beside its reference image",
    PairFault.NO_DARKENING: "the wrench presses hard, but no place of the image is darker than in the reference image",
    PairFault.NO_MEASURED_FORCE: "the image shows a contact, but the wrench is zero",
    PairFault.DUPLICATE_IMAGE: "an earlier pair has the same image",
    PairFault.DUPLICATE_ID: "an earlier pair has the same id",
    PairFault.NORM_DIFFERS: "_norm.npy and .npy of the original project contradict each other",
    PairFault.MIXED_IMAGE_DIFFERS: "mixed_image and image of the original project contradict each other",
}
"""What each fault means, for the report and README.md."""

_UNUSABLE_FAULTS = frozenset({PairFault.UNREADABLE, PairFault.NO_REFERENCE, PairFault.NOT_FINITE})
"""Faults that make a pair unusable for training; a pair with one of the others may be a good one."""


class PairFinding(msgspec.Struct, frozen=True):
    """One fault of one pair."""

    fault: PairFault
    id: str
    message: str
    row: int | None = None
    """Row number in its file; None if the pair is in no file of the data set."""
    file: str = ""
    """File in `data/`."""


class QualityReport(msgspec.Struct, frozen=True):
    """All findings in a data set."""

    pairs: int
    """Number of pairs that were checked."""
    without_fault: int
    usable: int
    """Number of pairs in the data set that can be used for training."""
    counts: dict[str, int]
    """Number of findings by fault."""
    dropped: bool
    """Whether pairs with findings were left out of the data set."""
    findings: list[PairFinding]

    def summary_lines(self) -> Iterator[str]:
        """Yield the counts as lines of text."""
        if not self.findings:
            yield f"{self.pairs} pairs checked, no faults found"
            return
        consequence = "left out" if self.dropped else "kept"
        yield f"{self.pairs} pairs checked; {self.pairs - self.without_fault} have faults and are {consequence}:"
        for fault, meaning in FAULT_MEANINGS.items():
            if count := self.counts.get(fault.value):
                yield f"{count:8d} {fault.value}: {meaning}"


def summarise_findings(pairs: int, findings: Iterable[PairFinding], dropped: bool = False) -> QualityReport:
    """Count the findings of a data set of this many pairs."""
    findings = list(findings)
    in_rows = [finding for finding in findings if finding.row is not None]
    faulty = {(finding.file, finding.row) for finding in in_rows}
    unusable = {(finding.file, finding.row) for finding in in_rows if dropped or finding.fault in _UNUSABLE_FAULTS}
    counts = dict(sorted(Counter(finding.fault.value for finding in findings).items()))
    return QualityReport(pairs, pairs - len(faulty), pairs - len(unusable), counts, dropped, findings)


def write_quality_report(path: Path, report: QualityReport) -> None:
    """Write a report as JSON, with a checksum over its values; raises `FileNotWritten`."""
    values = msgspec.to_builtins(report)
    content = msgspec.json.encode({**values, CHECKSUM_KEY: mapping_checksum(values)})
    write_file_atomically(path, msgspec.json.format(content, indent=1), b"\n")


def read_quality_report(path: Path) -> QualityReport:
    """Read a report that `write_quality_report` wrote; raises `FileFormatError`."""
    try:
        values = read_json_object(path, most_bytes=None)
        if values.get(CHECKSUM_KEY) not in (None, mapping_checksum(values)):
            raise ValueError("other values than its checksum")
        return msgspec.convert(values, QualityReport)
    except (OSError, ValueError) as trouble:
        raise FileFormatError(
            f"expected a report of checks in {path}, got: {trouble}; copy the whole data set again, or check it anew"
        ) from trouble


def require_any_usable_pair(report: QualityReport, report_path: Path) -> None:
    """Raise `DatasetError` if no pair can be used for training."""
    if report.usable < 1:
        counted = sorted(report.counts.items(), key=lambda item: -item[1])
        reasons = ", ".join(f"{count} {fault}" for fault, count in counted) or "the sources are empty"
        raise DatasetError(
            expected="pairs to train with",
            got=f"none that is usable ({reasons})",
            remedy=f"{report_path} lists them all: correct the sources, or state what they lack",
        )


def require_no_faults(report: QualityReport, report_path: Path) -> None:
    """Raise `DatasetError` if the report contains any finding."""
    if report.findings:
        counted = ", ".join(f"{count} {fault}" for fault, count in report.counts.items())
        raise DatasetError(
            expected="no faults", got=f"{counted}", remedy=f"{report_path} lists them, --drop leaves them out"
        )
