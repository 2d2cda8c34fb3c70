"""Parts as KiCad's footprints."""

from ninedtact.hardware.led_board.drawing import SILK_MM, THERMAL_PASTE_MM, Blob, flash, windows
from ninedtact.hardware.led_board.kicad_frame import Names, at, beside, stamp
from ninedtact.hardware.led_board.layout import Layout
from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.pads import Pad
from ninedtact.hardware.led_board.placement import Placed
from ninedtact.hardware.led_board.sexpr import Expression, quoted

FONT: Expression = ("font", ("size", 0.8, 0.8), ("thickness", 0.12))


def footprint(layout: Layout, part: Placed, names: Names) -> Expression:
    """A part with its pads, mark and pegs."""
    letter = "F" if part.side == "top" else "B"
    mine = [pad for pad in layout.pads if pad.pin.split(".")[0] == part.reference]
    pads = [pad_lines(pad, part.at_mm, letter, names) for pad in mine]
    paste = [window for pad in mine if not pad.land.paste and not pad.hole for window in paste_lines(pad, part, letter)]
    return (
        *("footprint", quoted(f"ninedtact:{part.part.footprint.name}"), ("layer", quoted(f"{letter}.Cu"))),
        *(stamp(part.reference), at(part.at_mm), ("attr", "smd")),
        *(words("reference", part.reference, letter), words("value", part.part.value, letter)),
        *(*mark_lines(part, letter), *pads, *paste, *peg_lines(part)),
    )


def words(kind: str, text: str, letter: str) -> Expression:
    """Reference or value, on the fabrication layer."""
    effects: Expression = ("effects", FONT) if letter == "F" else ("effects", FONT, ("justify", "mirror"))
    line = 0 if kind == "reference" else 1
    return ("fp_text", kind, quoted(text), ("at", 0, line), ("layer", quoted(f"{letter}.Fab")), effects)


def mark_lines(part: Placed, letter: str) -> list[Expression]:
    """The bar at the cathode or at pin 1."""
    if part.part.footprint.mark_mm is None:
        return []
    start, end = (part.onto_board(place) for place in part.part.footprint.mark_mm)
    ends = beside("start", start, part.at_mm), beside("end", end, part.at_mm)
    return [("fp_line", *ends, ("layer", quoted(f"{letter}.SilkS")), ("width", SILK_MM))]


def pad_lines(pad: Pad, origin: Place, letter: str, names: Names) -> Expression:
    """One pad."""
    number = quoted(pad.land.number)
    net = (("net", names.number(pad.net), quoted(pad.net)),) if pad.net else ()
    where, solid = beside("at", pad.at_mm, origin), () if pad.land.pour_gap else (("zone_connect", 2),)
    layers: Expression = ("layers", *(quoted(f"{letter}.{name}") for name in layer_names(pad)))
    tail = (*net, *solid, stamp(f"pad {pad.pin}"))
    size = ("size", *pad.size_mm)
    if pad.hole and pad.land.slot_mm:
        drill, everywhere = ("drill", "oval", *pad.land.slot_mm), ("layers", quoted("*.Cu"), quoted("*.Mask"))
        return ("pad", number, "thru_hole", "oval", where, size, drill, everywhere, *tail)
    if pad.bites:
        return ("pad", number, "smd", "custom", where, ("size", 0.5, 0.5), layers, *tail[:-1], *outline(pad), tail[-1])
    if pad.land.corner_mm:
        share = pad.land.corner_mm / min(pad.size_mm)
        return ("pad", number, "smd", "roundrect", where, size, layers, ("roundrect_rratio", share), *tail)
    return ("pad", number, "smd", "rect", where, size, layers, *tail)


def layer_names(pad: Pad) -> tuple[str, ...]:
    """Layers of a pad without a hole."""
    return ("Cu", "Paste", "Mask") if pad.land.paste else ("Cu", "Mask")


def outline(pad: Pad) -> tuple[Expression, ...]:
    """The shape of a pad that gave something up."""
    shape = flash(pad, 0.0)
    assert isinstance(shape, Blob)
    points: Expression = ("pts", *(("xy", x, -y) for x, y in shape.points))
    polygon: Expression = ("gr_poly", points, ("width", 0), ("fill", True))
    return ("options", ("clearance", "outline"), ("anchor", "circle")), ("primitives", polygon)


def paste_lines(pad: Pad, part: Placed, letter: str) -> list[Expression]:
    """Windows of paste on the thermal pad."""
    layers, size = ("layers", quoted(f"{letter}.Paste")), ("size", THERMAL_PASTE_MM, THERMAL_PASTE_MM)
    places = [beside("at", window.at_mm, part.at_mm) for window in windows(pad)]
    return [("pad", quoted(""), "smd", "rect", place, size, layers) for place in places]


def peg_lines(part: Placed) -> list[Expression]:
    """Holes for pegs."""
    found: list[Expression] = []
    for x, y, diameter in part.part.footprint.pegs_mm:
        where, layers = beside("at", part.onto_board((x, y)), part.at_mm), ("layers", quoted("*.Cu"), quoted("*.Mask"))
        size = ("size", diameter, diameter), ("drill", diameter)
        found.append(("pad", quoted(""), "np_thru_hole", "circle", where, *size, layers))
    return found
