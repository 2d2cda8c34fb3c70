"""The bill of materials: the parts of one sensor, its adapter and cable, and the tools to make it, also as CSV and HTML.

Prices are our own estimates for single pieces in US dollars, rounded to cents, without shipping; no shop was contacted. The
paper states about $15, which is compared with the parts of one sensor alone.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from typing import Literal

from ninedtact.csv_table import to_csv
from ninedtact.design import CameraGeometry
from ninedtact.page_template import render_page
from ninedtact_hardware.design import HardwareDesign
from ninedtact_hardware.materials import (
    BLACK_GEL_SILICONE,
    MATERIAL_OF_PART,
    TRANSPARENT_SILICONE,
    translucent_silicone_of_modulus,
)
from ninedtact_hardware.part_dimensions import CameraDimensions, FastenerDimensions

BillItemKind = Literal["sensor", "connection", "tool"]
BILL_SECTIONS: dict[BillItemKind, str] = {
    "sensor": "One sensor",
    "connection": "Adapter and cable, for each sensor in use",
    "tool": "Tools, once for many sensors",
}
"""Heading of each section of the bill."""
SENSOR_USD_PER_CM3 = {"sensor_base": 0.35, "sensor_shell": 0.45, "isolation_ring": 0.35}
"""Price of printed parts: resin, and laser-sintered nylon."""
TRAY_USD_PER_CM3 = SENSOR_USD_PER_CM3["sensor_shell"]
"""The calibration board is made of the shell's nylon."""
SILICONE_USD_PER_G = 0.05
ACRYLIC_USD_PER_CM3 = 0.05
CAMERA_USD, BOARD_USD, CUT_USD = 6.0, 2.5, 0.2
PUBLISHED_BOARD_MM2 = 28.0 * 21.0
"""Board area that `BOARD_USD` is for. A larger board costs proportionally more, a smaller one the same."""
NUT_MM = 2.4
"""Height of an M3 nut (ISO 4032)."""


@dataclass(frozen=True)
class BillItem:
    """One item of the bill of materials."""

    kind: BillItemKind
    """Part of the sensor, what connects it to a computer, or a tool that is used for many sensors."""
    name: str
    count: int
    what: str
    """Description that suffices to order it."""
    each_usd: float
    """Estimated price of one piece."""

    @property
    def usd(self) -> float:
        """Estimated price of all pieces."""
        return round(self.count * self.each_usd, 2)


def build_bill_of_materials(design: HardwareDesign, volumes_mm3: Mapping[str, float]) -> list[BillItem]:
    """Return all items of the bill of materials.

    volumes_mm3: volumes of the parts that are made, by name.
    """
    cm3 = {name: volume / 1000 for name, volume in volumes_mm3.items()}
    items = *_sensor_items(design, cm3), *_connection_items(), *_tool_items(design, cm3)
    return [replace(item, each_usd=round(item.each_usd, 2)) for item in items]


def _sensor_items(design: HardwareDesign, cm3: Mapping[str, float]) -> Iterator[BillItem]:
    """Yield what is printed, cut, cast (silicones by mass, waste included) and bought for one sensor."""
    for name, price in SENSOR_USD_PER_CM3.items():
        yield BillItem("sensor", name, 1, f"{MATERIAL_OF_PART[name].name}, {cm3[name]:.2f} cm³", price * cm3[name])
    yield _cut_item("sensor", "acrylic_window", f"{design.window.thick_mm:g}", cm3)
    translucent = translucent_silicone_of_modulus(design.sensor.gel.shear_modulus_mpa)
    for silicone in (TRANSPARENT_SILICONE, translucent, BLACK_GEL_SILICONE):
        grams = silicone.grams(cm3[silicone.part])
        what = f"{silicone.product}, {silicone.ratio}; mix {grams:.1f} g"
        yield BillItem("sensor", silicone.part, 1, what, grams * SILICONE_USD_PER_G)
    yield BillItem("sensor", "camera", 1, _describe_camera(design), CAMERA_USD)
    wide, deep = design.horizontal_dimensions.led_board
    outline = f"{wide:g} x {deep:g} mm, FR4 {design.board.thick_mm:.2f} mm thick, two layers; see led_board/"
    yield BillItem("sensor", "led_board", 1, outline, BOARD_USD * max(1.0, wide * deep / PUBLISHED_BOARD_MM2))
    diameter, long = design.fasteners.insert_mm
    trade_name = " (M2-3-5)" if (diameter, long) == FastenerDimensions.insert_mm else ""
    yield BillItem("sensor", "insert", 8, f"M2 heat-set insert, about d{diameter:g} x {long:g} mm{trade_name}", 0.04)
    screw = f"M2 x {design.fasteners.screw_mm:g}, pan head d{design.fasteners.head_mm[0]:g}"
    yield BillItem("sensor", "screw", 4, screw, 0.02)


