"""What the checks of a data set found: faults of single pairs, listed in a JSON file and counted."""

from collections.abc import Iterator
from enum import StrEnum
from pathlib import Path

import msgspec

from ninedtact.atomic_write import write_file_atomically
from ninedtact.checked_reading import CHECKSUM_KEY, mapping_checksum, read_json_object
from ninedtact.errors import DatasetError, FileFormatError


class PairFault(StrEnum):
    """What can be wrong with a pair of image and wrench, and what it means, for the report and README.md."""

    meaning: str

    def __new__(cls, value: str, meaning: str) -> "PairFault":
        """Return a member with its meaning."""
        member = str.__new__(cls, value)
        member._value_, member.meaning = value, meaning
        return member

    MISSING_IMAGE = "missing image", "a wrench without an image; it cannot become a pair"
    MISSING_WRENCH = "missing wrench", "an image without a wrench; it cannot become a pair"
    UNREADABLE = "unreadable", "a file that is damaged or of another kind; it cannot become a pair"
    MISSING_END = (
        "missing end",
        "a recording that was cut short, or is still being written; the pairs before its end are kept",
    )
    NO_REFERENCE = "no reference", "no reference image (no contact) belongs to it"
    NOT_FINITE = "not finite", "the wrench contains a value that is not a finite number"
    OUT_OF_RANGE = "out of range", "a force or torque is larger than this sensor is used with"
    PULLING = (
        "pulling",
        "F_z is above zero: the object would pull at the skin; the axes of the force sensor may be turned",
    )
    UNSYNCHRONISED = "unsynchronised", "image and wrench were taken too far apart in time"
    WRONG_SIZE = "wrong size", "the image and its reference image differ in size"
    NO_LIGHT = "no light", "the image is dark or overexposed beside its reference image"
    NO_DARKENING = (
        "no darkening",
        "the wrench presses hard, but no place of the image is darker than in the reference image",
    )
    NO_MEASURED_FORCE = "no measured force", "the image shows a contact, but the wrench is zero"
    DUPLICATE_IMAGE = "duplicate image", "an earlier pair has the same image"
    DUPLICATE_ID = "duplicate id", "an earlier pair has the same id"
    NORM_DIFFERS = "norm differs", "_norm.npy and .npy of the original project contradict each other"
    MIXED_IMAGE_DIFFERS = "mixed image differs", "mixed_image and image of the original project contradict each other"


UNUSABLE_FAULTS = frozenset({PairFault.UNREADABLE, PairFault.NO_REFERENCE, PairFault.NOT_FINITE})
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
        for fault in PairFault:
            if count := self.counts.get(fault):
                yield f"{count:8d} {fault}: {fault.meaning}"


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
