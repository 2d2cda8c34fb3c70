"""Drill files (Excellon), millimetres: one for plated holes, one for the others. Slots are milled from end to end."""

from ninedtact.hardware.led_board.outline import Place
from ninedtact.hardware.led_board.pads import Hole


def drilled(holes: tuple[Hole, ...], plated: bool) -> str:
    """One file; tools in order of size."""
    chosen = [hole for hole in holes if hole.plated == plated]
    sizes = sorted({hole.width_mm for hole in chosen})
    kind = "Plated,1,2,PTH" if plated else "NonPlated,1,2,NPTH"
    lines = ["M48", f"; #@! TF.FileFunction,{kind}", "FMAT,2", "METRIC,TZ"]
    lines += [f"T{number}C{size:.3f}" for number, size in enumerate(sizes, start=1)]
    lines += ["%", "G05"]
    for number, size in enumerate(sizes, start=1):
        lines += [f"T{number}", *(line for hole in chosen if hole.width_mm == size for line in hit(hole))]
    return "\n".join([*lines, "T0", "M30", ""])


def hit(hole: Hole) -> list[str]:
    """One hole; or a slot: to its start, tool down, along, tool up, and back to drilling."""
    if hole.start_mm == hole.end_mm:
        return [at_place(hole.start_mm)]
    return [f"G00{at_place(hole.start_mm)}", "M15", f"G01{at_place(hole.end_mm)}", "M16", "G05"]


def at_place(place: Place) -> str:
    """A place with its decimal points."""
    return f"X{place[0]:.4f}Y{place[1]:.4f}"
