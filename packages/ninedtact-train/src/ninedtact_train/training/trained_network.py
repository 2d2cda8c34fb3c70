"""Post-processing of a trained network: calibration of its error scale, evaluation on held-out pairs, and the model card.

The scale b that a network predicts distinguishes easy images from hard ones, but does not give the size of errors on data that it
was not trained on. The calibrated scale is gain · b^power, with a gain and a power for each axis. The power is chosen so that
errors divided by the scale follow a Laplace distribution, whose 90 % quantile is ln 10 / ln 2 times its median; the gain then
matches the quantiles.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
import torch
from jaxtyping import Float64, Int
from numpy import ndarray as Array

from ninedtact.design import Gel
from ninedtact.force.network_force import STD_PER_LAPLACE_SCALE, move_prediction_to_skin_centre
from ninedtact.force.onnx_model import MODEL_FORMAT, ModelCard, TrainingProvenance, WrenchPrediction
from ninedtact.force.out_of_distribution import StatisticRange, in_distribution_ranges, out_of_distribution_statistics
from ninedtact.quantities import NO_OBJECT
from ninedtact_train.dataset.split import SplitRows
from ninedtact_train.evaluation import ErrorDistribution, WrenchEvaluation, WrenchPredictions, evaluate_predictions
from ninedtact_train.training.augmentation import augment_batch
from ninedtact_train.training.examples import TrainingExamples, move_torques_from_skin_centre
from ninedtact_train.training.networks import WrenchNetwork
from ninedtact_train.training.settings import TrainingSettings
from ninedtact_train.training.training_loop import TrainingHistory

_SHARES = (0.5, 0.9)
LAPLACE_QUANTILES = -np.log1p(-np.array(_SHARES))
"""Quantiles of |error| / scale of a Laplace distribution for these shares."""
_POWERS = np.linspace(0.5, 1.3, 33)
_FEWEST_IMAGES = 20
"""Smallest number of images from which quantiles are computed."""
_MAX_STATISTICS_IMAGES = 5000
"""Largest number of images from which the statistics of the training's inputs are computed."""
_KEYS_NOT_IN_CARD = ("published", "by_object", "by_sensor")
"""Keys of an evaluation that are not stored in a card."""
_VERSIONED_PACKAGES = ("ninedtact", "torch", "lightning", "numpy")

_Six = Float64[Array, "6"]


def fit_error_scale_correction(
    absolute_error: Float64[Array, "n 6"], scale: Float64[Array, "n 6"]
) -> tuple[_Six, _Six]:
    """Return gain and power of each axis, from errors and predicted scales in units of the labels; ones for too few images."""
    if len(absolute_error) < _FEWEST_IMAGES:
        return np.ones(6), np.ones(6)
    both = np.array([_fit_axis_correction(absolute_error[:, axis], scale[:, axis]) for axis in range(6)])
    return both[:, 0], both[:, 1]


def _fit_axis_correction(absolute_error: Float64[Array, " n"], scale: Float64[Array, " n"]) -> tuple[float, float]:
    """Return gain and power of one axis; among powers that fit equally well, the one nearest to one."""
    quantiles = [np.maximum(np.quantile(absolute_error / scale**power, _SHARES), 1e-12) for power in _POWERS]
    log_ratios = np.log(np.array(quantiles) / LAPLACE_QUANTILES)
    chosen = int(np.argmin(np.abs(np.diff(log_ratios)[:, 0]) + 0.01 * np.abs(_POWERS - 1)))
    return float(np.exp(log_ratios[chosen].mean())), float(_POWERS[chosen])


