"""ninedtact dataset show: what is in a data set, counted, beside the real forces, and drawn."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from ninedtact.cli.terminal import print_result

if TYPE_CHECKING:
    from ninedtact.dataset.card import Contents

NAMED = 8
"""Names of a kind that are told one by one."""


@dataclass(frozen=True)
class Show:
    """Count the pairs of a data set, set their forces beside the real ones, and draw some."""

    folder: tyro.conf.Positional[Path]
    """The data set."""
    sheet: Path | None = None
    """Image for some pairs, PNG; sheet.png in the data set where nothing is said."""
    pairs: int = 24
    """How many are drawn, evenly spread from the lightest to the heaviest load; 0 for none."""
    json: bool = False
    """Print the counts as one JSON object."""

    def run(self) -> int:
        """Count, draw and say."""
        from ninedtact.dataset.build import contents_in
        from ninedtact.dataset.sources.table import pair_files

        contents = contents_in(pair_files(self.folder))
        drawn = self.draw() if self.pairs > 0 else None
        figures = {
            "folder": str(self.folder),
            "pairs": contents.pairs,
            "kinds": contents.kinds,
            "sensors": contents.sensors,
            "objects": contents.objects,
            "percentiles": list(contents.percentiles),
            "sheet": None if drawn is None else str(drawn),
        }
        return print_result(self.json, figures, lines(self.folder, contents, drawn))

    def draw(self) -> Path:
        """Write the image of some pairs; where it is."""
        import cv2

        from ninedtact.atomic_write import write_file_atomically
        from ninedtact.dataset.sheet import contact_sheet

        path = self.sheet or self.folder / "sheet.png"
        write_file_atomically(path, cv2.imencode(".png", contact_sheet(self.folder, self.pairs))[1].tobytes())
        return path


def lines(folder: Path, contents: "Contents", drawn: Path | None) -> Iterator[str]:
    """For a person."""
    yield f"{folder}: {contents.pairs} pairs"
    for what in ("kinds", "sensors", "objects"):
        yield f"{what}: {counted(getattr(contents, what))}"
    yield from contents.percentiles
    if drawn:
        yield f"{drawn} shows some: red darker, green brighter than untouched, the arrow the shear"


def counted(counts: Mapping[str, int]) -> str:
    """The most frequent names, and how many more there are."""
    first = sorted(counts.items(), key=lambda it: (-it[1], it[0]))
    more = f" and {len(first) - NAMED} more" if len(first) > NAMED else ""
    return ", ".join(f"{count} {name or 'unnamed'}" for name, count in first[:NAMED]) + more
