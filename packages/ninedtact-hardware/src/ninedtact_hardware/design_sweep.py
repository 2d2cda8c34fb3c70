"""Design sweep: every combination of a few gels, areas and lenses as a design. `design_comparison` predicts and compares them."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from math import prod

from ninedtact.design import SensingArea, SensorDesign, shore_a_to_shear_modulus_mpa
from ninedtact.errors import InputError
from ninedtact_hardware.buildability import count_pins_within
from ninedtact_hardware.design import XY, HardwareDesign, required_camera_distance_mm

MAX_DESIGNS = 200
"""Largest number of designs in one sweep; a longer comparison is not readable."""
SPARE_MM = 0.1
"""Camera distance added to what the lens needs to see the corner."""


@dataclass(frozen=True)
class DesignSweep:
    """The values of each choice; none keeps the value of the base design."""

    gel_mm: tuple[float, ...] = ()
    """Thicknesses of the translucent gel."""
    shore_a: tuple[float, ...] = ()
    """Hardnesses of the translucent gel, Shore A."""
    area_mm: tuple[str, ...] = ()
    """Sensing areas, width x height, such as 24x18 30x22."""
    lens_deg: tuple[float, ...] = ()
    """Angles that the lens sees in air."""

    def designs(self, basis: HardwareDesign) -> Iterator[tuple[HardwareDesign, float | None]]:
        """Yield every combination as a design, with its hardness as Shore A if that was given; raises `InputError`."""
        many = prod(max(len(values), 1) for values in vars(self).values())
        if many > MAX_DESIGNS:
            raise InputError(expected=f"at most {MAX_DESIGNS} designs", got=f"{many}", remedy="give fewer values")
        areas = tuple(map(_parse_area, self.area_mm))
        choices = ((*values,) or (None,) for values in (self.gel_mm, self.shore_a, areas, self.lens_deg))
        for gel, shore, area, lens in product(*choices):
            yield change_design(basis, gel, shore, area, lens), shore


USUAL_SWEEP = DesignSweep(gel_mm=(1.5, 2.5, 4.0), shore_a=(5.0, 15.0))
"""The designs that are compared where no value is given: the gel decides most, and needs no other camera."""


def _parse_area(text: str) -> XY:
    try:
        width, height = map(float, text.lower().split("x"))
    except ValueError:
        raise InputError(
            expected="an area such as 24x18", got=repr(text), remedy="write width x height in mm"
        ) from None
    return width, height


def change_design(
    basis: HardwareDesign,
    gel_mm: float | None = None,
    shore_a: float | None = None,
    area_mm: XY | None = None,
    lens_deg: float | None = None,
) -> HardwareDesign:
    """Return a design with the choices that are given, its pins within the area, and its camera as far away as it must be to see
    the corner.

    Raises `DesignImpossible`.
    """
    sensor = basis.sensor
    gel, area, camera = sensor.gel, sensor.sensing_area, sensor.camera
    if gel_mm is not None:
        gel = replace(gel, thickness_mm=gel_mm)
    if shore_a is not None:
        gel = replace(gel, shear_modulus_mpa=shore_a_to_shear_modulus_mpa(shore_a))
    if area_mm is not None:
        area = replace(area, width_mm=area_mm[0], height_mm=area_mm[1])
    if lens_deg is not None:
        camera = replace(camera, lens_angle_deg=lens_deg)
    sensor = replace(_fit_pin_board(sensor, area), gel=gel, sensing_area=area, camera=camera)
    design = replace(basis, sensor=sensor)
    needed = required_camera_distance_mm(design)
    if needed <= camera.distance_mm:
        return design
    return replace(design, sensor=replace(sensor, camera=replace(camera, distance_mm=round(needed + SPARE_MM, 2))))


def _fit_pin_board(sensor: SensorDesign, area: SensingArea) -> SensorDesign:
    """Return a sensor with as many columns and rows of pins of the same pitch as fit the area, at least three."""
    board = sensor.pin_board
    if area == sensor.sensing_area:
        return sensor
    cols, rows = (max(count_pins_within(board, side), 3) for side in area.size_mm)
    return replace(sensor, pin_board=replace(board, cols=cols, rows=rows))
