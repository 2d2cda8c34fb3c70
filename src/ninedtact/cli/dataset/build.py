"""ninedtact dataset build: recordings, other projects' data and the twin's → one data set."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from ninedtact.cli.dataset.limits import Limits
from ninedtact.cli.simulate.dataset import DatasetStopped
from ninedtact.cli.terminal import print_result

if TYPE_CHECKING:
    from ninedtact.dataset.build import Built
    from ninedtact.dataset.sources.source import Statements
    from ninedtact.shape.rectification import Rectification


@dataclass(frozen=True)
class Build:
    """Build one data set from any number of sources. Run again after a stop, it goes on where it was."""

    sources: tyro.conf.Positional[tuple[str, ...]]
    """PATH or NAME=PATH: recordings (.mcap), the original project's Dataset folder, force episodes (.npz), a data set."""
    out: Path
    """Folder for the data set: new, empty, or begun with the same words."""
    drop: bool = False
    """Leave out the pairs that the checks list."""
    strict: bool = False
    """Exit with 1 where the checks list anything."""
    licence: str | None = None
    """Of the data, as Hugging Face names it: mit, cc-by-4.0."""
    workers: int = 2
    """Processes; one for each core."""
    sensor: Path | None = None
    """Sensor folder for recordings that carry none."""
    sensor_name: str | None = None
    """Which sensor took the original project's or the episodes' images."""
    reference: Path | None = None
    """Image of the untouched skin, for an image/ folder without mixed_image/."""
    origin_mm: tuple[float, float, float] | None = None
    """What the labels' torques are about; the original project's: 0 0 -35, the centre of the skin being 0 0 0."""
    axes: str = "+x,+y,+z"
    """Which measured axes are the sensor's x, y and z; --axes=-x,-y,-z turns what the skin does to the object around."""
    mm_per_px: float | None = None
    """Scale of the original project's or the episodes' images."""
    limits: Limits = Limits()
    json: bool = False
    """Print the figures as one JSON object."""

    def run(self) -> int:
        """Build it, and say what is in it; raises `DatasetStopped`, and `FindingsListed` where that is asked for."""
        from ninedtact.dataset.report import REPORT, require_nothing_listed

        try:
            built = self.built()
        except KeyboardInterrupt:
            raise DatasetStopped(self.out) from None
        print_result(self.json, figures(built), lines(built))
        if self.strict:
            require_nothing_listed(built.report, self.out / REPORT)
        return 0

    def built(self) -> "Built":
        """The data set, all of it."""
        from ninedtact.dataset.build import BuildSettings, build
        from ninedtact.dataset.sources.detect import Finder

        sources = Finder(read_rectification, self.statements).sources(self.sources)
        settings = BuildSettings(self.limits.settings(), self.drop, self.licence)
        return build(self.out, sources, settings, self.workers, progress=not self.json)

    @property
    def statements(self) -> "Statements":
        """What sources do not say themselves; raises `SourceUnknown`."""
        from ninedtact.dataset.sources.source import Statements, axes_of

        return Statements(
            origin_mm=self.origin_mm,
            axes=axes_of(self.axes),
            mm_per_px=self.mm_per_px,
            sensor=self.sensor_name,
            reference=self.reference,
            sensor_folder=self.sensor,
        )


def read_rectification(folder: Path) -> "Rectification":
    """How a sensor's images are rectified."""
    from ninedtact.calibration.sensor_folder import load_sensor

    return load_sensor(folder).rectification


def figures(built: "Built") -> dict[str, object]:
    """For a script."""
    return {
        "folder": str(built.folder),
        "pairs": built.contents.pairs,
        "kinds": built.contents.kinds,
        "sensors": len(built.contents.sensors),
        "objects": built.contents.things,
        "checked": built.report.pairs,
        "without_fault": built.report.without_fault,
        "findings": built.report.counts,
        "dropped": built.report.dropped,
    }


def lines(built: "Built") -> Iterator[str]:
    """For a person."""
    contents = built.contents
    counted = ", ".join(f"{count} {kind}" for kind, count in contents.kinds.items())
    yield f"{built.folder}: {contents.pairs} pairs ({counted}), {len(contents.sensors)} sensors, {contents.things} objects"
    yield from built.report.lines()
    yield from contents.percentiles
