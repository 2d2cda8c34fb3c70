"""An estimator on a data set: every image read by its own sensor, the answers beside the truth."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ninedtact.cli.force.estimators import BOTH, PHYSICS

if TYPE_CHECKING:
    from ninedtact.dataset.calibrated_readings import CalibratedSensor
    from ninedtact.force.estimator import ForceEstimator
    from ninedtact.force.evaluation import WrenchPredictions
    from ninedtact.simulation.sensor_population import SampledSensor

Modulus = Literal["true", "design", "weighed"]


@dataclass(frozen=True)
class JudgedData:
    """A data set, and what is judged on it."""

    folder: Path
    force: str = PHYSICS
    sensors: Path | None = None
    modulus: Modulus = "true"
    every: int = 1
    workers: int = 2
    progress: bool = False
    gate: bool = True
    """Whether a network is asked only where something touches."""

    def predictions(self) -> "WrenchPredictions":
        """All answers; raises what estimators and data sets raise."""
        import numpy as np
        from tqdm import tqdm

        from ninedtact.cli.force.own_sensors import members_of
        from ninedtact.dataset.calibrated_readings import iterate_readings
        from ninedtact.force.evaluation import ErrorDistribution, WrenchPredictions

        (sensors, refused), members = self.calibrated(), members_of(self.folder)
        estimators: dict[str, ForceEstimator] = {}
        truth, found, error, objects, names = [], [], [], [], []
        for pair in tqdm(
            iterate_readings(self.folder, sensors, self.every, refused), unit="pair", disable=not self.progress
        ):
            if pair.sensor not in estimators:
                estimators[pair.sensor] = self.estimator(sensors[pair.sensor], members.get(pair.sensor))
            estimator = estimators[pair.sensor]
            estimator.forget()
            estimate = estimator.estimate(pair.reading)
            truth.append(pair.wrench)
            found.append(estimate.wrench.six)
            error.append(estimate.error)
            objects.append(pair.object)
            names.append(pair.sensor)
        six = [np.array(rows, float).reshape(-1, 6) for rows in (truth, found, error)]
        gaussian = self.force.partition(":")[0] in (PHYSICS, BOTH)
        distribution = ErrorDistribution.GAUSSIAN if gaussian else ErrorDistribution.LAPLACE
        claimed = np.where(np.isfinite(six[2]), six[2], np.nan)
        return WrenchPredictions(six[0], six[1], claimed, distribution, objects, names, (0.0, 0.0, 0.0))

    def calibrated(self) -> "tuple[dict[str, CalibratedSensor], dict[str, str]]":
        """Every sensor, its gel as stiff as a weighing would have told; and those that could not be calibrated."""
        from ninedtact.cli.force.own_sensors import members_of, sensors_for, tell_refused

        known = sensors_for(self.folder, self.sensors, self.workers, self.progress)
        tell_refused(known.refused)
        members = members_of(self.folder) if self.modulus == "true" else {}
        sensors = {
            name: replace(
                one,
                gel=replace(one.gel, shear_modulus_mpa=members[name].gel.shear_modulus_mpa)
                if name in members
                else one.gel,
            )
            for name, one in known.by_name.items()
        }
        return sensors, known.refused

    def estimator(self, sensor: "CalibratedSensor", member: "SampledSensor | None") -> "ForceEstimator":
        """The one that was named, on this sensor."""
        from ninedtact.cli.force.estimators import on_sensor, ungated
        from ninedtact.cli.force.weighing import weighed

        estimator = on_sensor(self.force, sensor.shape, sensor.gel)
        if not self.gate:
            estimator = ungated(estimator)
        if member is None or self.modulus != "weighed":
            return estimator
        return weighed(estimator, member, sensor.shape)
