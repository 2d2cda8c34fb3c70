"""A data set's folder → what a training learns from, and which of it is held out to check with."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ninedtact.cli.force.own_sensors import members_of, sensors_for, tell_refused

if TYPE_CHECKING:
    from ninedtact.force.dataset_split import SplitRows, SplitSettings
    from ninedtact.force.network_input import NetworkInputSettings
    from ninedtact.force.training.examples import TrainingExamples
    from ninedtact.simulation.sensor_population import SampledSensor

HeldOut = Literal["sensor_and_object", "object", "sensor", "standard"]


@dataclass(frozen=True)
class TrainingData:
    """A folder, and how it is to be read."""

    folder: Path
    grid: "NetworkInputSettings"
    sensors: Path | None = None
    workers: int = 1
    progress: bool = False

    def read(self) -> tuple["TrainingExamples", Sequence[str]]:
        """TrainingExamples with labels as of one modulus where the moduli are known, and their ids."""
        examples, ids = self.of_heights() if self.grid.channels.of_heights else self.of_images()
        return at_one_modulus(examples, members_of(self.folder)), ids

    def of_heights(self) -> tuple["TrainingExamples", Sequence[str]]:
        """Heights by the calibration of each sensor."""
        import numpy as np

        from ninedtact.dataset.height_cache import load_height_pairs
        from ninedtact.force.network_input import sensor_features_of
        from ninedtact.force.training.examples import TrainingExamples

        sensors = sensors_for(self.folder, self.sensors, self.workers, self.progress)
        tell_refused(sensors.refused)
        pairs = load_height_pairs(
            self.folder,
            sensors.by_name,
            self.grid.grid,
            workers=self.workers,
            left_out=sensors.refused,
            progress=self.progress,
        )
        rows = {name: sensor_features_of(sensor.shape, sensor.gel).row for name, sensor in sensors.by_name.items()}
        traits = np.array([rows[name] for name in pairs.sensors.tolist()])
        names = pairs.objects.tolist(), pairs.sensors.tolist()
        return TrainingExamples(pairs.z_mm, pairs.wrenches, *names, sensor_features=traits), pairs.ids.tolist()

    def of_images(self) -> tuple["TrainingExamples", Sequence[str]]:
        """Grey images with their references."""
        from ninedtact.dataset.reader import load_dataset
        from ninedtact.force.training.examples import TrainingExamples

        size = self.grid.cols, self.grid.rows
        pairs = load_dataset(self.folder, size, threads=self.workers, progress=self.progress)
        names = pairs.objects.values.tolist(), pairs.sensors.values.tolist()
        codes, files = pairs.references.codes, pairs.decoded
        return TrainingExamples(
            files.images, pairs.wrenches, *names, references=files.references, reference_of=codes
        ), pairs.ids.tolist()


def designed_width_mm(data: Path) -> float | None:
    """Of the sensing area that the twins of a data set were meant to have; none of a data set of real sensors."""
    widths = (member.design.sensing_area.width_mm for member in members_of(data).values())
    return max(widths, default=None)


def at_one_modulus(examples: "TrainingExamples", members: Mapping[str, "SampledSensor"]) -> "TrainingExamples":
    """Wrenches of twins as gels of the design's modulus would have given them; real ones as they were measured."""
    import numpy as np

    from ninedtact.design import Gel

    usual = Gel().shear_modulus_mpa
    moduli = {name: member.gel.shear_modulus_mpa for name, member in members.items()}
    return examples.scale_to_design_modulus(np.array([moduli.get(name, usual) for name in examples.sensors]))


@dataclass(frozen=True)
class Division:
    """What is learnt from, and what is checked with."""

    held_out: HeldOut | None = None
    """None: objects and sensors, or objects alone where there is one sensor."""
    part: float = 0.1
    """Of the objects, of the sensors or of the pairs."""
    split: Path | None = None
    """A split whose part to train is divided, the part to test never looked at."""
    seed: int = 0

    def rows(self, ids: Sequence[str], examples: "TrainingExamples") -> "SplitRows":
        """Raises `SplitImpossible`, `SplitUnfit`."""
        import numpy as np

        from ninedtact.force.dataset_split import PairLabels, SplitRows, read_split, split_dataset

        train = np.arange(len(ids)) if self.split is None else read_split(self.split).rows(ids).train
        some, objects, sensors = (
            np.asarray(names)[train].tolist() for names in (ids, examples.objects, examples.sensors)
        )
        inner = split_dataset(
            PairLabels(some, objects, sensors), self.settings(set(objects), set(sensors), len(some))
        ).rows(some)
        return SplitRows(train[inner.train], train[inner.test])

    def settings(self, objects: set[str], sensors: set[str], pairs: int) -> "SplitSettings":
        """As many of each as make up the part, and one at least."""
        from ninedtact.force.dataset_split import NO_OBJECT, SplitSettings

        kind = self.held_out or ("sensor_and_object" if len(sensors) > 1 else "object")
        counts = [max(1, round(self.part * count)) for count in (len(objects - {NO_OBJECT}), len(sensors), pairs)]
        return SplitSettings(kind, objects=counts[0], sensors=counts[1], pairs=counts[2], seed=self.seed)
