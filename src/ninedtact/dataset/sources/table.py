"""A data set that is there already: the twin's output, or one that was built. Its images are taken over byte by byte."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ninedtact.dataset.columns import COLUMNS, DataSetDamaged, bytes_of, require_pairs, rows_of, six
from ninedtact.dataset.rows import Fault, Item, LeftOut, NotAImage, Row, UntouchedImage, decoded
from ninedtact.dataset.sources.source import Part, Source

REFERENCES, SETTINGS = "references.parquet", "settings.json"
OF = re.compile(r"-of-(\d+)\.parquet$")
TWINS_WIDTH_MM = 24.0
"""What all images of the twin's data sets show, whatever their size."""
NO_OBJECT = "none"


class DataSetUnfinished(DataSetDamaged):
    """A data set of which files are still to be made."""


def pair_files(folder: Path) -> list[Path]:
    """The files of pairs of a data set, all of them; raises `DataSetDamaged`, `DataSetUnfinished`."""
    files = sorted(path for path in (folder / "data").glob("*.parquet") if not path.name.startswith("."))
    if not files:
        raise DataSetDamaged(
            f"expected a data set, got {folder} without Parquet files in {folder / 'data'}; give the folder that "
            "'ninedtact dataset build' or 'ninedtact simulate dataset' made"
        )
    numbered = OF.search(files[-1].name)
    if numbered and int(numbered[1]) != len(files):
        raise DataSetUnfinished(
            f"expected {int(numbered[1])} files in {folder / 'data'}, got {len(files)}; finish it with the command that began it"
        )
    if not (folder / REFERENCES).is_file():
        raise DataSetUnfinished(
            f"expected {folder / REFERENCES}, got no such file; finish the data set with the command that began it"
        )
    for file in files:
        require_pairs(file)
    return files


@dataclass(frozen=True)
class TablePart(Part):
    """One file of it."""

    file: Path
    references: Path
    several: bool
    """Whether ids need the source's name in front."""
    objects_seed: int
    """Of the twin's generated objects: one name and one such seed, one shape."""

    def items(self) -> Iterator[Item]:
        """Its rows, and the untouched images that they name."""
        wanted = {row["reference"] for row in rows_of(self.file, ["reference"])}
        for row in rows_of(self.references):
            if row["reference"] in wanted:
                yield self.untouched(row)
        for number, row in enumerate(rows_of(self.file, COLUMNS)):
            yield self.item(number, row)

    def untouched(self, row: dict[str, Any]) -> UntouchedImage:
        """One row of the references."""
        return UntouchedImage(self.named(row["reference"]), bytes_of(row["image"]) or b"", row.get("sensor") or "")

    def item(self, number: int, row: dict[str, Any]) -> Row | LeftOut:
        """One pair, as it is."""
        own_id = row.get("id") or f"{self.file.stem.split('-of-')[0]}-{number:05d}"
        content = bytes_of(row["image"])
        try:
            image = decoded(content)
        except NotAImage as trouble:
            fault = Fault.UNREADABLE if content else Fault.MISSING_IMAGE
            return LeftOut(fault, self.named(own_id), f"image: {trouble}")
        reference = row.get("reference")
        return Row(
            id=self.named(own_id),
            image=content or b"",
            reference=None if reference is None else self.named(reference),
            wrench=six(row["wrench"]),
            object=self.object(row.get("object") or NO_OBJECT),
            contact=self.named(row.get("contact") or own_id),
            step=row.get("step") or 0,
            time_ns=row.get("time_ns"),
            sensor=row.get("sensor") or self.source,
            kind=row.get("kind") or "rule",
            source=self.named(row["source"]) if row.get("source") else self.source,
            mm_per_px=row["mm_per_px"] if "mm_per_px" in row else TWINS_WIDTH_MM / image.shape[1],
            gap_ms=row.get("gap_ms"),
        )

    def named(self, own: str) -> str:
        """Unlike the ids of other sources."""
        return f"{self.source}/{own}" if self.several else own

    def object(self, name: str) -> str:
        """One name, one object."""
        return name if name == NO_OBJECT or not self.objects_seed else f"{name}@{self.objects_seed}"


@dataclass(frozen=True)
class TableSource(Source):
    """The folder of a data set."""

    several: bool = False
    what = "a data set in these columns"

    def said(self) -> Iterator[str]:
        """Seeds, where the twin made it."""
        made = self.made_with
        if "objects_seed" in made:
            seeds = f"seed {made.get('seed')}, objects' seed {self.objects_seed}"
            yield f"made by the twin of ninedtact {made.get('ninedtact')}, {seeds}"

    def files(self) -> list[Path]:
        """Pairs and untouched images."""
        return [*pair_files(self.path), self.path / REFERENCES]

    def parts(self) -> list[Part]:
        """Its files."""
        return [
            TablePart(self.name, file, self.path / REFERENCES, self.several, self.objects_seed)
            for file in pair_files(self.path)
        ]

    @cached_property
    def made_with(self) -> dict[str, Any]:
        """The settings beside it, as far as they can be read."""
        try:
            found = json.loads((self.path / SETTINGS).read_text())
        except (OSError, ValueError):
            return {}
        return found if isinstance(found, dict) else {}

    @property
    def objects_seed(self) -> int:
        """Of the twin's generated objects; zero where it did not make them."""
        seed = self.made_with.get("objects_seed", 0)
        return seed if isinstance(seed, int) else 0
