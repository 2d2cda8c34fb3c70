"""One part of a source → files of its own: pairs, untouched images, and notes of what was wrong.

Every part depends on its source alone, so parts are made in any order, by any number of processes, and those that are there
already are left as they are. The notes come last: where they are, the part is whole.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import msgspec

from ninedtact.atomic_write import write_file_atomically
from ninedtact.dataset.checks import CheckSettings, FileCheck, Untouched, checked_file
from ninedtact.dataset.columns import write_rows, write_untouched
from ninedtact.dataset.rows import Finding, LeftOut, Row, UntouchedImage, writable
from ninedtact.dataset.sources.source import Part


@dataclass(frozen=True)
class PartFiles:
    """Where a part is kept until the data set is finished."""

    folder: Path
    number: int

    @property
    def pairs(self) -> Path:
        """Its rows."""
        return self.folder / f"{self.number:05d}.pairs.parquet"

    @property
    def untouched(self) -> Path:
        """The untouched images that they name."""
        return self.folder / f"{self.number:05d}.untouched.parquet"

    @property
    def notes(self) -> Path:
        """Its check."""
        return self.folder / f"{self.number:05d}.notes.json"

    @property
    def done(self) -> bool:
        """Whether nothing is missing."""
        return self.notes.is_file()

    def check(self) -> FileCheck:
        """The notes; `pairs` may have been moved since."""
        return msgspec.json.decode(self.notes.read_bytes(), type=FileCheck)


@dataclass
class Sorter:
    """Hands on rows, and keeps what else a part tells."""

    part: Part
    file: str
    untouched: dict[str, UntouchedImage] = field(default_factory=dict)
    findings: list[Finding] = field(default_factory=list)

    def rows(self) -> Iterator[Row]:
        """All rows."""
        number = 0
        for item in self.part.items():
            if isinstance(item, UntouchedImage):
                self.untouched.setdefault(item.id, item)
            elif isinstance(item, LeftOut):
                self.findings.append(Finding(item.fault, writable(item.id), writable(item.says), None, self.file))
            else:
                self.findings += [
                    Finding(fault, writable(item.id), writable(says), number, self.file) for fault, says in item.doubts
                ]
                yield item
                number += 1


def make_part(part: Part, files: PartFiles, settings: CheckSettings) -> int:
    """Write it; how many pairs it has. Raises `FileNotWritten`."""
    sorter = Sorter(part, files.pairs.name)
    write_rows(files.pairs, sorter.rows())
    write_untouched(files.untouched, sorter.untouched.values())
    check = checked_file(files.pairs, Untouched([files.untouched]), settings)
    check.findings = [*sorter.findings, *check.findings]
    write_file_atomically(files.notes, msgspec.json.encode(check))
    return len(check.ids)
