"""The steps of fabrication in their order: what to do, and how to check that it worked."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from ninedtact.design import SensorDesign
from ninedtact.hardware.bill_of_materials import clamp_screw_length_mm
from ninedtact.hardware.complete_design import CompleteDesign
from ninedtact.hardware.materials import BLACK_GEL_SILICONE, TRANSLUCENT_SILICONE, TRANSPARENT_SILICONE, Silicone
from ninedtact.simulation.twin import radius_mm_per_rad

AssemblyState = Literal[
    "inserts",
    "window",
    "transparent",
    "first_mould",
    "translucent",
    "black",
    "demoulded",
    "camera",
    "board",
    "ring",
    "closed",
    "calibrated",
]

FOCUS_BEYOND_MM = 0.95
"""Distance beyond the skin at which the lens is focused: the original's authors focus on print at 15 mm, the skin lies
14.05 from the lens."""
OWN_DESIGN = " --design your_design.toml"


@dataclass(frozen=True)
class GuideStep:
    """One step of the guide."""

    state: AssemblyState
    """State of the parts that its image shows."""
    title: str
    do: str
    check: str
    """How to check that it worked, before the next step makes it hard to repair."""


def list_guide_steps(sensor: CompleteDesign) -> Iterator[GuideStep]:
    """Yield all steps with the dimensions of this design."""
    yield from _preparation_steps(sensor)
    yield from _casting_steps(sensor)
    yield from _assembly_steps(sensor)


def _preparation_steps(sensor: CompleteDesign) -> Iterator[GuideStep]:
    """Yield the steps before any silicone is poured."""
    design = sensor.design
    yield GuideStep(
        "inserts",
        "Press in the inserts",
        "Heat eight M2 inserts with a soldering iron at about 230 °C. Press four into the base's bosses from above and four "
        "into the shell's bosses from below, flush and upright.",
        "An M2 screw turned in by hand stands upright, and the shell does not rock on the base. (Inserts melt into nylon, "
        "PETG or ABS; into a resin print they are glued.)",
    )
    yield GuideStep(
        "window",
        "Glue in the window",
        f"Peel the film off both sides of the {design.window.side_mm:g} mm acrylic plate. Run a thin bead of clear glue "
        "(silicone or UV, fully cured before the next step) around the ledge and press the plate into its frame from the gel side. "
        "Keep the middle clean and do not use alcohol, which cracks laser-cut acrylic.",
        "Put a few drops of water with a little dish soap on the window: after five minutes the paper below is still dry. There "
        f"is no smear within {design.shell.hole_mm / 2:g} mm of the middle.",
    )


def _casting_steps(sensor: CompleteDesign) -> Iterator[GuideStep]:
    """Yield the steps that cast the three layers."""
    design = sensor.design
    rim = design.heights.rim - design.heights.floor_top
    yield GuideStep(
        "transparent",
        "Pour the transparent gel",
        f"Stand the shell level. Mix {_mixture(sensor, TRANSPARENT_SILICONE)}, "
        f"draw off the bubbles in a vacuum, and fill the shell to its rim, {rim:.1f} mm. Cure {TRANSPARENT_SILICONE.cure}.",
        "Printed letters are sharp when seen through window and gel. A straight edge over the rim shows less than 0.1 mm of "
        "light anywhere; fill up what is missing and cure again.",
    )
    yield GuideStep(
        "first_mould",
        "Clamp the first mould",
        f"Screw the shell on the base board with four M2 screws from below. Lay the first mould, "
        f"{design.sensor.gel.thickness_mm:g} mm thick, on the rim and clamp it with eight M3 x {clamp_screw_length_mm(design)} "
        "screws and nuts, crosswise and gently, with release agent on the mould's window.",
        f"Measure the whole stack with a calliper at four corners and subtract base board and shell: "
        f"{design.sensor.gel.thickness_mm:.2f} ± 0.10 mm remain. This is the gel's thickness, on which all depths rest.",
    )
    yield GuideStep(
        "translucent",
        "Pour the translucent gel",
        f"Mix {_mixture(sensor, TRANSLUCENT_SILICONE)}, without bubbles. Pour "
        f"until it stands level with the mould and scrape once with a straight edge. Cure {TRANSLUCENT_SILICONE.cure}.",
        "The layer is evenly white over a lamp, without bubbles or streaks, and does not lift when the mould is taken off.",
    )
    yield GuideStep(
        "black",
        "Pour the black gel",
        f"Take off the first mould and clamp the second ({design.heights.second_mould:.2f} mm). "
        "Lay the LED board below the clear base board and switch it on. "
        f"Mix {_mixture(sensor, BLACK_GEL_SILICONE)}, and add pigment until a drop on the lit "
        f"layer lets no light through. Pour around and over the layer and scrape level. Cure {BLACK_GEL_SILICONE.cure}.",
        "In a dark room with the LEDs on, no light passes through the top or the sides. Where some does, pour again.",
    )
    yield GuideStep(
        "demoulded",
        "Take it out",
        "Unscrew the clamps, run a thin blade around the mould's window, lift the mould straight up and unscrew the base board.",
        f"The skin is smooth and stands {design.heights.second_mould:.2f} ± 0.10 mm above the rim; "
        "no edge lifts when it is rubbed with a finger.",
    )


def _assembly_steps(sensor: CompleteDesign) -> Iterator[GuideStep]:
    """Yield the steps that mount camera, light and screws, and calibrate."""
    design = sensor.design
    own = "" if design.sensor == SensorDesign() else OWN_DESIGN
    nearest_mm, farthest_mm = radius_mm_per_rad(design.sensor), design.sensor.camera.distance_mm + FOCUS_BEYOND_MM
    yield GuideStep(
        "camera",
        "Lay in the camera",
        "Put the camera into the base's pocket, lens up, its cable up the ramp and out at the side. A drop of glue at two "
        "corners holds it; keep glue off the lens.",
        "`ninedtact doctor` lists the camera and its measured frame rate. Turn the lens until print "
        f"{nearest_mm:.0f} to {farthest_mm:.0f} mm above it is sharp: the first "
        "is the distance of the skin as seen through acrylic and silicone, the second that of the print by which the original's "
        "authors focus.",
    )
    yield GuideStep(
        "board",
        "Lay on the LED board",
        f"Lay it over the four pins, LEDs up, USB over the cable. It must be {design.board.thick_mm:.2f} mm thick.",
        "It lies flat on all four posts, the lens stands free in its hole, and with USB plugged in all eight LEDs are equally "
        "bright.",
    )
    yield GuideStep(
        "ring",
        "Put in the isolation ring",
        "Lay the shell upside down on its gel, and the ring into its square hole, the wide mouth down to the window. Black paint "
        "on the white ledges beside it helps against stray light.",
        "Seen from below, no white wall of the hole is visible, and the ring does not protrude from the shell's floor.",
    )
    yield GuideStep(
        "closed",
        "Close it",
        "Leave the shell upside down, so that the ring stays, and lower the base with camera and board onto it, the cable through "
        f"its gap. Tighten four M2 x {design.fasteners.screw_mm:g} screws, crosswise.",
        f"It measures {design.plan_view.outer[0]:.1f} x {design.plan_view.outer[1]:.1f} x {design.heights.top:.1f} mm. "
        "`ninedtact live` shows an evenly bright image without a dark ring or a bright spot at its rim.",
    )
    yield GuideStep(
        "calibrated",
        "Calibrate it",
        "Press the calibration board over the shell, then the ball: "
        f"`ninedtact calibrate --out my_sensor --source 0{own}` guides you through both.",
        "All checks of the certificate are passed; docs/calibrating.md says what to do about one that is not.",
    )


def _mixture(sensor: CompleteDesign, silicone: Silicone) -> str:
    """State the mass to mix for one layer, the product and the ratio of its components."""
    mass_g = silicone.grams(sensor.parts[silicone.part].volume_mm3)
    return f"{mass_g:.1f} g of {silicone.product}, {silicone.ratio} by weight"
