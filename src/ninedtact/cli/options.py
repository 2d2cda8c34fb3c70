"""Options that commands share, as plain choices: the rooms that give them meaning load only when a command runs."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from ninedtact.calibration.flow import CalibrationSettings


@dataclass(frozen=True)
class CalibrationOptions:
    """How to calibrate; the defaults suit every sensor seen so far."""

    lens: Literal["lens", "paper"] = "lens"
    """Lens model, or the paper's map (central anchors, equidistant grid, cubic radial basis) for reproduction."""
    mounting_deg: Literal["auto", "0", "90", "180", "270"] = "auto"
    """Angle from the picture's columns to the sensor's x axis, clockwise on the screen."""
    method: Literal["physics", "ratio", "table"] = "physics"
    """Depth from the brightness factor, or from the paper's mapping list of grey differences."""

    def settings(self) -> "CalibrationSettings":
        """The same as the calibration room names it."""
        from ninedtact.calibration.board.mounting import MOUNTINGS
        from ninedtact.calibration.flow import CalibrationSettings

        ways = {str(way): way for way in MOUNTINGS}
        return CalibrationSettings(lens=self.lens, mounting_deg=ways[self.mounting_deg], method=self.method)
