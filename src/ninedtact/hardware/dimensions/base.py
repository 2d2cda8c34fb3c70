"""The black base: plate, camera pocket, insert bosses, locating posts."""

from dataclasses import dataclass
from typing import Annotated

from ninedtact.hardware.dimensions.between import Between, require_between


@dataclass(frozen=True)
class Base:
    """Sensor base, 3D-printed in black."""

    plate_mm: Annotated[float, Between(2.0, 6.0)] = 3.0
    """Thickness: a pocket for the camera and a floor below it."""
    corner_radius_mm: Annotated[float, Between(0.0, 5.0)] = 2.0
    """Of the outline, as the shell's."""
    floor_mm: Annotated[float, Between(0.8, 3.0)] = 1.0
    """Below camera and inserts: what a screw head or a bolt is pulled against."""
    mount_inset_mm: Annotated[tuple[float, float], Between(2.0, 20.0)] = (5.75, 3.0)
    """From the shell's cavity walls to the four inserts that a robot is bolted to, x and y: a pattern of 17.0 x 15.5 in the
    published size, clear of posts and screw bosses in every size."""
    boss_mm: Annotated[float, Between(4.0, 8.0)] = 5.3
    """Diameter of the insert bosses: 1.2 of plastic round a heat-set insert."""
    boss_tall_mm: Annotated[float, Between(0.0, 4.0)] = 3.5
    """Above the plate; 1.0 stays below the circuit board."""
    bore_mm: Annotated[float, Between(2.5, 3.4)] = 2.82
    """For an M2 heat-set insert of 3.3 over its knurl."""
    bolt_mm: Annotated[float, Between(2.05, 3.0)] = 2.4
    """Through the floor below the inserts; M2 with the clearance of a printed hole (ISO 273 medium)."""
    post_mm: Annotated[float, Between(2.0, 4.0)] = 2.8
    """Diameter of the posts that carry the circuit board."""
    post_tall_mm: Annotated[float, Between(3.0, 8.0)] = 4.5
    """Above the plate, to the underside of the circuit board: above the micro-USB receptacle that hangs below it."""
    pin_mm: Annotated[float, Between(0.8, 2.5)] = 1.45
    """Diameter of the locating pins, in holes of 1.50."""
    pin_tall_mm: Annotated[float, Between(0.5, 1.2)] = 1.0
    """Above the posts: 0.20 more than the board is thick."""
    pin_round_mm: Annotated[float, Between(0.0, 0.5)] = 0.3
    """Fillet at the pins' tips, to find the holes."""
    shell_screw_mm: Annotated[float, Between(2.0, 3.0)] = 2.2
    """Clearance hole of the M2 screws into the shell; 2.00 as drawn originally binds where it is printed."""
    counterbore_mm: Annotated[float, Between(3.9, 5.0)] = 4.0
    """Diameter for heads of 3.9."""
    counterbore_deep_mm: Annotated[float, Between(0.5, 2.0)] = 1.0
    """Heads of 0.85 sit 0.15 below the face."""
    pocket_wide_mm: Annotated[float, Between(8.0, 15.0)] = 8.9
    """Of the camera's pocket; the camera is 8.70 wide, 0.10 stays on each side."""
    pocket_front_mm: Annotated[float, Between(4.0, 8.0)] = 4.45
    """From the optical axis to its wall at +y."""
    pocket_back_mm: Annotated[float, Between(4.0, 10.0)] = 7.75
    """From the optical axis to its shoulder at -y; the camera's stiffener ends at 7.65."""
    channel_wide_mm: Annotated[float, Between(6.0, 10.0)] = 6.4
    """For a flat cable of 6.00."""
    channel_round_mm: Annotated[float, Between(0.0, 1.0)] = 0.4
    """At the two entry corners, which the cable would catch on."""
    ramp_foot_mm: Annotated[float, Between(1.0, 6.0)] = 3.0
    """From the outer face to the foot of the ramp that lifts the cable to the shell's rim."""
    ramp_head_mm: Annotated[float, Between(0.1, 2.0)] = 0.5
    """From the outer face to its head."""
    ramp_gap_mm: Annotated[float, Between(0.3, 1.0)] = 0.5
    """Left for the cable under the shell's rim; it is modelled 0.40 thick."""
    ramp_foot_round_mm: Annotated[float, Between(0.0, 3.0)] = 2.0
    """Blend at the foot: the cable must not be bent sharply."""
    ramp_head_round_mm: Annotated[float, Between(0.0, 2.0)] = 1.0
    """Blend at the head."""

    def __post_init__(self) -> None:
        require_between(self)


ORIGINAL_BASE = Base(
    bolt_mm=2.1, shell_screw_mm=2.0, pocket_wide_mm=8.7, pocket_front_mm=4.35, pocket_back_mm=7.55, ramp_gap_mm=0.4
)
"""Without clearances round camera, cable and screws."""
