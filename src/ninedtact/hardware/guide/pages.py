"""The guide as Markdown with its images."""

from collections.abc import Iterator
from pathlib import Path

import cv2

from ninedtact.atomic_write import write_file_atomically
from ninedtact.design import SensorDesign
from ninedtact.hardware.design import HardwareDesign, hardware_for
from ninedtact.hardware.guide.states import States
from ninedtact.hardware.guide.steps import Step, steps
from ninedtact.hardware.report import BuiltSensor

PAGE, IMAGES = "fabrication.md", "images"
INTRODUCTION = """# How to build a sensor

Made by `ninedtact hardware guide`: numbers and images are those of {whose}, {area} mm of sensing area
under {gel} mm of gel. `ninedtact hardware export --out parts` writes the files that the parts are made from, and
`parts/bom.html` lists what to buy. Silicones, ratios and curing are those of the paper
([references.md](references.md#9dtact)). How to press in inserts, how to keep off bubbles and glue, and every check are ours.
Nobody built a sensor by this page yet.

You need: a scale that shows 0.01 g, a vacuum chamber for the silicone, an oven that holds 50 °C, a calliper, a soldering iron,
M2 and M3 screwdrivers, and {days} days, nearly all of them waiting. Fresh air for silicone and glue, and gloves of nitrile or
vinyl: platinum silicones, as Ecoflex is one, stay liquid beside latex, tin-cured silicone, sulphur, and resin prints or UV glue
that are not fully cured. Let a drop of each silicone cure on the parts that it will touch before you pour.
"""
DAYS = 2


def guide_text(sensor: BuiltSensor) -> str:
    """The whole page."""
    design = sensor.design
    area = f"{design.sensor.sensing_area.width_mm:g} x {design.sensor.sensing_area.height_mm:g}"
    gel = f"{design.sensor.gel.thickness_mm:g}"
    opening = INTRODUCTION.format(whose=whose(design), area=area, gel=gel, days=DAYS)
    told = [section(number, step) for number, step in enumerate(steps(sensor), start=1)]
    return "\n".join([opening, *told])


def whose(design: HardwareDesign) -> str:
    """Which design the page is about."""
    return (
        f"the {design.variant} design"
        if design == hardware_for(SensorDesign(), design.variant)
        else "a design of its own"
    )


def section(number: int, step: Step) -> str:
    """One step."""
    return (
        f"## {number}. {step.title}\n\n{step.do}\n\n![{step.title}]({IMAGES}/{image_name(number, step)})\n\n"
        f"**It worked if:** {step.check}\n"
    )


def image_name(number: int, step: Step) -> str:
    """In the order of the steps."""
    return f"fabrication_{number:02d}_{step.state}.png"


def write_guide(sensor: BuiltSensor, out: Path) -> Iterator[Path]:
    """Page and images, each whole; raises `FileNotWritten`."""
    (out / IMAGES).mkdir(parents=True, exist_ok=True)
    states = States(sensor)
    for number, step in enumerate(steps(sensor), start=1):
        path = out / IMAGES / image_name(number, step)
        write_file_atomically(path, cv2.imencode(".png", states.scene(step.state).image())[1].tobytes())
        yield path
    write_file_atomically(out / PAGE, guide_text(sensor).encode())
    yield out / PAGE
