"""Settings of a force model's training, and the presets `default`, `corrector` and `paper`.

The resolved training settings are stored beside the model and in its card.
"""

from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from ninedtact.design import ForceTorqueMount
from ninedtact.field_bounds import require_within_bounds
from ninedtact.force.network_input import InputChannels, NetworkInputSettings, full_resolution_input_settings
from ninedtact_train.training.augmentation import NO_AUGMENTATION, Augmentation
from ninedtact_train.training.networks import require_network_input_size

_Point = tuple[float, float, float]


@dataclass(frozen=True)
class TrainingSettings:
    """All settings that determine the trained model; raises `InputError`."""

    network: str = "moments"
    input: NetworkInputSettings = NetworkInputSettings(InputChannels.HEIGHTS_AND_SENSOR)
    epochs: Annotated[int, Meta(gt=0)] = 40
    batch: Annotated[int, Meta(gt=0)] = 64
    learning_rate: Annotated[float, Meta(gt=0)] = 2e-3
    """Learning rate; the highest one where the schedule varies it."""
    optimiser: Literal["adam", "adamw"] = "adamw"
    schedule: Literal["constant", "one cycle"] = "one cycle"
    weight_decay: float = 1e-2
    labels: Literal["spread", "ranges"] = "spread"
    """Unit of each axis of the labels. spread: the mean distance from the median, without an offset. ranges: the range of values,
    with the lowest value as offset."""
    about_mm: _Point = (0.0, 0.0, 0.0)
    """Point of the torques that the network learns; estimated torques are moved to the skin's centre afterwards."""
    scale_weight: Annotated[float, Meta(ge=0)] = 0.05
    """Weight of the scale's negative log-likelihood relative to the absolute error; 0: the network predicts no scale."""
    augmentation: Augmentation = field(default_factory=Augmentation)
    seed: Annotated[int, Meta(ge=0)] = 0

    def __post_init__(self) -> None:
        require_network_input_size(self.network, self.input)
        require_within_bounds(self)

    def to_json_dict(self) -> dict[str, Any]:
        """Return the settings as plain values for JSON."""
        return msgspec.json.decode(msgspec.json.encode(self), type=dict[str, Any])


DEFAULT_TRAINING = TrainingSettings()
PAPER_TRAINING = TrainingSettings(
    network="densenet169",
    input=full_resolution_input_settings(InputChannels.DEFORMATION),
    epochs=200,
    learning_rate=5e-4,
    optimiser="adam",
    schedule="constant",
    weight_decay=0.0,
    labels="ranges",
    about_mm=ForceTorqueMount().origin_mm,
    scale_weight=0.0,
    augmentation=NO_AUGMENTATION,
)
"""Training as in the 9DTact paper, section V (docs/references.md)."""
CORRECTOR_TRAINING = TrainingSettings(
    input=NetworkInputSettings(InputChannels.PHYSICS),
    augmentation=replace(Augmentation(), heights=replace(NO_AUGMENTATION.heights, features=0.05)),
)
"""Training of a network that corrects the wrench by physics. Heights and tractions belong together, so they are not perturbed."""
TRAINING_PRESETS = {"default": DEFAULT_TRAINING, "corrector": CORRECTOR_TRAINING, "paper": PAPER_TRAINING}
