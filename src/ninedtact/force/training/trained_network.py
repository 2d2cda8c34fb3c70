"""Errors that cover what they claim, as images of held-out sensors and objects show.

A network's own scale b knows which images are hard, but not how large errors are where it was not trained. What is told is
gain · b^power, both by axis: the power so that errors over it are distributed like Laplace's, their 90 % quantile ln 10 / ln 2
times the median; the gain so that the quantiles are right themselves.

What a training comes to: errors set right, an evaluation on what was held out, and the model's card.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
import torch
from jaxtyping import Float64, Int
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.force.card import FORMAT, Card, TrainingSummary
from ninedtact.force.evaluation import ErrorDistribution, WrenchEvaluation, WrenchPredictions, evaluate_predictions
from ninedtact.force.likeness import Range, numbers, ranges
from ninedtact.force.model_file import Prediction
from ninedtact.force.network_force import DEVIATIONS_PER_SCALE, moved_to_skin
from ninedtact.force.networks import WrenchNetwork
from ninedtact.force.splits import Rows
from ninedtact.force.training.examples import BatchDataset, TrainingExamples, move_torque_reference
from ninedtact.force.training.lightning_compat import MetricsHistory
from ninedtact.force.training.settings import TrainingSettings

SHARES = (0.5, 0.9)
LAPLACE_QUANTILES = -np.log1p(-np.array(SHARES))
"""|error| / scale below which these shares of a Laplace distribution lie."""
POWERS = np.linspace(0.5, 1.3, 33)
FEWEST = 20
"""Images that quantiles need."""

Six = Float64[Array, "6"]


def fit_scale_correction(off: Float64[Array, "n 6"], scale: Float64[Array, "n 6"]) -> tuple[Six, Six]:
    """From absolute errors and untouched scales, both in units of the labels."""
    if len(off) < FEWEST:
        return np.ones(6), np.ones(6)
    both = np.array([_fit_axis_correction(off[:, axis], scale[:, axis]) for axis in range(off.shape[1])])
    return both[:, 0], both[:, 1]


def _fit_axis_correction(off: Float64[Array, " n"], scale: Float64[Array, " n"]) -> tuple[float, float]:
    """Gain and power of one axis; where several powers do as well, the nearest to one."""
    misses = [np.log(_error_quantiles(off, scale, power) / LAPLACE_QUANTILES) for power in POWERS]
    wrong = [abs(miss[1] - miss[0]) + 0.01 * abs(power - 1) for miss, power in zip(misses, POWERS, strict=True)]
    chosen = int(np.argmin(wrong))
    return float(np.exp(misses[chosen].mean())), float(POWERS[chosen])


def _error_quantiles(off: Float64[Array, " n"], scale: Float64[Array, " n"], power: float) -> Float64[Array, "2"]:
    """Of errors over scales."""
    return np.maximum(np.quantile(off / scale**power, SHARES), 1e-12)


MOST_LOOKED_AT = 5000
"""Images whose numbers tell what training saw."""
LEFT_OUT = ("published", "by_object", "by_sensor")
"""Of the evaluation that the card holds."""
WITH = ("ninedtact", "torch", "lightning", "numpy")


@dataclass(frozen=True)
class TrainedNetwork:
    """A trained network with what it was trained and is judged on."""

    network: WrenchNetwork
    examples: TrainingExamples
    """Torques about the settings' point."""
    rows: Rows
    settings: TrainingSettings

    def set_errors_right(self) -> None:
        """So that its intervals cover what they claim on what was held out."""
        found, unit = self.answers(self.rows.test), self.network.unit.double().cpu().numpy()
        if np.isfinite(found.scale).all():
            off = np.abs(found.wrench - self.examples.wrench[self.rows.test]) / unit
            for part, values in zip(
                (self.network.gain, self.network.power), fit_scale_correction(off, found.scale / unit), strict=True
            ):
                part.copy_(torch.from_numpy(values))

    @property
    def evaluation(self) -> WrenchEvaluation:
        """On what was held out, torques about the skin's centre."""
        test = self.rows.test
        found = moved_to_skin(self.answers(test), self.settings.about_mm)
        truth = np.asarray(self.at_skin.wrench[test], np.float64)
        error = DEVIATIONS_PER_SCALE * found.scale if np.isfinite(found.scale).all() else None
        objects, sensors = (
            np.asarray(names)[test].tolist() for names in (self.examples.objects, self.examples.sensors)
        )
        return evaluate_predictions(
            WrenchPredictions(truth, found.wrench, error, ErrorDistribution.LAPLACE, objects, sensors, (0.0, 0.0, 0.0))
        )

    def answers(self, rows: Int[Array, " n"]) -> Prediction:
        """Of the network, to examples as they are."""
        with torch.no_grad():
            parts = [self.network(shown) for shown in self.shown(rows)]
        together = [torch.cat(part).double().cpu().numpy() for part in zip(*parts, strict=True)]
        return Prediction(together[0], together[1] if len(together) > 1 else np.full_like(together[0], np.inf))

    def shown(self, rows: Int[Array, " n"], changed: bool = False) -> Iterator[torch.Tensor]:
        """Inputs on the network's device, a batch at a time, as they are or as training changed them."""
        settings, device = self.settings, self.network.unit.device
        chance = torch.Generator(device).manual_seed(settings.seed)
        for at in range(0, len(rows), settings.batch):
            batch = BatchDataset(self.examples)[rows[at : at + settings.batch]].to(device).floating()
            if changed:
                batch = settings.augmentation(batch, settings.input.mm_per_px, chance)
            yield batch.channels(settings.input.channels)

    def card(self, evaluation: WrenchEvaluation, history: MetricsHistory, name: str, licence: str) -> Card:
        """What a user must know."""
        wrench = self.at_skin.wrench[self.rows.train].astype(float)
        table = {key: value for key, value in evaluation.as_table().items() if key not in LEFT_OUT}
        return Card(
            format=FORMAT,
            name=name,
            network=self.settings.network,
            input=self.settings.input,
            about_mm=self.settings.about_mm,
            modulus_mpa=Gel().shear_modulus_mpa,
            lowest=tuple(wrench.min(0).tolist()),
            highest=tuple(wrench.max(0).tolist()),
            likeness=self.likeness,
            training=self.summary(history),
            evaluation={"validation": table},
            licence=licence,
        )

    def summary(self, history: MetricsHistory) -> TrainingSummary:
        """Where the model comes from."""
        kept = np.concatenate([self.rows.train, self.rows.test])
        return TrainingSummary(
            pairs=len(self.rows.train),
            validation_pairs=len(self.rows.test),
            objects=len(set(np.asarray(self.examples.objects)[kept].tolist())),
            sensors=len(set(np.asarray(self.examples.sensors)[kept].tolist())),
            epochs=self.settings.epochs,
            best_epoch=int(history.best["epoch"]),
            seconds=round(history.seconds, 1),
            settings=self.settings.as_table(),
            versions={package: version(package) for package in WITH},
        )

    @property
    def likeness(self) -> dict[str, Range]:
        """Numbers of the images as training saw them."""
        train = self.rows.train
        looked_at = train[:: -(-len(train) // MOST_LOOKED_AT)]
        channels = self.settings.input.channels
        each = [numbers(shown.cpu().numpy(), channels) for shown in self.shown(looked_at, changed=True)]
        return ranges({name: np.concatenate([one[name] for one in each]) for name in each[0]})

    @property
    def at_skin(self) -> TrainingExamples:
        """Torques about the skin's centre."""
        x, y, z = self.settings.about_mm
        return move_torque_reference(self.examples, (-x, -y, -z))

    @property
    def median_mae(self) -> list[float]:
        """Of always answering the median, as the curves' errors are counted."""
        wrench = self.examples.wrench[self.rows.test]
        return np.maximum(np.abs(wrench - np.median(wrench, axis=0)).mean(0), 1e-12).tolist()
