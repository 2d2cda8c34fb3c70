"""Where the published paper and its files disagree, and what the default design of the published size takes."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Disagreement:
    """One thing that the paper and its files say differently."""

    thing: str
    paper: str
    files: str
    here: str
    """What the default design takes."""


DISAGREEMENTS = (
    Disagreement("height", "25.5 mm", "25.30 by the moulds, 25.00 by the CAD", "25.30: 2.50 + 0.30 of gel on 22.50"),
    Disagreement(
        "sensing area",
        "24 x 18 mm",
        "no such feature: an opening of 28.50 x 21.50, a crop of 23.0 to 23.5",
        "24 x 18, nominal",
    ),
    Disagreement(
        "circuit board", "28 x 21 x 4 mm", "0.80 thick in the assembly, 1.6 in the order file", "order 0.80 mm"
    ),
    Disagreement("translucent gel", "2.5 mm (mould)", "2.5 in the cutting file, 2.00 in the CAD", "2.50"),
    Disagreement("black gel", "0.3 mm (mould 2.8)", "2.8 in the cutting file, 0.50 in the CAD", "0.30"),
    Disagreement("screws", "4 x M2-6", "M2-5", "M2-6 (original: M2-5); both fit"),
    Disagreement(
        "calibration board",
        "fits into the sensor shell",
        "33.00 x 26.00 inside: fits over it",
        "over it, 0.25 each side",
    ),
    Disagreement(
        "LED resistor",
        "",
        "20 k in the order files, 3.75 k as text in the schematic",
        "20 k; [hardware.board] resistor_ohm",
    ),
)
"""Of the published paper and files."""
