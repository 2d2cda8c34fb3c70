"""Settings of `ninedtact collect`; the resolved settings are stored in the recording."""

from dataclasses import dataclass

from ninedtact.capture.force_torque.sample_checks import SampleCheckSettings
from ninedtact.capture.force_torque.tare import TareSettings
from ninedtact.capture.sampling_rule import SamplingRuleSettings, SixFloats
from ninedtact.errors import InputError


class CollectSettingsInvalid(InputError):
    """The settings describe a collection in which nothing can be saved."""


@dataclass(frozen=True)
class CollectSettings:
    """When an image and a wrench are saved as a pair."""

    rule: SamplingRuleSettings = SamplingRuleSettings()
    """The sampling rule of the paper for pairs within a contact."""
    checks: SampleCheckSettings = SampleCheckSettings()
    """Which samples of the force/torque sensor are rejected."""
    tare: TareSettings = TareSettings()
    """How the zero of the force/torque sensor is measured."""
    tolerance_ms: float = 10.0
    """Largest distance of the samples before and after an image; the wrench is interpolated between them."""
    camera_delay_ms: float = 0.0
    """How long before its stamp an image shows the skin: half the exposure, and the transfer to the computer."""
    no_contact: float = 0.03
    """Fraction of pairs without contact."""
    light_touch: float = 0.05
    """Fraction of pairs with contact whose load is below the start of the sampling rule."""
    reference_images: int = 10
    """Number of reference images (no contact) before the first touch and at every tare."""
    rest: SixFloats = (0.2, 0.2, 0.2, 0.015, 0.015, 0.01)
    """Largest wrench without contact, N and N·m about the skin centre; more calls for a tare."""
    contact_levels: float = 2.0
    """Grey levels by which a block of pixels must differ from the reference to show contact; below half of it nothing touches."""

    def __post_init__(self) -> None:
        if not (self.tolerance_ms > 0 and self.camera_delay_ms >= 0):
            raise CollectSettingsInvalid(
                f"expected a tolerance above zero and a camera delay of zero or more, got {self.tolerance_ms} and "
                f"{self.camera_delay_ms} ms; correct them"
            )
        if not (min(self.no_contact, self.light_touch) >= 0 and self.no_contact + self.light_touch < 1):
            raise CollectSettingsInvalid(
                f"expected fractions of zero or more, together below 1, got {self.no_contact} without contact and "
                f"{self.light_touch} with a light touch; correct them"
            )
        if not (self.reference_images >= 1 and self.contact_levels > 0 and min(self.rest) > 0):
            raise CollectSettingsInvalid(
                f"expected at least one reference image, and levels and rest above zero, got "
                f"{self.reference_images}, {self.contact_levels} and {self.rest}; correct them"
            )

    @property
    def decision_delay_ns(self) -> int:
        """How long after a moment its samples can be judged: a frozen sensor is noticed only when it keeps repeating."""
        return int((self.checks.frozen_ms + self.tolerance_ms) * 1e6)
