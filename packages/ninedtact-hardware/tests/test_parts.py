"""The original's parts against what was measured on its files: volumes, boxes, areas, sections."""

from dataclasses import replace
from math import pi

import pytest
from build123d import Plane

from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.part_dimensions import ShellDimensions, WindowDimensions
from ninedtact_hardware.part_files import part_to_step, part_to_stl
from ninedtact_hardware.part_solids import build_first_mould, build_transparent_gel
from ninedtact_hardware.sensor_assembly import PART_CATALOGUE

REFERENCE = {
    "sensor_base": ((32.5, 25.5, 8.5), 2419.59, 2748.67),
    "sensor_shell": ((32.5, 25.5, 19.5), 5224.23, 5610.74),
    "isolation_ring": ((11.9, 11.9, 2.8), 158.56, 329.43),
    "calibration_board": ((37.0, 30.0, 11.0), 4887.73, 4849.81),
    "base_board": ((60.0, 50.0, 3.0), 8406.46, None),
    "first_mould": ((60.0, 50.0, 2.5), 5382.79, None),
    "second_mould": ((60.0, 50.0, 2.8), 5793.98, None),
    "acrylic_window": ((14.0, 14.0, 2.0), 392.0, None),
    "transparent_gel": ((28.5, 21.5, 11.2), 6418.27, None),
    "translucent_gel": ((29.5, 22.5, 2.5), 1657.23, None),
    "black_gel": ((31.1, 24.1, 2.8), 433.61, None),
    "camera": ((10.0, 17.65, 9.95), None, None),
    "led_board": ((28.0, 21.34, 4.17), None, None),
}
"""Box, volume, surface; the LED board is as deep as its receptacle's mouth stands out."""

RIM = 22.5
SECTIONS = {
    "sensor_base": (
        *((0.05, 761.20), (1.05, 670.99), (1.55, 664.59), (2.05, 659.59), (2.55, 654.21)),
        *((3.05, 87.89), (6.45, 87.89), (6.55, 24.63), (7.55, 6.61)),
    ),
    "sensor_shell": (
        *((RIM - 0.05, 213.42), (RIM - 10.05, 213.42), (RIM - 10.55, 261.42), (RIM - 11.55, 681.32)),
        *((RIM - 13.05, 681.32), (RIM - 13.55, 273.95), (RIM - 14.55, 228.19), (RIM - 15.05, 215.19)),
        *((RIM - 16.05, 212.19), (RIM - 18.05, 228.19)),
    ),
    "calibration_board": ((1.0, 1096.27), (3.0, 312.95), (3.55, 308.50), (6.0, 241.70)),
}
"""mm² at these heights, mm; of the shell below its rim."""


def test_the_reference_covers_every_part() -> None:
    assert set(PART_CATALOGUE) == set(REFERENCE)


@pytest.mark.parametrize("name", REFERENCE)
def test_original_agrees_with_its_files(original: BuildableDesign, name: str) -> None:
    box_mm, volume_mm3, surface_mm2 = REFERENCE[name]
    part = original.parts[name]
    assert part.size_mm == pytest.approx(box_mm, abs=0.01)
    if volume_mm3 is not None:
        assert part.volume_mm3 == pytest.approx(volume_mm3, rel=1e-4)
    if surface_mm2 is not None:
        assert part.solid.area == pytest.approx(surface_mm2, rel=1e-4)


@pytest.mark.parametrize("name", SECTIONS)
def test_original_agrees_section_by_section(original: BuildableDesign, name: str) -> None:
    solid = original.parts[name].solid
    for z_mm, area_mm2 in SECTIONS[name]:
        cut = solid.intersect(Plane.XY.offset(z_mm))
        faces = cut if isinstance(cut, list) else [cut]
        assert sum(face.area for face in faces) == pytest.approx(area_mm2, rel=2e-4, abs=0.006), f"{name} at z {z_mm}"


@pytest.mark.parametrize("name", REFERENCE)
def test_every_part_is_one_valid_solid(original: BuildableDesign, default: BuildableDesign, name: str) -> None:
    for sensor in (original, default):
        solid = sensor.parts[name].solid
        assert len(solid.solids()) == 1 and solid.is_valid


def test_centres_of_mass(original: BuildableDesign) -> None:
    base, shell = original.parts["sensor_base"].solid.center(), original.parts["sensor_shell"].solid.center()
    assert tuple(base) == pytest.approx((0, 0.33, 1.94), abs=0.01)
    assert tuple(shell) == pytest.approx((0, 0.10, 12.21), abs=0.01)


def test_gel_fills_the_frame_above_a_thin_window() -> None:
    """By hand: 28.50 x 21.50 x 11.20 with R1.00, less window and groove of 1.00 and the frame's wall of 2.00."""
    design = HardwareDesign()
    thin = replace(design, window=WindowDimensions(thick_mm=1.0), shell=ShellDimensions(frame_tall_mm=2.0))
    opening = (28.5 * 21.5 - (4 - pi)) * 11.2
    expected = opening - 14.2**2 * 1.0 - (15.8**2 - 14.2**2) * 2.0
    assert build_transparent_gel(thin).volume == pytest.approx(expected, rel=1e-6)


def test_a_part_is_the_same_whatever_was_modelled_and_meshed_before() -> None:
    """Plates take outlines that are remembered."""
    solids = [build_first_mould(HardwareDesign()) for _ in range(2)]
    assert part_to_stl(solids[0]) == part_to_stl(solids[1])
    assert part_to_step("first_mould", solids[0]) == part_to_step("first_mould", solids[1])
