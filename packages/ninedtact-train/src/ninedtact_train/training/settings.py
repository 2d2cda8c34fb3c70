"""Settings of a force model's training, the presets `default` and `paper`, and the settings of the hardware.

The resolved training settings are stored beside the model and in its card. This file loads no torch, so that the command line
reads it quickly.
"""

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from ninedtact.bounds import require_within_bounds
from ninedtact.design import ForceTorqueMount
from ninedtact.errors import InputError
from ninedtact.force.network_input import InputChannels, NetworkInputSettings, full_resolution_input_settings

NetworkName = Literal["moments", "densenet121", "densenet169"]
SMALLEST_DENSENET_PX = 32
"""Smallest side of an image for DenseNet, which halves it five times."""
_Point = tuple[float, float, float]


@dataclass(frozen=True)
class GeometricAugmentation:
    """Ranges by which examples are mirrored, rotated, shifted and scaled; each image of a batch has its own random transform."""

    mirror: bool = True
    """Whether images are mirrored along x, along y, both or neither, each with equal probability."""
    transformed_share: float = 0.5
    """Part of the images that are rotated, shifted and scaled; the others stay sharp."""
    max_rotation_deg: float = 10.0
    max_shift_mm: float = 0.6
    scale_std: float = 0.005


@dataclass(frozen=True)
class HeightPerturbations:
    """Perturbations that simulate errors of a depth calibration and its images: standard deviations, except those named `max`."""

    gain: float = 0.03
    """Relative error of indentations and, independently, of bulges."""
    offset_mm: float = 0.004
    tilt: float = 0.0005
    """Slope along x and along y, mm per mm."""
    max_noise_mm: float = 0.012
    max_noise_width_mm: float = 0.6
    """Standard deviation of the Gaussian that smooths the noise."""
    features: float = 0.05
    """Relative error of the features of the sensor's light; the gel's thickness is not changed."""


@dataclass(frozen=True)
class PhotometricPerturbations:
    """Perturbations that simulate errors of light and camera: standard deviations, except the one named `max`."""

    gain: float = 0.05
    """Relative change of brightness of image and reference together, as by another lamp."""
    drift: float = 0.004
    """Relative change of brightness between reference and image, as by a lamp that warms up."""
    max_noise_grey: float = 0.7


@dataclass(frozen=True)
class Augmentation:
    """All random changes of a batch (`augmentation.py`): geometric ones, then perturbations of heights or of images."""

    geometric: GeometricAugmentation = GeometricAugmentation()
    heights: HeightPerturbations = HeightPerturbations()
    """Perturbations that are applied to height maps."""
    photometric: PhotometricPerturbations = PhotometricPerturbations()
    """Perturbations that are applied to images with references."""


NO_AUGMENTATION = Augmentation(
    GeometricAugmentation(False, 0.0, 0.0, 0.0, 0.0),
    HeightPerturbations(0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
    PhotometricPerturbations(0.0, 0.0, 0.0),
)


@dataclass(frozen=True)
class TrainingSettings:
    """All settings that determine the trained model; raises `InputError`."""

    network: Annotated[NetworkName, Meta(description="Architecture of the network.")] = "moments"
    input: NetworkInputSettings = NetworkInputSettings(InputChannels.HEIGHTS_AND_SENSOR)
    epochs: Annotated[int, Meta(gt=0, description="Number of passes over all pairs.")] = 40
    batch: Annotated[int, Meta(gt=0, description="Pairs in a training step.")] = 64
    learning_rate: Annotated[
        float, Meta(gt=0, description="Learning rate; the highest one where the preset varies it.")
    ] = 2e-3
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
        require_within_bounds(self)
        rows, cols = self.input.rows, self.input.cols
        if self.network == "moments" and (rows % 4 or cols % 4):
            raise InputError(
                expected="sides that are multiples of 4 for moments", got=f"{cols} x {rows}", remedy="take 80 x 60"
            )
        if self.network != "moments" and min(rows, cols) < SMALLEST_DENSENET_PX:
            raise InputError(
                expected=f"at least {SMALLEST_DENSENET_PX} x {SMALLEST_DENSENET_PX} pixels for {self.network}",
                got=f"{cols} x {rows}",
                remedy="take larger images",
            )

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
TRAINING_PRESETS = {"default": DEFAULT_TRAINING, "paper": PAPER_TRAINING}


@dataclass(frozen=True)
class ComputeSettings:
    """Lightning's flags for the hardware that a training runs on; they change its speed, not what is learnt."""

    accelerator: str = "auto"
    """cpu, gpu, auto …"""
    devices: int | str = 1
    """How many devices, or which: 2, auto, 0,3."""
    nodes: int = 1
    """Machines."""
    strategy: str = "auto"
    """Strategy for several devices, such as ddp."""
    precision: Literal["32-true", "bf16-mixed", "16-mixed"] = "32-true"
    """Numeric precision; bf16-mixed is faster on a GPU."""