def _cut_item(kind: BillItemKind, name: str, thick_mm: str, cm3: Mapping[str, float]) -> BillItem:
    price = CUT_USD + ACRYLIC_USD_PER_CM3 * cm3[name]
    return BillItem(kind, name, 1, f"clear acrylic, {thick_mm} mm, laser-cut", price)


def _describe_camera(design: HardwareDesign) -> str:
    """Return the published camera, or what is known of another one: its lens angle, and its dimensions where these differ."""
    published = f"Frank-S15-V1.0-160 (OV5647, {CameraGeometry.lens_angle_deg:g}°)"
    camera, angle_deg = design.camera, design.sensor.camera.lens_angle_deg
    if camera == CameraDimensions() and angle_deg == CameraGeometry.lens_angle_deg:
        return f"{published}, with its flat cable"
    wide_mm, (head_mm, tall_mm) = camera.side_mm, camera.head_mm
    return (
        f"camera with a lens of {angle_deg:g}° along the diagonal, {wide_mm:g} x {wide_mm:g} mm wide, {tall_mm:g} mm high, "
        f"lens head d{head_mm:g} mm, with its flat cable, in place of {published}"
    )


def _connection_items() -> Iterator[BillItem]:
    yield BillItem("connection", "light cable", 1, "micro-USB cable; any 5 V USB supply", 2.0)
    adapter = "from the camera's flat cable to USB (UVC), as its seller offers it"
    yield BillItem("connection", "camera adapter", 1, adapter, 5.0)


def _tool_items(design: HardwareDesign, cm3: Mapping[str, float]) -> Iterator[BillItem]:
    for name, thick in (
        ("base_board", design.moulds.base_mm),
        ("first_mould", design.heights.first_mould),
        ("second_mould", design.heights.second_mould),
    ):
        yield _cut_item("tool", name, f"{thick:.2f}", cm3)
    tray_usd = TRAY_USD_PER_CM3 * cm3["calibration_board"]
    yield BillItem("tool", "calibration_board", 1, MATERIAL_OF_PART["calibration_board"].name, tray_usd)
    yield BillItem("tool", "clamp screw and nut", 8, f"M3 x {mould_clamp_screw_length_mm(design)}, with nut", 0.05)
    ball = f"steel ball, diameter {2 * design.sensor.ball.radius_mm:g} mm, to calibrate with"
    yield BillItem("tool", "ball", 1, ball, 0.5)
    glue = "clear silicone glue or UV glue for the window; release agent for the moulds"
    yield BillItem("tool", "glue", 1, glue, 4.0)


def mould_clamp_screw_length_mm(design: HardwareDesign) -> int:
    """Return the length of the M3 screws that pass base board, shell, the thicker mould and a nut; sold in steps of 5
    mm."""
    shell = design.heights.rim - design.heights.plate_top
    stack = design.moulds.base_mm + shell + design.heights.second_mould
    return 5 * ceil((stack + NUT_MM) / 5)


def bill_items_cost_usd(items: Iterable[BillItem], *kinds: BillItemKind) -> float:
    """Return the estimated cost of all items, or of those of some kinds."""
    return round(sum(item.usd for item in items if not kinds or item.kind in kinds), 2)


def sensor_cost_usd(items: Iterable[BillItem]) -> float:
    """Return the estimated cost of the parts of one sensor, which is what the paper states."""
    return bill_items_cost_usd(items, "sensor")


CSV_HEADINGS = "kind", "name", "count", "what", "each_usd_estimated", "together_usd_estimated"


def bill_to_csv(items: Sequence[BillItem]) -> bytes:
    """Return the bill of materials as CSV, one line per item."""
    rows = ((item.kind, item.name, item.count, item.what, f"{item.each_usd:.2f}", f"{item.usd:.2f}") for item in items)
    return to_csv(CSV_HEADINGS, rows)


def bill_to_html(design: HardwareDesign, items: Sequence[BillItem], drawn: Collection[str]) -> bytes:
    """Return the bill of materials as an HTML page that loads nothing but the part images beside it.

    drawn: names of the parts that have an image.
    """
    return render_page(
        "ninedtact_hardware",
        "bill_of_materials.html.jinja",
        design=design,
        items=items,
        sections=BILL_SECTIONS,
        cost_usd=bill_items_cost_usd,
        drawn=drawn,
    ).encode()
