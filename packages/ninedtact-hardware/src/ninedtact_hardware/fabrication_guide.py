"""The fabrication guide: a `BuildableDesign` goes in, a Markdown page with an image of the parts after each step comes out.

The page is the template fabrication.md.jinja with the dimensions of the design. It names the image of each step.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from build123d import Axis, Part, Pos, Rot

from ninedtact.atomic_write import write_file_atomically
from ninedtact.capture.strict_image_reading import encode_png
from ninedtact.design import SensorDesign
from ninedtact.page_template import render_page
from ninedtact.simulation.twin import paraxial_skin_mm_per_rad
from ninedtact_hardware.bill_of_materials import mould_clamp_screw_length_mm
from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.design import hardware_design_of_variant
from ninedtact_hardware.materials import (
    BLACK_GEL_SILICONE,
    TRANSPARENT_SILICONE,
    translucent_silicone_of_modulus,
)
from ninedtact_hardware.part_and_assembly_images import (
    FROM_ABOVE,
    FROM_BELOW,
    ViewAngles,
    colour_bodies,
    cut_bodies_open,
    render_solids,
)
from ninedtact_hardware.sensor_assembly import BuiltPart

FOCUS_BEYOND_MM = 0.95
"""Distance beyond the skin at which the lens is focused: the original's authors focus on print at 15 mm, the skin lies
14.05 from the lens."""
OWN_DESIGN = " --design your_design.toml"


def format_fabrication_guide(sensor: BuildableDesign) -> str:
    """Return the fabrication guide of a design as Markdown."""
    design, published = sensor.design, SensorDesign()
    is_published_size = design == hardware_design_of_variant(published, design.variant)
    variant_option = "" if design.variant == "default" else f" --variant {design.variant}"
    return render_page(
        "ninedtact_hardware",
        "fabrication.md.jinja",
        design=design,
        design_name=f"the {design.variant} design" if is_published_size else "a design of its own",
        design_options=("" if is_published_size else OWN_DESIGN) + variant_option,
        sensor_option="" if design.sensor == published else OWN_DESIGN,
        area=design.sensor.sensing_area,
        gel_mm=design.sensor.gel.thickness_mm,
        heights=design.heights,
        size_mm=(*design.horizontal_dimensions.outer, design.heights.top),
        clamp_screw_mm=mould_clamp_screw_length_mm(design),
        focus_mm=(paraxial_skin_mm_per_rad(design.sensor), design.sensor.camera.distance_mm + FOCUS_BEYOND_MM),
        parts=sensor.parts,
        transparent=TRANSPARENT_SILICONE,
        translucent=translucent_silicone_of_modulus(design.sensor.gel.shear_modulus_mpa),
        black=BLACK_GEL_SILICONE,
    )


SIZE_PX = 800, 600
SECTION_VIEW = ViewAngles(-68.0, 24.0)
BETWEEN_MM = 24.0
"""Distance of two parts that stand beside one another."""


@dataclass(frozen=True)
class _AssemblyScene:
    bodies: list[BuiltPart]
    eye: ViewAngles = FROM_ABOVE
    cut: bool = False
    """Whether the half at -y is removed."""


def _assembly_scenes(sensor: BuildableDesign) -> dict[str, _AssemblyScene]:
    """Return the scene after each step, by the name of its image in the template."""
    design, levels = sensor.design, sensor.design.heights

    def part(name: str, lift_mm: float = 0.0) -> BuiltPart:
        """Return one part, raised above its position; moulds and base board lie on z = 0."""
        return BuiltPart(name, Pos(0, 0, lift_mm) * sensor.parts[name].solid)

    inserts = [body for body in sensor.bodies if body.kind == "insert"]
    base, shell = [part("sensor_base"), *inserts[:4]], [part("sensor_shell"), *inserts[4:]]
    beside = Pos(design.horizontal_dimensions.outer[0] + BETWEEN_MM, 0, levels.rim)
    shell_on_its_rim = [replace(body, solid=Part() + beside * body.solid.rotate(Axis.X, 180)) for body in shell]
    filled = [*shell, part("acrylic_window"), part("transparent_gel")]
    under_shell = levels.plate_top - design.moulds.base_mm
    clamped = [*filled, part("base_board", under_shell)]
    translucent, black = part("translucent_gel"), part("black_gel")
    finished_shell = [*filled, translucent, black]
    # The calibration board faces the skin, its pins 12 mm above it.
    tray_lift = levels.top + design.pin_frame.floor_mm + design.pin_frame.pin_tall_mm + 12.0
    facing_down = Pos(0, 0, tray_lift) * (Rot(180, 0, 0) * sensor.parts["calibration_board"].solid)
    tray = BuiltPart("calibration_board", Part() + facing_down)
    return {
        "01_inserts": _AssemblyScene([*base, *shell_on_its_rim]),
        "02_window": _AssemblyScene([*shell, part("acrylic_window", 6.0)]),
        "03_transparent": _AssemblyScene(filled, SECTION_VIEW, cut=True),
        "04_first_mould": _AssemblyScene(
            [*filled, part("base_board", under_shell - 14.0), part("first_mould", levels.rim + 12.0)]
        ),
        "05_translucent": _AssemblyScene(
            [*clamped, part("first_mould", levels.rim), translucent], SECTION_VIEW, cut=True
        ),
        "06_black": _AssemblyScene(
            [*clamped, part("second_mould", levels.rim), translucent, black], SECTION_VIEW, cut=True
        ),
        "07_demoulded": _AssemblyScene(finished_shell),
        "08_camera": _AssemblyScene([*base, part("camera")]),
        "09_board": _AssemblyScene([*base, part("camera"), part("led_board")]),
        "10_ring": _AssemblyScene([*finished_shell, part("isolation_ring", -14.0)], FROM_BELOW),
        "11_closed": _AssemblyScene(sensor.bodies),
        "12_calibrated": _AssemblyScene([*sensor.bodies, tray], ViewAngles(-52.0, -20.0)),
    }


def write_fabrication_guide(sensor: BuildableDesign, out: Path) -> Iterator[Path]:
    """Draw the images of the page, yielding the path of each, then write them and the page; raises `FileNotWritten`.

    Nothing is written before all is drawn: a guide that is interrupted does not put new images beside the text of an earlier one.
    """
    (out / "images").mkdir(parents=True, exist_ok=True)
    contents = dict[Path, bytes]()
    for name, scene in _assembly_scenes(sensor).items():
        path = out / "images" / f"fabrication_{name}.png"
        bodies = cut_bodies_open(scene.bodies) if scene.cut else scene.bodies
        image = render_solids(colour_bodies(bodies), scene.eye, SIZE_PX)
        contents[path] = encode_png(image)
        yield path
    page = out / "fabrication.md"
    for path, content in (contents | {page: format_fabrication_guide(sensor).encode()}).items():
        write_file_atomically(path, content)
    yield page
