"""How far the lens sees: refraction from the lens front through air, acrylic and silicone."""

from math import asin, hypot, radians, sin, tan

from ninedtact.design import ACRYLIC, SILICONE
from ninedtact.hardware.design import HardwareDesign


def reach_mm(design: HardwareDesign, height_mm: float | None = None) -> float:
    """Radius that the lens sees at this height; of the skin if not given.

    The pupil is taken to be at the lens front, where wide lenses have it nearly.
    """
    levels, angle = design.levels, half_angle_rad(design)
    height = levels.skin if height_mm is None else height_mm
    air = levels.floor_top - levels.lens_front
    acrylic = min(max(height - levels.floor_top, 0.0), design.window.thick_mm)
    silicone = max(height - levels.window_top, 0.0)
    return air * tan(angle) + acrylic * slope(angle, ACRYLIC) + silicone * slope(angle, SILICONE)


def corner_mm(design: HardwareDesign) -> float:
    """From the middle to a corner of the sensing area: what the lens has to reach."""
    area = design.sensor.sensing_area
    return hypot(area.width_mm, area.height_mm) / 2


def distance_to_see_mm(design: HardwareDesign) -> float:
    """Distance from lens to skin from which the corner is seen just so."""
    more = (corner_mm(design) - reach_mm(design)) / slope(half_angle_rad(design), SILICONE)
    return design.sensor.camera.distance_mm + more


def half_angle_rad(design: HardwareDesign) -> float:
    """Of the lens, in air."""
    return radians(design.sensor.camera.lens_angle_deg / 2)


def slope(angle_rad: float, index: float) -> float:
    """Radius gained per mm of height within a material, by Snell's law."""
    return tan(asin(sin(angle_rad) / index))
