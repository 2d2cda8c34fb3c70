"""Force estimator with the original 9DTact project's network: DenseNet-169 on the mixed image, from the user's weights file (.pt).

The network's six outputs between 0 and 1 are fractions of fixed ranges, and its torques are about a force/torque sensor 35 mm below
the skin (docs/references.md, code of 9DTact). Its training had no images without contact, so that it estimates forces where
nothing touches unless contact detection precedes it.
"""

from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.design import ForceTorqueMount
from ninedtact.errors import FileFormatError
from ninedtact.force.contact_detection import ContactTest, detect_contact
from ninedtact.force.estimator_and_scale import ForceEstimator, unknown_wrench_estimate, zero_wrench
from ninedtact.force.hidden_twist import hidden_torque_nm
from ninedtact.force.network_input import InputChannels, NetworkInputBuilder, full_resolution_input_settings
from ninedtact.quantities import EstimateWarning, Wrench, WrenchEstimate, diagonal_covariance
from ninedtact.reading import Reading
from ninedtact_train.collecting.training_pair_rule import wrench_limits
from ninedtact_train.evaluation.evaluation import PUBLISHED_SCORES_AT_SKIN
from ninedtact_train.training.networks import DenseNet
from ninedtact_train.training.weights_file import load_weights

NETWORK = "densenet169"
WRENCH_MIN, WRENCH_MAX = wrench_limits()


@dataclass
class OriginalNetworkForce(ForceEstimator):
    """The original project's network on this sensor. Its standard deviation is the error in its authors' own test; that of T_z
    contains at least the twist that no image shows."""

    network: DenseNet
    contact_test: ContactTest = detect_contact
    name: str = field(default="original", init=False)

    def __post_init__(self) -> None:
        self.input = NetworkInputBuilder(full_resolution_input_settings(InputChannels.MIXED))

    def estimate(self, reading: Reading) -> WrenchEstimate:
        """Return the wrench of the object on the skin, torques about the skin's centre; exactly zero where nothing touches."""
        self.require_own_reading(reading)
        if reading.image_warnings:
            return unknown_wrench_estimate(reading.stamp_ns, reading.image_warnings)
        std, stamp_ns = np.array(PUBLISHED_SCORES_AT_SKIN.rmse), reading.frame.stamp_ns
        if not self.contact_test(reading):
            return WrenchEstimate(zero_wrench(stamp_ns), diagonal_covariance(std), touching=False)
        parts = self.parts(reading)
        six = WRENCH_MIN + parts.clip(0, 1) * (WRENCH_MAX - WRENCH_MIN)
        wrench = Wrench(six[:3], six[3:], np.array(ForceTorqueMount().origin_mm), stamp_ns).about_skin_centre()
        std[5] = max(std[5], hidden_torque_nm(reading, six[2]))
        warnings = (EstimateWarning.OUT_OF_RANGE,) if ((parts < 0) | (parts > 1)).any() else ()
        return WrenchEstimate(wrench, diagonal_covariance(std), touching=True, warnings=warnings)

    def parts(self, reading: Reading) -> Float64[Array, "6"]:
        """Return the network's six outputs for a reading, as fractions of their ranges."""
        with torch.no_grad():
            return self.network(torch.from_numpy(self.input(reading))[None])[0].double().numpy()

    def forget(self) -> None:
        """Do nothing: no reading is remembered."""


def read_original_network(path: Path | str, contact_test: ContactTest = detect_contact) -> OriginalNetworkForce:
    """Return the network with the weights of a .pt file, which is read without running any code in it.

    Raises `FileFormatError`.
    """
    network = DenseNet(NETWORK, InputChannels.MIXED.number, 6)
    try:
        network.load_state_dict(load_weights(path), strict=True)
    except Exception as trouble:  # torch raises many kinds of error for damaged and for other files
        reason = " ".join(str(trouble).split())[:300]
        raise FileFormatError(
            f"expected the weights of torchvision's {NETWORK} and nothing else in {path}, got: {reason}; give the original "
            "project's .pt file, or the state_dict() of such a network; nothing in the file was run"
        ) from trouble
    estimator = OriginalNetworkForce(network.eval(), contact_test)
    estimator.model_sha256 = sha256(Path(path).read_bytes()).hexdigest()
    return estimator
