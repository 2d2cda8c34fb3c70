"""The fabrication guide: a `BuildableDesign` goes in, a Markdown page with an image of the parts after each step comes out.

First the steps in their order, each with what to do and how to check that it worked; then the page and its images.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import cv2
from build123d import Axis, Part, Pos, Rot

from ninedtact.atomic_write import write_file_atomically
from ninedtact.design import SensorDesign
from ninedtact.hardware.bill_of_materials import mould_clamp_screw_length_mm
from ninedtact.hardware.buildable_design import BuildableDesign
from ninedtact.hardware.design import HardwareDesign, hardware_design_of_variant
from ninedtact.hardware.materials import (
    BLACK_GEL_SILICONE,
    TRANSPARENT_SILICONE,
    GelSilicone,
    translucent_silicone_of_modulus,
)
from ninedtact.hardware.part_and_assembly_images import (
    FROM_ABOVE,
    FROM_BELOW,
    BgrImage,
    ViewAngles,
    colour_bodies,
    cut_bodies_open,
    render_solids,
)
from ninedtact.hardware.sensor_assembly import AssemblyBody
from ninedtact.simulation.twin import paraxial_skin_mm_per_rad

_AssemblyState = Literal[
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
class _GuideStep:
    """One step of the guide."""

    state: _AssemblyState
    """State of the parts that its image shows."""
    title: str
    do: str
    check: str
    """How to check that it worked, before the next step makes it hard to repair."""


def _list_guide_steps(sensor: BuildableDesign) -> Iterator[_GuideStep]:
    """Yield all steps with the dimensions of this design."""
    yield from _preparation_steps(sensor)
    yield from _casting_steps(sensor)
    yield from _assembly_steps(sensor)


def _preparation_steps(sensor: BuildableDesign) -> Iterator[_GuideStep]:
    """Yield the steps before any silicone is poured."""
    design = sensor.design
    yield _GuideStep(
        "inserts",
        "Press in the inserts",
        "Heat eight M2 inserts with a soldering iron at about 230 °C. Press four into the base's bosses from above and four "
        "into the shell's bosses from below, flush and upright.",
        "An M2 screw turned in by hand stands upright, and the shell does not rock on the base. (Inserts melt into nylon, "
        "PETG or ABS; into a resin print they are glued.)",
    )
    yield _GuideStep(
        "window",
        "Glue in the window",
        f"Peel the film off both sides of the {design.window.side_mm:g} mm acrylic plate. Run a thin bead of clear glue "
        "(silicone or UV, fully cured before the next step) around the ledge and press the plate into its frame from the gel side. "
        "Keep the middle clean and do not use alcohol, which cracks laser-cut acrylic.",
        "Put a few drops of water with a little dish soap on the window: after five minutes the paper below is still dry. There "
        f"is no smear within {design.shell.hole_mm / 2:g} mm of the middle.",
    )


def _casting_steps(sensor: BuildableDesign) -> Iterator[_GuideStep]:
    """Yield the steps that cast the three layers."""
    design = sensor.design
    rim = design.heights.rim - design.heights.floor_top
    translucent = translucent_silicone_of_modulus(design.sensor.gel.shear_modulus_mpa)
    yield _GuideStep(
        "transparent",
        "Pour the transparent gel",
        f"Stand the shell level. Mix {_mixture(sensor, TRANSPARENT_SILICONE)}, "
        f"draw off the bubbles in a vacuum, and fill the shell to its rim, {rim:.1f} mm. Cure {TRANSPARENT_SILICONE.cure}.",
        "Printed letters are sharp when seen through window and gel. A straight edge over the rim shows less than 0.1 mm of "
        "light anywhere; fill up what is missing and cure again.",
    )
    yield _GuideStep(
        "first_mould",
        "Clamp the first mould",
        f"Screw the shell on the base board with four M2 screws from below. Lay the first mould, "
        f"{design.sensor.gel.thickness_mm:g} mm thick, on the rim and clamp it with eight "
        f"M3 x {mould_clamp_screw_length_mm(design)} screws and nuts, crosswise and gently, with release agent on the mould's "
        "window.",
        f"Measure the whole stack with a calliper at four corners and subtract base board and shell: "
        f"{design.sensor.gel.thickness_mm:.2f} ± 0.10 mm remain. This is the gel's thickness, on which all depths rest.",
    )
    yield _GuideStep(
        "translucent",
        "Pour the translucent gel",
        f"Mix {_mixture(sensor, translucent)}, without bubbles. Pour "
        f"until it stands level with the mould and scrape once with a straight edge. Cure {translucent.cure}.",
        "The layer is evenly white over a lamp, without bubbles or streaks, and does not lift when the mould is taken off.",
    )
    yield _GuideStep(
        "black",
        "Pour the black gel",
        f"Take off the first mould and clamp the second ({design.heights.second_mould:.2f} mm). "
        "Lay the LED board below the clear base board and switch it on. "
        f"Mix {_mixture(sensor, BLACK_GEL_SILICONE)}, and add pigment until a drop on the lit "
        f"layer lets no light through. Pour around and over the layer and scrape level. Cure {BLACK_GEL_SILICONE.cure}.",
        "In a dark room with the LEDs on, no light passes through the top or the sides. Where some does, pour again.",
    )
    yield _GuideStep(
        "demoulded",
        "Take it out",
        "Unscrew the clamps, run a thin blade around the mould's window, lift the mould straight up and unscrew the base board.",
        f"The skin is smooth and stands {design.heights.second_mould:.2f} ± 0.10 mm above the rim; "
        "no edge lifts when it is rubbed with a finger.",
    )


def _assembly_steps(sensor: BuildableDesign) -> Iterator[_GuideStep]:
    """Yield the steps that mount camera, light and screws, and calibrate."""
    design = sensor.design
    own = "" if design.sensor == SensorDesign() else OWN_DESIGN
    nearest_mm, farthest_mm = (
        paraxial_skin_mm_per_rad(design.sensor),
        design.sensor.camera.distance_mm + FOCUS_BEYOND_MM,
    )
    yield _GuideStep(
        "camera",
        "Lay in the camera",
        "Put the camera into the base's pocket, lens up, its cable up the ramp and out at the side. A drop of glue at two "
        "corners holds it; keep glue off the lens.",
        "`ninedtact doctor` lists the camera and its measured frame rate. Turn the lens until print "
        f"{nearest_mm:.0f} to {farthest_mm:.0f} mm above it is sharp: the first "
        "is the distance of the skin as seen through acrylic and silicone, the second that of the print by which the original's "
        "authors focus.",
    )
    yield _GuideStep(
        "board",
        "Lay on the LED board",
        f"Lay it over the four pins, LEDs up, USB over the cable. It must be {design.board.thick_mm:.2f} mm thick.",
        "It lies flat on all four posts, the lens stands free in its hole, and with USB plugged in all eight LEDs are equally "
        "bright.",
    )
    yield _GuideStep(
        "ring",
        "Put in the isolation ring",
        "Lay the shell upside down on its gel, and the ring into its square hole, the wide mouth down to the window. Black paint "
        "on the white ledges beside it helps against stray light.",
        "Seen from below, no white wall of the hole is visible, and the ring does not protrude from the shell's floor.",
    )
    yield _GuideStep(
        "closed",
        "Close it",
        "Leave the shell upside down, so that the ring stays, and lower the base with camera and board onto it, the cable through "
        f"its gap. Tighten four M2 x {design.fasteners.screw_mm:g} screws, crosswise.",
        f"It measures {design.horizontal_dimensions.outer[0]:.1f} x {design.horizontal_dimensions.outer[1]:.1f} x "
        f"{design.heights.top:.1f} mm. "
        "`ninedtact live` shows an evenly bright image without a dark ring or a bright spot at its rim.",
    )
    yield _GuideStep(
        "calibrated",
        "Calibrate it",
        "Press the calibration board over the shell, then the ball: "
        f"`ninedtact calibrate --out my_sensor --source 0{own}` guides you through both.",
        "All checks of the certificate are passed; docs/calibrating.md says what to do about one that is not.",
    )


def _mixture(sensor: BuildableDesign, silicone: GelSilicone) -> str:
    """State the mass to mix for one layer, the product and the ratio of its components."""
    mass_g = silicone.grams(sensor.parts[silicone.part].volume_mm3)
    return f"{mass_g:.1f} g of {silicone.product}, {silicone.ratio}"


SIZE_PX = 800, 600
SECTION_VIEW = ViewAngles(-68.0, 24.0)
BETWEEN_MM = 24.0
"""Distance of two parts that stand beside one another."""


@dataclass(frozen=True)
class _AssemblyScene:
    """The bodies in an image and the direction from which they are seen."""

    bodies: list[AssemblyBody]
    eye: ViewAngles = FROM_ABOVE
    cut: bool = False
    """Whether the half at -y is removed."""

    def image(self) -> BgrImage:
        """Render the scene."""
        return render_solids(
            colour_bodies(cut_bodies_open(self.bodies) if self.cut else self.bodies), self.eye, SIZE_PX
        )


@dataclass(frozen=True)
class _AssemblyScenes:
    """The scenes of all states of one sensor's parts."""

    sensor: BuildableDesign

    def scene(self, state: _AssemblyState) -> _AssemblyScene:
        """Return the scene of a state."""
        return {
            "inserts": lambda: _AssemblyScene([*self.base(), *self.beside(self.shell())]),
            "window": lambda: _AssemblyScene([*self.shell(), self.body("acrylic_window", 6.0)]),
            "transparent": lambda: _AssemblyScene(self.filled_shell(), SECTION_VIEW, cut=True),
            "first_mould": lambda: _AssemblyScene([*self.clamped_shell(14.0), self.mould("first_mould", 12.0)]),
            "translucent": lambda: _AssemblyScene(
                [*self.clamped_shell(), self.mould("first_mould"), self.body("translucent_gel")], SECTION_VIEW, cut=True
            ),
            "black": lambda: _AssemblyScene(
                [
                    *self.clamped_shell(),
                    self.mould("second_mould"),
                    self.body("translucent_gel"),
                    self.body("black_gel"),
                ],
                SECTION_VIEW,
                cut=True,
            ),
            "demoulded": lambda: _AssemblyScene(self.shell_with_gels()),
            "camera": lambda: _AssemblyScene([*self.base(), self.body("camera")]),
            "board": lambda: _AssemblyScene([*self.base(), self.body("camera"), self.body("led_board")]),
            "ring": lambda: _AssemblyScene([*self.shell_with_gels(), self.body("isolation_ring", -14.0)], FROM_BELOW),
            "closed": lambda: _AssemblyScene(self.sensor.bodies),
            "calibrated": lambda: _AssemblyScene([*self.sensor.bodies, self.tray()], ViewAngles(-52.0, -20.0)),
        }[state]()

    def beside(self, bodies: list[AssemblyBody]) -> Iterator[AssemblyBody]:
        """Yield bodies next to the middle, upside down on the shell's rim."""
        design = self.sensor.design
        away, rim = design.horizontal_dimensions.outer[0] + BETWEEN_MM, design.heights.rim
        for body in bodies:
            turned = body.solid.rotate(Axis.X, 180)
            yield replace(body, solid=Part() + Pos(away, 0, rim) * turned)

    def body(self, name: str, lift_mm: float = 0.0) -> AssemblyBody:
        """Return one part, raised above its position."""
        return AssemblyBody(name, Pos(0, 0, lift_mm) * self.sensor.parts[name].solid)

    def base(self) -> list[AssemblyBody]:
        """Return the base with its inserts."""
        return [self.body("sensor_base"), *self.inserts(range(1, 5))]

    def shell(self) -> list[AssemblyBody]:
        """Return the shell with its inserts."""
        return [self.body("sensor_shell"), *self.inserts(range(5, 9))]

    def inserts(self, numbers: range) -> Iterator[AssemblyBody]:
        """Return inserts by number: those of the base are 1 to 4, those of the shell 5 to 8."""
        names = {f"insert_{number}" for number in numbers}
        return (body for body in self.sensor.bodies if body.name in names)

    def filled_shell(self) -> list[AssemblyBody]:
        """Return the shell with window and transparent gel."""
        return [*self.shell(), self.body("acrylic_window"), self.body("transparent_gel")]

    def shell_with_gels(self) -> list[AssemblyBody]:
        """Return the shell with all layers."""
        return [*self.filled_shell(), self.body("translucent_gel"), self.body("black_gel")]

    def clamped_shell(self, drop_mm: float = 0.0) -> list[AssemblyBody]:
        """Return the filled shell on the base board."""
        design = self.sensor.design
        under = design.heights.plate_top - design.moulds.base_mm - drop_mm
        return [*self.filled_shell(), self.body("base_board", under)]

    def mould(self, name: str, lift_mm: float = 0.0) -> AssemblyBody:
        """Return a mould on the shell's rim, raised above it."""
        return self.body(name, self.sensor.design.heights.rim + lift_mm)

    def tray(self) -> AssemblyBody:
        """Return the calibration board over the sensor, its pins a little above the skin."""
        design = self.sensor.design
        tip = design.pin_frame.floor_mm + design.pin_frame.pin_tall_mm
        turned = Rot(180, 0, 0) * self.sensor.parts["calibration_board"].solid
        above = design.heights.top + tip + 12.0
        return AssemblyBody("calibration_board", Part() + Pos(0, 0, above) * turned)


