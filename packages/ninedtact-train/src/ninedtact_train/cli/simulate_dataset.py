"""ninedtact simulate dataset: pairs of image and wrench from many simulated sensors, as a folder that Hugging Face opens."""

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from ninedtact.cli.result_and_interrupt import print_result
from ninedtact.cli.shared_options import ClusterOption, DesignFileOption, JsonOption, read_design_or_default
from ninedtact_train.dataset.generation.settings import GenerationSettings

if TYPE_CHECKING:
    from ninedtact_train.dataset.generation.generate import GenerationResult


@dataclass(frozen=True)
class SimulateDatasetCommand:
    """Generate a data set of images and wrenches with simulated sensors. After a stop, run the same command again to continue."""

    out: Path
    """Folder for the data set: new, empty, or begun with the same options."""
    settings: Annotated[GenerationSettings, arg(name="")] = GenerationSettings()
    workers: int = 2
    """Number of processes; one for each core. With a GPU, number of threads that make noise and PNG files."""
    cluster: ClusterOption = None
    device: str = "auto"
    """cpu; cuda or cuda:1 (many contacts at once by torch); auto: a GPU if torch sees one; torch-cpu: for tests, slow."""
    sessions_per_batch: int = 256
    """Sessions that a GPU advances together; the number is reduced if its memory runs out."""
    design_file: DesignFileOption = None
    """Design file (TOML) with what differs from the published sensor; the sensors are of this design."""
    json: JsonOption = False

    def run(self) -> int:
        """Generate it and print how its wrenches compare with real ones; raises `DatasetError`."""
        from ninedtact.parallel_jobs import connect_workers
        from ninedtact_train.dataset.folder import interrupt_as_stopped
        from ninedtact_train.dataset.generation.generate import generate_dataset

        settings = replace(self.settings, design=read_design_or_default(self.design_file))
        with interrupt_as_stopped(self.out), connect_workers(self.workers, self.cluster) as workers:
            result = generate_dataset(
                *(self.out, settings, workers),
                progress=not self.json,
                device=self.device,
                sessions_per_batch=self.sessions_per_batch,
                notify=_print_beside_progress_bar,
            )
        return print_result(self.json, _generation_to_json_dict(result), _format_generation(result))


def _print_beside_progress_bar(sentence: str) -> None:
    from tqdm import tqdm

    tqdm.write(f"ninedtact: {sentence}", file=sys.stderr)


def _generation_to_json_dict(result: "GenerationResult") -> dict[str, object]:
    from ninedtact.quantities import WRENCH_AXES

    statistics = result.statistics
    compared = ("percentiles", "differences_from_real_percentiles")
    tables = {name: dict(zip(WRENCH_AXES, getattr(statistics, name).tolist(), strict=True)) for name in compared}
    return {
        "folder": str(result.folder),
        "pairs": statistics.pairs,
        "kinds": statistics.kinds,
        "new_files": result.new_files,
        "device": result.device,
        **tables,
    }


def _format_generation(result: "GenerationResult") -> Iterator[str]:
    statistics = result.statistics
    yield f"{result.folder}: {statistics.pairs} pairs ({statistics.kind_counts_text()}), {result.new_files} new files"
    yield from statistics.percentile_lines()
