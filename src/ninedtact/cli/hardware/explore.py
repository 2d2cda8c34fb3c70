"""ninedtact hardware explore: designs compared by their parts and their twins, before anything is printed."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ninedtact.cli.hardware.described import Described, require_solids
from ninedtact.cli.terminal import answer
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
    calibrated: bool = False
    """Let each twin calibrate itself by its board and ball, and read a press of another ball: the error of depth and of load that
    the sensor would have. Half a minute for each."""
    out: Path | None = None
    """Folder for explore.csv, explore.png and a design file of every design."""
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
        self.begin()
        looked = explored(choices, self.calibrated)
        found = list(tqdm(looked, total=len(choices), unit="design", disable=None, leave=False))
        table: dict[str, Any] = {"designs": [each.as_table() for each in found], "files": self.written(found)}
        return answer(self.json, table, lines(found))

    @property
    def sweep(self) -> "Sweep":
        """As the hardware room names it; raises `AreaUnreadable`."""
        from ninedtact.hardware.explore.sweep import Sweep

        return Sweep(self.gel_mm, self.shore_a, tuple(map(area_from, self.area_mm)), self.lens_deg)

    def begin(self) -> None:
        """See that there is a folder before work begins; raises `OSError`."""
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)

    def written(self, found: "list[Explored]") -> list[str]:
        """Table and plot, if a folder was named."""
        from ninedtact.atomic_write import write_file_atomically
        from ninedtact.hardware.design_file import hardware_toml
        from ninedtact.hardware.explore.table import sweep_csv, sweep_png

        if self.out is None:
            return []
        designs = {f"design_{number:02d}.toml": each.design for number, each in enumerate(found, 1) if each.predicted}
        contents = {name: hardware_toml(design).encode() for name, design in designs.items()}
        contents |= {"explore.csv": sweep_csv(found), "explore.png": sweep_png(found)}
        for name, content in contents.items():
            write_file_atomically(self.out / name, content)
        return [str(self.out / name) for name in contents]


def area_from(text: str) -> tuple[float, float]:
    """`24x18` → 24 mm by 18 mm; raises `AreaUnreadable`."""
    try:
        width, height = map(float, text.lower().split("x"))
    except ValueError:
        raise AreaUnreadable(f"expected an area such as 24x18, got {text!r}; write width x height in mm") from None
    return width, height