PAGE, IMAGES = "fabrication.md", "images"
INTRODUCTION = """# How to build a sensor

Written by `ninedtact hardware guide`: numbers and images are those of {whose}, with a sensing area of {area} mm
and {gel} mm of gel. `ninedtact hardware export --out parts{options}` writes the files that the parts are made from, and
`parts/bom.html` lists what to buy. Silicones, ratios and curing are those of the paper
([references.md](references.md#9dtact)). The instructions on inserts, bubbles and glue, and all
checks, are our own. Nobody has built a sensor from this page yet.

You need: a scale that shows 0.01 g, a vacuum chamber for the silicone, an oven that holds 50 °C, a calliper, a soldering iron,
M2 and M3 screwdrivers, and {days} days, nearly all of them waiting. Work with silicone and glue in fresh air, with gloves of
nitrile or vinyl: platinum silicones such as Ecoflex do not cure in contact with latex, tin-cured silicone, sulphur, or resin
prints and UV glue that are not fully cured. Before you pour, let a drop of each silicone cure on the parts that it will touch.
"""
DAYS = 2


def format_fabrication_guide(sensor: BuildableDesign) -> str:
    """Return the fabrication guide of a design as Markdown."""
    design = sensor.design
    area = f"{design.sensor.sensing_area.width_mm:g} x {design.sensor.sensing_area.height_mm:g}"
    gel = f"{design.sensor.gel.thickness_mm:g}"
    opening = INTRODUCTION.format(
        whose=_design_name(design), area=area, gel=gel, options=_design_options(design), days=DAYS
    )
    sections = [_format_step(number, step) for number, step in enumerate(_list_guide_steps(sensor), start=1)]
    return "\n".join([opening, *sections])


