"""The design of a sensor: what is known of it before any picture. The defaults are the published 9DTact."""

from dataclasses import dataclass
from math import isfinite
from typing import Literal

from ninedtact.errors import NinedtactError


class DesignImpossible(NinedtactError):
    """A dimension that no sensor can have."""


def require_positive(name: str, value: float) -> None:
    """Refuse zero, negative and not-a-number."""
    if not value > 0:
        raise DesignImpossible(f"expected {name} above zero, got {value}; correct the design")


@dataclass(frozen=True)
class Gel:
    """The translucent layer that is pressed, bonded on a stiffer transparent one."""

    thickness_mm: float = 2.5
    shear_modulus_mpa: float = 0.093
    """Of Shore A 5, by Gent's relation (docs/references.md); a known weight measures it far better."""
    poisson_ratio: float = 0.5
    """Silicone keeps its volume: 0.5 is exact, not a limit."""

    def __post_init__(self) -> None:
        require_positive("gel.thickness_mm", self.thickness_mm)
        require_positive("gel.shear_modulus_mpa", self.shear_modulus_mpa)
        if not -1 < self.poisson_ratio <= 0.5:
            raise DesignImpossible(
                f"expected gel.poisson_ratio above −1 and at most 0.5, got {self.poisson_ratio}; correct the design"
            )


@dataclass(frozen=True)
class FieldOfView:
    """The rectified picture: its size in pixels, and the raw picture for which one pixel there is one pixel here."""

    rows: int = 345
    cols: int = 460
    raw_long_side_px: int = 640
    """A raw picture of another size is rectified to the same number of mm, in the same number of pixels."""

    def __post_init__(self) -> None:
        for name in ("rows", "cols", "raw_long_side_px"):
            require_positive(f"field_of_view.{name}", getattr(self, name))


@dataclass(frozen=True)
class Camera:
    """The wide-angle camera under the gel, looking straight up through the middle of the skin."""

    distance_mm: float = 14.05
    """From the lens front to the untouched skin. So near, pressed skin is seen displaced outwards: see `shape.sightlines`."""

    def __post_init__(self) -> None:
        require_positive("camera.distance_mm", self.distance_mm)


@dataclass(frozen=True)
class PinBoard:
    """The calibration board: coplanar pins on a square lattice, long side along x."""

    rows: int = 7
    cols: int = 9
    pitch_mm: float = 2.5
    pin_diameter_mm: float = 1.2

    def __post_init__(self) -> None:
        require_positive("pin_board.pitch_mm", self.pitch_mm)
        require_positive("pin_board.pin_diameter_mm", self.pin_diameter_mm)
        if self.rows < 3 or self.cols < 3:
            raise DesignImpossible(
                f"expected a pin board of at least 3 x 3 pins, got {self.cols} x {self.rows}; a lens cannot be fitted to fewer"
            )

    @property
    def count(self) -> int:
        """Number of pins."""
        return self.rows * self.cols


@dataclass(frozen=True)
class BallGauge:
    """The ball that calibrates depth."""

    radius_mm: float = 4.0

    def __post_init__(self) -> None:
        require_positive("ball.radius_mm", self.radius_mm)


@dataclass(frozen=True)
class ForceTorqueMount:
    """Where a force/torque sensor stands under the tactile sensor: its own frame, seen in the sensor frame."""

    origin_mm: tuple[float, float, float] = (0.0, 0.0, -35.0)
    """Of its frame; the paper's stands 35 mm below the skin."""
    turned_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Its frame, turned about the sensor's x axis, then y, then z; none: its z points out of the skin as the sensor's does."""
    sign: Literal[1, -1] = 1
    """1 for a device that tells what loads its tool side, on which the sensor stands; −1 where it tells the reaction."""

    def __post_init__(self) -> None:
        for name in ("origin_mm", "turned_deg"):
            if not all(map(isfinite, getattr(self, name))):
                raise DesignImpossible(
                    f"expected force_torque.{name} of three numbers, got {getattr(self, name)}; correct the design"
                )


@dataclass(frozen=True)
class SensorDesign:
    """One sensor's design. The calibration searches for it, the twin simulates it, the hardware draws it."""

    gel: Gel = Gel()
    camera: Camera = Camera()
    field_of_view: FieldOfView = FieldOfView()
    pin_board: PinBoard = PinBoard()
    ball: BallGauge = BallGauge()
    force_torque: ForceTorqueMount = ForceTorqueMount()
