"""Which designs are compared: every combination of a few gels, areas and lenses."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from math import prod

from ninedtact.design import SensingArea, SensorDesign, shear_modulus_of_shore_a
from ninedtact.errors import NinedtactError
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.optics import distance_to_see_mm

Pair = tuple[float, float]
MOST = 200
"""More are not looked through by anyone."""
SPARE_MM = 0.1
"""Of distance, beyond what the lens needs to see the corner."""


class SweepTooLarge(NinedtactError):
    """More designs than anyone looks through."""


@dataclass(frozen=True)
class Sweep:
    """Values of each choice; none leaves it as the basis has it."""

    gel_mm: tuple[float, ...] = ()
    """Thickness of the translucent gel."""
    shore_a: tuple[float, ...] = ()
    """Its hardness."""
    area_mm: tuple[Pair, ...] = ()
    """Sensing area, width and height."""
    lens_deg: tuple[float, ...] = ()
    """What the lens sees in air."""

    def designs(self, basis: HardwareDesign) -> "Iterator[Choice]":
        """Every combination; raises `SweepTooLarge` when the first is asked for."""
        many = prod(max(len(values), 1) for values in vars(self).values())
        if many > MOST:
            raise SweepTooLarge(f"expected at most {MOST} designs, got {many}; give fewer values")
        gels, shores, lenses = self.gel_mm or (None,), self.shore_a or (None,), self.lens_deg or (None,)
        for gel, shore, area, lens in product(gels, shores, self.area_mm or (None,), lenses):
            yield Choice(basis, gel, shore, area, lens)


@dataclass(frozen=True)
class Choice:
    """One combination upon a basis; `None` leaves it."""

    basis: HardwareDesign
    gel_mm: float | None = None
    shore_a: float | None = None
    area_mm: Pair | None = None
    lens_deg: float | None = None

    @property
    def hardware(self) -> HardwareDesign:
        """The design; its camera as far away as it must be to see the corner, its pins within the area.

        Raises `DesignImpossible`.
        """
        design = replace(self.basis, sensor=self.sensor)
        needed = distance_to_see_mm(design)
        if needed <= design.sensor.camera.distance_mm:
            return design
        camera = replace(design.sensor.camera, distance_mm=round(needed + SPARE_MM, 2))
        return replace(design, sensor=replace(design.sensor, camera=camera))

    @property
    def sensor(self) -> SensorDesign:
        """Gel, area and lens as chosen."""
        sensor = self.basis.sensor
        gel, area, camera = sensor.gel, sensor.sensing_area, sensor.camera
        if self.gel_mm is not None:
            gel = replace(gel, thickness_mm=self.gel_mm)
        if self.shore_a is not None:
            gel = replace(gel, shear_modulus_mpa=shear_modulus_of_shore_a(self.shore_a))
        if self.area_mm is not None:
            area = replace(area, width_mm=self.area_mm[0], height_mm=self.area_mm[1])
        if self.lens_deg is not None:
            camera = replace(camera, lens_angle_deg=self.lens_deg)
        return replace(with_pins_inside(sensor, area), gel=gel, sensing_area=area, camera=camera)


def with_pins_inside(sensor: SensorDesign, area: SensingArea) -> SensorDesign:
    """The pin board with as many columns and rows of the same pitch as the area shows, at least three."""
    board = sensor.pin_board
    if area == sensor.sensing_area:
        return sensor
    gaps = [int((side - board.pin_diameter_mm) / board.pitch_mm) for side in area.size_mm]
    cols, rows = (max(many + 1, 3) for many in gaps)
    return replace(sensor, pin_board=replace(board, cols=cols, rows=rows))
