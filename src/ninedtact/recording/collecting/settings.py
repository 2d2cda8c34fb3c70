"""What `ninedtact collect` is asked for; the resolved settings stand in the episode."""

from dataclasses import dataclass

from ninedtact.capture.force_torque.sample_checks import SampleCheckSettings
from ninedtact.capture.force_torque.tare import TareSettings
from ninedtact.capture.sampling_rule import SamplingRuleSettings, SixFloats
from ninedtact.errors import NinedtactError


class CollectionImpossible(NinedtactError):
    """Settings with which nothing can be collected."""


@dataclass(frozen=True)
class CollectSettings:
    """When an image and a wrench are a pair worth keeping."""

    rule: SamplingRuleSettings = SamplingRuleSettings()
    """The paper's rule for pairs within a contact."""
    trust: SampleCheckSettings = SampleCheckSettings()
    """Which samples of the force/torque sensor are not believed."""
    tare: TareSettings = TareSettings()
    """How the untouched skin is weighed."""
    tolerance_ms: float = 10.0
    """The samples before and after an image are at most so far from it; the wrench is interpolated between them."""
    camera_late_ms: float = 0.0
    """How long before its stamp an image shows the skin: half the exposure, and the way to the computer."""
    no_contact: float = 0.03
    """Share of pairs without contact."""
    light_touch: float = 0.05
    """Share of pairs with contact that press less than the rule begins with."""
    untouched_images: int = 10
    """Of the skin before the first touch and at every tare."""
    rest: SixFloats = (0.2, 0.2, 0.2, 0.015, 0.015, 0.01)
    """What an untouched skin may weigh, N and N·m about its centre; more calls for a tare."""
    touched_levels: float = 2.0
    """Grey levels by which a place must differ from the untouched skin to be seen touched; below half of it nothing touches."""

    def __post_init__(self) -> None:
        if not (self.tolerance_ms > 0 and self.camera_late_ms >= 0):
            raise CollectionImpossible(
                f"expected a tolerance above zero and a camera late by zero or more, got {self.tolerance_ms} and "
                f"{self.camera_late_ms} ms; correct them"
            )
        if not (min(self.no_contact, self.light_touch) >= 0 and self.no_contact + self.light_touch < 1):
            raise CollectionImpossible(
                f"expected shares of zero or more, together below 1, got {self.no_contact} without contact and "
                f"{self.light_touch} touching lightly; correct them"
            )
        if not (self.untouched_images >= 1 and self.touched_levels > 0 and min(self.rest) > 0):
            raise CollectionImpossible(
                f"expected at least one image of untouched skin, and levels and rest above zero, got "
                f"{self.untouched_images}, {self.touched_levels} and {self.rest}; correct them"
            )

    @property
    def hindsight_ns(self) -> int:
        """How long after a moment it is known whether its samples can be trusted: a sensor that freezes shows it by going on."""
        return int((self.trust.frozen_ms + self.tolerance_ms) * 1e6)