def _design_name(design: HardwareDesign) -> str:
    """Return the name of the design that the page describes."""
    return f"the {design.variant} design" if _is_published_size(design) else "a design of its own"


def _design_options(design: HardwareDesign) -> str:
    """Return the options with which a hardware command works on this design; none for the default one."""
    own = "" if _is_published_size(design) else OWN_DESIGN
    return own + ("" if design.variant == "default" else f" --variant {design.variant}")


def _is_published_size(design: HardwareDesign) -> bool:
    """Return whether no dimension differs from those of its variant."""
    return design == hardware_design_of_variant(SensorDesign(), design.variant)


def _format_step(number: int, step: _GuideStep) -> str:
    """Return one step as Markdown."""
    return (
        f"## {number}. {step.title}\n\n{step.do}\n\n![{step.title}]({IMAGES}/{_image_name(number, step)})\n\n"
        f"**It worked if:** {step.check}\n"
    )


def _image_name(number: int, step: _GuideStep) -> str:
    """Return the file name of a step's image, numbered in the order of the steps."""
    return f"fabrication_{number:02d}_{step.state}.png"


def write_fabrication_guide(sensor: BuildableDesign, out: Path) -> Iterator[Path]:
    """Draw the images of the page, yielding the path of each, then write them and the page; raises `FileNotWritten`.

    Nothing is written before all is drawn: a guide that is interrupted does not put new images beside the text of an earlier one.
    """
    (out / IMAGES).mkdir(parents=True, exist_ok=True)
    states, contents = _AssemblyScenes(sensor), dict[Path, bytes]()
    for number, step in enumerate(_list_guide_steps(sensor), start=1):
        path = out / IMAGES / _image_name(number, step)
        contents[path] = cv2.imencode(".png", states.scene(step.state).image())[1].tobytes()
        yield path
    for path, content in contents.items():
        write_file_atomically(path, content)
    write_file_atomically(out / PAGE, format_fabrication_guide(sensor).encode())
    yield out / PAGE
