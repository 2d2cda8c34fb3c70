"""ninedtact simulate dataset: pairs of image and wrench from many twins, as a folder that Hugging Face opens."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ninedtact.cli.options import DesignFileOption, read_design_or_default
from ninedtact.cli.terminal import print_result
from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.dataset.generation.job import Made
    from ninedtact.dataset.generation.settings import DatasetSettings


class DatasetStopped(NinedtactError):
    """Ctrl-C ended the command before the data set was whole."""

    def __init__(self, folder: Path) -> None:
        super().__init__(
            f"stopped by Ctrl-C; nothing in {folder} was written half; run the command again to go on where it stopped"
        )


@dataclass(frozen=True)
class Dataset:
    """Make a data set of images and six-axis wrenches. Run again after a stop, it goes on where it was."""

    out: Path
    """Folder for the data set: new, empty, or begun with the same options."""
    pairs: int = 10_000
    """How many images with their wrenches."""
    size: tuple[int, int] = (460, 345)
    """Columns and rows of the images; all sizes show the sensing area's width, 24 mm as published."""
    sensors: int = 20
    """How many different sensors take turns."""
    objects: int = 175
    """How many of the generated objects press."""
    names: tuple[str, ...] = ()
    """Objects by name instead (ball:4, gear_07, part.stl)."""
    seed: int = 0
    """Of sensors, hands and noise."""
    objects_seed: int = 0
    """Of generated objects."""
    workers: int = 2
    """Processes; one for each core. With a GPU threads, which make noise and PNG."""
    device: str = "auto"
    """cpu, cuda or cuda:1 (many contacts at once on a GPU, by torch); auto: a GPU if torch sees one. (torch-cpu: the way of a
    GPU without one, slow, to try it.)"""
    at_once: int = 256
    """Sessions that a GPU advances together; fewer where its memory runs out."""
    no_contact: float = 0.03
    """Share of pairs in which nothing touches."""
    light_touch: float = 0.05
    """Share of pairs under less than 0.3 N."""
    compliant_base: float = 0.2
    """Share of sensors whose gel lies on a base that yields."""
    finite_strain: float = 0.3
    """Share of sensors whose gel stiffens as it thins."""
    design_file: DesignFileOption = None
    """Design file (TOML) that all sensors were meant to follow; the published one if not given."""
    pitch_mm: float = 0.2
    """Of the grid on which contacts are solved: coarser is quicker."""
    json: bool = False
    """Print the figures as one JSON object."""

    def run(self) -> int:
        """Make it, and say how its wrenches compare with real ones; raises `DatasetStopped`."""
        try:
            made = self.made()
        except KeyboardInterrupt:
            raise DatasetStopped(self.out) from None
        return print_result(self.json, figures(made), lines(made))

    def made(self) -> "Made":
        """The data set, all of it."""
        from ninedtact.dataset.generation.job import make_dataset

        return make_dataset(
            *(self.out, self.settings, self.workers),
            progress=not self.json,
            device=self.device,
            at_once=self.at_once,
            tell=say,
        )

    @property
    def settings(self) -> "DatasetSettings":
        """As the simulation names it; raises `DatasetImpossible`, `PopulationImpossible`, and what `read_design_file` raises."""
        from ninedtact.dataset.generation.settings import DatasetSettings, Shares
        from ninedtact.simulation.sensor_population import MechanicsShares

        return DatasetSettings(
            pairs=self.pairs,
            size=self.size,
            sensors=self.sensors,
            objects=self.objects,
            names=self.names,
            seed=self.seed,
            objects_seed=self.objects_seed,
            shares=Shares(self.no_contact, self.light_touch),
            kinds=MechanicsShares(self.compliant_base, self.finite_strain),
            design=read_design_or_default(self.design_file),
            pitch_mm=self.pitch_mm,
        )


def say(sentence: str) -> None:
    """One line beside the bar."""
    from tqdm import tqdm

    tqdm.write(f"ninedtact: {sentence}", file=sys.stderr)


def figures(made: "Made") -> dict[str, object]:
    """For a script."""
    return {
        "folder": str(made.folder),
        "pairs": sum(made.kinds.values()),
        "kinds": made.kinds,
        "new_files": made.new_files,
        "device": made.device,
        "percentiles": made.percentiles,
        "off_parts_of_span": made.off,
    }


def lines(made: "Made") -> Iterator[str]:
    """For a person."""
    counted = ", ".join(f"{count} {kind}" for kind, count in made.kinds.items())
    yield f"{made.folder}: {sum(made.kinds.values())} pairs ({counted}), {made.new_files} files new"
    yield from made.table
