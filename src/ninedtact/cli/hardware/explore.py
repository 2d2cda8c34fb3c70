"""ninedtact hardware explore: designs compared by their parts and their twins, before anything is printed."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ninedtact.cli.answer import answer
from ninedtact.cli.hardware.described import Described, require_solids
from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.hardware.explore.explored import Explored
    from ninedtact.hardware.explore.sweep import Sweep


class AreaUnreadable(NinedtactError):
    """Not a width and a height."""


@dataclass(frozen=True)
class Explore:
    """Compare designs: predicted depth range, resolution, force range, signal per newton, field of view, size and cost.

    Every combination of the values given is built and its twin pressed by a ball of radius 4 mm. The camera is moved away as
    far as the lens needs. Nothing here is measured: docs/hardware.md says what each prediction rests on.
    """

    gel_mm: tuple[float, ...] = ()
    """Thicknesses of the translucent gel."""
    shore_a: tuple[float, ...] = ()
    """Its hardnesses, Shore A."""
    area_mm: tuple[str, ...] = ()
    """Sensing areas: 24x18 30x22."""
    lens_deg: tuple[float, ...] = ()
    """Angles that the lens sees in air."""
    described: Annotated[Described, tyro.conf.arg(name="")] = Described()
    out: Path | None = None
    """Folder for explore.csv and explore.png."""
    json: bool = False
    """Print the table as one JSON object."""

    def run(self) -> int:
        """Build, press, and put side by side."""
        require_solids()
        from tqdm import tqdm

        from ninedtact.hardware.explore.explored import explored
        from ninedtact.hardware.explore.table import lines

        basis = self.described.hardware()
        choices = [*self.sweep.designs(basis)]
        found = list(tqdm(explored(choices), total=len(choices), unit="design", disable=None, leave=False))
        table: dict[str, Any] = {"designs": [each.as_table() for each in found], "files": self.written(found)}
        return answer(self.json, table, lines(found))

    @property
    def sweep(self) -> "Sweep":
        """As the hardware room names it; raises `AreaUnreadable`."""
        from ninedtact.hardware.explore.sweep import Sweep

        return Sweep(self.gel_mm, self.shore_a, tuple(map(area_from, self.area_mm)), self.lens_deg)

    def written(self, found: "list[Explored]") -> list[str]:
        """Table and plot, if a folder was named."""
        from ninedtact.hardware.explore.table import sweep_csv, sweep_png
        from ninedtact.whole_file import write_whole

        if self.out is None:
            return []
        self.out.mkdir(parents=True, exist_ok=True)
        contents = {"explore.csv": sweep_csv(found), "explore.png": sweep_png(found)}
        for name, content in contents.items():
            write_whole(self.out / name, content)
        return [str(self.out / name) for name in contents]


def area_from(text: str) -> tuple[float, float]:
    """`24x18` → 24 mm by 18 mm; raises `AreaUnreadable`."""
    try:
        width, height = map(float, text.lower().split("x"))
    except ValueError:
        raise AreaUnreadable(f"expected an area such as 24x18, got {text!r}; write width x height in mm") from None
    return width, height
