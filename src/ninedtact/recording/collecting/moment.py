"""An image and the wrench of its moment, before anything is decided about them."""

from dataclasses import dataclass

import numpy as np

from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.collecting.settings import CollectSettings


@dataclass(frozen=True)
class Moment:
    """What was seen and weighed at once."""

    frame: Frame
    wrench: Wrench
    """About the skin's centre, tare taken off."""
    change: float
    """Grey levels from the untouched skin."""

    def looks_untouched(self, settings: CollectSettings) -> bool:
        """Whether the image shows nothing; between this and a touch it shows neither."""
        return self.change < settings.touched_levels / 2

    def rests(self, settings: CollectSettings) -> bool:
        """Whether the force/torque sensor reads nothing."""
        return bool((np.abs(self.wrench.six) <= settings.rest).all())
