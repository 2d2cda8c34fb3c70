"""Which sensor a hardware command is about, and whether the library that models solids is there."""

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.hardware.design import HardwareDesign
    from ninedtact.hardware.report import BuiltSensor


class SolidsMissing(NinedtactError):
    """build123d is not installed."""


@dataclass(frozen=True)
class Described:
    """The sensor that is built."""

    design: Path | None = None
    """Design file (TOML): what differs from the published sensor; [hardware.shell] and so on change its parts."""
    variant: Literal["default", "original"] = "default"
    """Ours, with the improvements that docs/hardware.md lists, or the original's dimensions."""

    def hardware(self) -> "HardwareDesign":
        """All dimensions; raises `DesignFileUnreadable`, `DesignImpossible`."""
        from ninedtact.hardware.design_file import read_hardware

        return read_hardware(self.design, self.variant)

    def built(self) -> "BuiltSensor":
        """Ready to be measured; raises `RulesBroken`, `BoardImpossible`, `SolidsMissing`."""
        design = self.hardware()
        require_solids()
        from ninedtact.hardware.report import BuiltSensor

        return BuiltSensor(design)


def require_solids() -> None:
    """Refuse where build123d is missing; raises `SolidsMissing`."""
    if find_spec("build123d") is None:
        raise SolidsMissing(
            "expected build123d, which models the parts, got none; run pip install 'ninedtact[hardware]'"
        )
