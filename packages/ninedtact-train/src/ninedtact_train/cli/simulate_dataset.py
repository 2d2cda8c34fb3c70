"""ninedtact simulate dataset: pairs of image and wrench from many simulated sensors, as a folder that Hugging Face opens."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from ninedtact.cli.result_and_interrupt import print_result
from ninedtact.cli.shared_options import ClusterOption, DesignFileOption, JsonOption, read_design_or_default
from ninedtact_train.cli.dataset import DatasetStopped

if TYPE_CHECKING:
    from ninedtact_train.dataset.generation.generate import GenerationResult
    from ninedtact_train.dataset.generation.settings import GenerationSettings


@dataclass(frozen=True)
class SimulateDatasetCommand:
    """Generate a data set of images and wrenches with simulated sensors. After a stop, run the same command again to continue."""

    out: Path
    """Folder for the data set: new, empty, or begun with the same options."""
    pairs: int = 10_000
    """Number of images with their wrenches."""
    size: tuple[int, int] = (460, 345)
    """Columns and rows of the images; images of every size show the width of the sensing area, 24 mm as published."""
    sensors: int = 20
    """Number of different sensors, which take turns."""
    objects: int = 175
    """Number of generated objects that are pressed."""
    object_names: tuple[str, ...] = ()
    """Objects by name in place of generated ones (ball:4, gear_07, part.stl)."""
    seed: int = 0
    """Seed of sensors, presses and noise."""
    objects_seed: int = 0
    """Seed of generated objects."""
    workers: int = 2
    """Number of processes; one for each core. With a GPU, number of threads that make noise and PNG files."""
    cluster: ClusterOption = None
    device: str = "auto"
    """cpu; cuda or cuda:1 (many contacts at once by torch); auto: a GPU if torch sees one; torch-cpu: for tests, slow."""
    sessions_per_batch: int = 256
    """Sessions that a GPU advances together; the number is reduced if its memory runs out."""
    no_contact: float = 0.03
    """Share of pairs without contact."""
    light_touch: float = 0.05
    """Share of pairs under less than 0.3 N."""
    compliant_base: float = 0.15
    """Share of sensors whose gel lies on a compliant substrate."""
    finite_strain: float = 0.55
    """Share of sensors with a finite-strain gel, which stiffens as it thins."""
    design_file: DesignFileOption = None
    """Design file (TOML) of the sensors; the published design if not given."""
    pitch_mm: float = 0.2
    """Pitch of the grid on which contacts are solved; a coarser one is faster."""
    json: JsonOption = False

    def run(self) -> int:
        """Generate it and print how its wrenches compare with real ones; raises `DatasetStopped`."""
        from ninedtact.parallel_jobs import connect_workers
        from ninedtact_train.dataset.generation.generate import generate_dataset

        try:
            with connect_workers(self.workers, self.cluster) as workers:
                result = generate_dataset(
                    *(self.out, self._settings(), workers),
                    progress=not self.json,
                    device=self.device,
                    sessions_per_batch=self.sessions_per_batch,
                    notify=_print_beside_progress_bar,
                )
        except KeyboardInterrupt:
            raise DatasetStopped(self.out) from None
        return print_result(self.json, _generation_to_json_dict(result), _format_generation(result))

    def _settings(self) -> "GenerationSettings":
        """Return the settings; raises `GenerationImpossible`, `PopulationImpossible`, and what `read_design_file` raises."""
        from ninedtact_train.dataset.generation.settings import GenerationSettings, PairKindShares
        from ninedtact_train.population.sensor_population import NonidealMechanicsShares

        return GenerationSettings(
            pairs=self.pairs,
            size=self.size,
            sensors=self.sensors,
            objects=self.objects,
            object_names=self.object_names,
            seed=self.seed,
            objects_seed=self.objects_seed,
            shares=PairKindShares(self.no_contact, self.light_touch),
            mechanics=NonidealMechanicsShares(self.compliant_base, self.finite_strain),
            design=read_design_or_default(self.design_file),
            pitch_mm=self.pitch_mm,
        )


def _print_beside_progress_bar(sentence: str) -> None:
    from tqdm import tqdm

    tqdm.write(f"ninedtact: {sentence}", file=sys.stderr)


def _generation_to_json_dict(result: "GenerationResult") -> dict[str, object]:
    statistics = result.statistics
    return {
        "folder": str(result.folder),
        "pairs": statistics.pairs,
        "kinds": statistics.kinds,
        "new_files": result.new_files,
        "device": result.device,
        "percentiles": statistics.percentiles,
        "differences_from_real_percentiles": statistics.differences_from_real_percentiles,
    }


def _format_generation(result: "GenerationResult") -> Iterator[str]:
    statistics = result.statistics
    yield f"{result.folder}: {statistics.pairs} pairs ({statistics.kind_counts_text()}), {result.new_files} new files"
    yield from statistics.percentile_lines()
