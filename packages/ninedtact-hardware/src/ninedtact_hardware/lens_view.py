"""The radius that the lens sees, by refraction from the lens front through air, acrylic and silicone. Lengths in mm."""

from math import asin, hypot, radians, sin, tan

from ninedtact.design import ACRYLIC_REFRACTIVE_INDEX, SILICONE_REFRACTIVE_INDEX
from ninedtact_hardware.design import HardwareDesign


def lens_view_radius_mm(design: HardwareDesign, height_mm: float | None = None) -> float:
    """Return the radius in mm that the lens sees at a height in the assembly, not below its front; at the skin if none is given.

    The pupil is taken to be at the lens front, where wide-angle lenses have it nearly.
    """
    levels, angle = design.heights, radians(design.sensor.camera.lens_angle_deg / 2)
    height = levels.skin if height_mm is None else height_mm
    air = min(height, levels.floor_top) - levels.lens_front
    acrylic = min(max(height - levels.floor_top, 0.0), design.window.thick_mm)
    silicone = max(height - levels.window_top, 0.0)
    return (
        air * tan(angle)
        + acrylic * _refracted_slope(angle, ACRYLIC_REFRACTIVE_INDEX)
        + silicone * _refracted_slope(angle, SILICONE_REFRACTIVE_INDEX)
    )


def sensing_corner_distance_mm(design: HardwareDesign) -> float:
    """Return the distance from the optical axis to a corner of the sensing area, which the lens must reach."""
    area = design.sensor.sensing_area
    return hypot(area.width_mm, area.height_mm) / 2


def required_camera_distance_mm(design: HardwareDesign) -> float:
    """Return the least camera distance from which the lens sees the corner of the sensing area."""
    slope = _refracted_slope(radians(design.sensor.camera.lens_angle_deg / 2), SILICONE_REFRACTIVE_INDEX)
    more = (sensing_corner_distance_mm(design) - lens_view_radius_mm(design)) / slope
    return design.sensor.camera.distance_mm + more


def _refracted_slope(angle_rad: float, index: float) -> float:
    """Return the radius gained per mm of height in a material, by Snell's law."""
    return tan(asin(sin(angle_rad) / index))
