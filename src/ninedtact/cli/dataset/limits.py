"""The limits of the checks, as options."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ninedtact.dataset.checks import CheckSettings


@dataclass(frozen=True)
class Limits:
    """From where on a pair is listed."""

    largest: tuple[float, float, float, float, float, float] = (6.0, 6.0, 24.0, 0.4, 0.4, 0.1)
    """Forces (N) and torques (N·m) about the skin's centre: twice what the paper collected."""
    gap_ms: float = 20.0
    """From image to wrench."""
    faintest_levels: float = 0.6
    """Grey levels by which the darkest place must be darker under 2 N or more."""
    unfelt_levels: float = 6.0
    """The same from which on something touches that must be felt."""

    def settings(self) -> "CheckSettings":
        """The same as the checks name it."""
        from ninedtact.dataset.checks import CheckSettings

        return CheckSettings(
            largest=self.largest,
            gap_ms=self.gap_ms,
            faintest_levels=self.faintest_levels,
            unfelt_levels=self.unfelt_levels,
        )
