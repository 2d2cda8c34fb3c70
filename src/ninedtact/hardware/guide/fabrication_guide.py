"""The fabrication guide as a Markdown page, and the images of the parts in the state after each step."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
from build123d import Axis, Part, Pos, Rot

from ninedtact.atomic_write import write_file_atomically
from ninedtact.design import SensorDesign
from ninedtact.hardware.assembly_images import colour_bodies, cut_bodies_open
from ninedtact.hardware.complete_design import CompleteDesign
from ninedtact.hardware.design import HardwareDesign, hardware_design_of_variant
from ninedtact.hardware.guide.assembly_steps import AssemblyState, GuideStep, list_guide_steps
from ninedtact.hardware.sensor_assembly import AssemblyBody
from ninedtact.hardware.solid_renderer import FROM_ABOVE, FROM_BELOW, BgrImage, ViewDirection, render_solids

SIZE_PX = 800, 600
SECTION_VIEW = ViewDirection(-68.0, 24.0)
BETWEEN_MM = 24.0
"""Distance of two parts that stand beside one another."""


@dataclass(frozen=True)
class _AssemblyScene:
    """The bodies in an image and the direction from which they are seen."""

    bodies: list[AssemblyBody]
    eye: ViewDirection = FROM_ABOVE
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

    sensor: CompleteDesign

    def scene(self, state: AssemblyState) -> _AssemblyScene:
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
            "calibrated": lambda: _AssemblyScene([*self.sensor.bodies, self.tray()], ViewDirection(-52.0, -20.0)),
        }[state]()

    def beside(self, bodies: list[AssemblyBody]) -> Iterator[AssemblyBody]:
        """Yield bodies next to the middle, upside down on the shell's rim."""
        design = self.sensor.design
        away, rim = design.plan_view.outer[0] + BETWEEN_MM, design.heights.rim
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
and {gel} mm of gel. `ninedtact hardware export --out parts` writes the files that the parts are made from, and
`parts/bom.html` lists what to buy. Silicones, ratios and curing are those of the paper
([references.md](references.md#9dtact)). The instructions on inserts, bubbles and glue, and all
checks, are our own. Nobody has built a sensor from this page yet.

You need: a scale that shows 0.01 g, a vacuum chamber for the silicone, an oven that holds 50 °C, a calliper, a soldering iron,
M2 and M3 screwdrivers, and {days} days, nearly all of them waiting. Work with silicone and glue in fresh air, with gloves of
nitrile or vinyl: platinum silicones such as Ecoflex do not cure in contact with latex, tin-cured silicone, sulphur, or resin
prints and UV glue that are not fully cured. Before you pour, let a drop of each silicone cure on the parts that it will touch.
"""
DAYS = 2


def format_guide(sensor: CompleteDesign) -> str:
    """Return the fabrication guide of a design as Markdown."""
    design = sensor.design
    area = f"{design.sensor.sensing_area.width_mm:g} x {design.sensor.sensing_area.height_mm:g}"
    gel = f"{design.sensor.gel.thickness_mm:g}"
    opening = INTRODUCTION.format(whose=_design_name(design), area=area, gel=gel, days=DAYS)
    sections = [_format_step(number, step) for number, step in enumerate(list_guide_steps(sensor), start=1)]
    return "\n".join([opening, *sections])


def _design_name(design: HardwareDesign) -> str:
    """Return the name of the design that the page describes."""
    return (
        f"the {design.variant} design"
        if design == hardware_design_of_variant(SensorDesign(), design.variant)
        else "a design of its own"
    )


def _format_step(number: int, step: GuideStep) -> str:
    """Return one step as Markdown."""
    return (
        f"## {number}. {step.title}\n\n{step.do}\n\n![{step.title}]({IMAGES}/{_image_name(number, step)})\n\n"
        f"**It worked if:** {step.check}\n"
    )


def _image_name(number: int, step: GuideStep) -> str:
    """Return the file name of a step's image, numbered in the order of the steps."""
    return f"fabrication_{number:02d}_{step.state}.png"


def write_fabrication_guide(sensor: CompleteDesign, out: Path) -> Iterator[Path]:
    """Write the page and its images, yielding each path once it is written; raises `FileNotWritten`."""
    (out / IMAGES).mkdir(parents=True, exist_ok=True)
    states = _AssemblyScenes(sensor)
    for number, step in enumerate(list_guide_steps(sensor), start=1):
        path = out / IMAGES / _image_name(number, step)
        write_file_atomically(path, cv2.imencode(".png", states.scene(step.state).image())[1].tobytes())
        yield path
    write_file_atomically(out / PAGE, format_guide(sensor).encode())
    yield out / PAGE
