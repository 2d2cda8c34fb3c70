"""ninedtact simulate sequences: objects that move over simulated sensors, as a data set with true pose and slip."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from ninedtact.cli.result_and_interrupt import print_result
from ninedtact.cli.shared_options import ClusterOption, JsonOption
from ninedtact_train.dataset.generation.settings import SequenceSettings

if TYPE_CHECKING:
    from ninedtact_train.dataset.generation.generate import GenerationResult


@dataclass(frozen=True)
class SimulateSequencesCommand:
    """Generate a data set of sequences: objects that are dragged, twisted, rolled, handed over and lifted on simulated sensors.

    There are 60 images per second, with true pose and slip. After a stop, run the same command again to continue.
    """

    out: Path
    """Folder for the data set: new, empty, or begun with the same options."""
    settings: Annotated[SequenceSettings, arg(name="")] = SequenceSettings()
    workers: int = 2
    """Number of processes; one for each core."""
    cluster: ClusterOption = None
    json: JsonOption = False

    def run(self) -> int:
        """Generate it and print what it holds; raises `DatasetError`."""
        from ninedtact.parallel_jobs import connect_workers
        from ninedtact_train.dataset.folder import interrupt_as_stopped
        from ninedtact_train.dataset.generation.sequences import generate_sequences

        with interrupt_as_stopped(self.out), connect_workers(self.workers, self.cluster) as workers:
            result = generate_sequences(self.out, self.settings, workers, progress=not self.json)
        return print_result(self.json, _sequences_to_json_dict(result), _format_sequences(result))


def _sequences_to_json_dict(result: "GenerationResult") -> dict[str, object]:
    statistics = result.statistics
    return {
        "folder": str(result.folder),
        "images": statistics.pairs,
        "sensors": len(statistics.sensors),
        "objects": statistics.object_count,
        "new_files": result.new_files,
    }


def _format_sequences(result: "GenerationResult") -> Iterator[str]:
    statistics = result.statistics
    yield (
        f"{result.folder}: {statistics.pairs} images of {len(statistics.sensors)} sensors and {statistics.object_count} objects, "
        f"{result.new_files} new sequences"
    )