@dataclass(frozen=True)
class TrainedNetwork:
    """A trained network with the examples that it was trained and is validated on."""

    network: WrenchNetwork
    examples: TrainingExamples
    rows: SplitRows
    settings: TrainingSettings

    def calibrate_scale(self) -> None:
        """Set the network's gain and power so that its intervals cover what they claim on the held-out pairs."""
        found, unit = self._predict(self.rows.test), self.network.unit.double().cpu().numpy()
        if np.isfinite(found.scale).all():
            labels = move_torques_from_skin_centre(self.examples.wrench[self.rows.test], self.settings.about_mm)
            absolute_error = np.abs(found.wrench - labels) / unit
            corrections = fit_error_scale_correction(absolute_error, found.scale / unit)
            for parameter, values in zip((self.network.gain, self.network.power), corrections, strict=True):
                parameter.copy_(torch.from_numpy(values))

    def evaluate_held_out(self) -> WrenchEvaluation:
        """Evaluate the network on the held-out pairs, torques about the skin's centre."""
        test = self.rows.test
        found = move_prediction_to_skin_centre(self._predict(test), self.settings.about_mm)
        examples = self.examples
        truth = np.asarray(examples.wrench[test], np.float64)
        std = STD_PER_LAPLACE_SCALE * found.scale if np.isfinite(found.scale).all() else None
        objects, sensors = (np.asarray(names)[test].tolist() for names in (examples.objects, examples.sensors))
        return evaluate_predictions(
            WrenchPredictions(truth, found.wrench, std, ErrorDistribution.LAPLACE, objects, sensors, (0.0, 0.0, 0.0))
        )

    def build_card(self, evaluation: WrenchEvaluation, history: TrainingHistory, name: str, licence: str) -> ModelCard:
        """Return the model card with ranges, input statistics, training summary and validation scores."""
        wrench = self.examples.wrench[self.rows.train].astype(float)
        figures = {key: value for key, value in evaluation.to_json_dict().items() if key not in _KEYS_NOT_IN_CARD}
        return ModelCard(
            format=MODEL_FORMAT,
            name=name,
            network=self.settings.network,
            input=self.settings.input,
            about_mm=self.settings.about_mm,
            modulus_mpa=Gel().shear_modulus_mpa,
            wrench_min=tuple(wrench.min(0).tolist()),
            wrench_max=tuple(wrench.max(0).tolist()),
            input_ranges=self._input_statistics(),
            training=self._summarise_training(history),
            evaluation={"validation": figures},
            licence=licence,
        )

    @property
    def median_mae(self) -> list[float]:
        """Mean absolute error by axis, N and N·m, of always predicting the median of the held-out wrenches."""
        wrench = move_torques_from_skin_centre(self.examples.wrench[self.rows.test], self.settings.about_mm)
        return np.maximum(np.abs(wrench - np.median(wrench, axis=0)).mean(0), 1e-12).tolist()

    def _predict(self, rows: Int[Array, " n"]) -> WrenchPrediction:
        with torch.no_grad():
            outputs = [self.network(shown) for shown in self._network_inputs(rows)]
        arrays = [torch.cat(output).double().cpu().numpy() for output in zip(*outputs, strict=True)]
        return WrenchPrediction(arrays[0], arrays[1] if len(arrays) > 1 else np.full_like(arrays[0], np.inf))

    def _network_inputs(self, rows: Int[Array, " n"], augmented: bool = False) -> Iterator[torch.Tensor]:
        """Yield the network's inputs on its device, one batch at a time, augmented as in training where requested."""
        settings, device = self.settings, self.network.unit.device
        generator = torch.Generator(device).manual_seed(settings.seed)
        for at in range(0, len(rows), settings.batch):
            batch = self.examples.batch(rows[at : at + settings.batch]).to(device).to_float()
            if augmented:
                batch = augment_batch(settings.augmentation, batch, settings.input.mm_per_px, generator)
            yield batch.network_input(settings.input.channels)

    def _summarise_training(self, history: TrainingHistory) -> TrainingProvenance:
        kept = np.concatenate([self.rows.train, self.rows.test])
        return TrainingProvenance(
            pairs=len(self.rows.train),
            validation_pairs=len(self.rows.test),
            objects=len(set(np.asarray(self.examples.objects)[kept].tolist()) - {NO_OBJECT}),
            sensors=len(set(np.asarray(self.examples.sensors)[kept].tolist())),
            epochs=self.settings.epochs,
            best_epoch=int(history.best_epoch["epoch"]),
            seconds=round(history.seconds, 1),
            settings=self.settings.to_json_dict(),
            versions={package: version(package) for package in _VERSIONED_PACKAGES},
        )

    def _input_statistics(self) -> dict[str, StatisticRange]:
        """Return the ranges of the statistics of the training's inputs, by which out-of-distribution inputs are detected."""
        train = self.rows.train
        chosen = train[:: -(-len(train) // _MAX_STATISTICS_IMAGES)]
        channels = self.settings.input.channels
        each = [
            out_of_distribution_statistics(shown.cpu().numpy(), channels)
            for shown in self._network_inputs(chosen, augmented=True)
        ]
        return in_distribution_ranges({name: np.concatenate([one[name] for one in each]) for name in each[0]})
