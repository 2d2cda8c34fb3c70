"""All files of the board."""

from io import BytesIO
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from ninedtact.atomic_write import write_file_atomically
from ninedtact.hardware.led_board.check import sound_layout
from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.drawing import Layer, drawn
from ninedtact.hardware.led_board.drill import drilled
from ninedtact.hardware.led_board.edge import edges
from ninedtact.hardware.led_board.gerber import outlined, plotted
from ninedtact.hardware.led_board.image import image
from ninedtact.hardware.led_board.kicad import kicad_board
from ninedtact.hardware.led_board.kicad_project import kicad_project
from ninedtact.hardware.led_board.layout import SIDES, Layout
from ninedtact.hardware.led_board.placement import Side
from ninedtact.hardware.led_board.tables import notes, parts_list, placements

NAME = "led_board"
LETTER: dict[Side, str] = {"top": "F", "bottom": "B"}
LAYERS: tuple[tuple[Layer, str, str, str], ...] = (
    ("copper", "Cu", "Copper,L{number},{side}", "Positive"),
    ("mask", "Mask", "Soldermask,{side}", "Negative"),
    ("paste", "Paste", "Paste,{side}", "Positive"),
    ("silk", "Silkscreen", "Legend,{side}", "Positive"),
)
"""Our name, the file's, the Gerber function, the polarity."""
LONG_AGO = 1980, 1, 1, 0, 0, 0
"""The same board gives the same archive."""


def write_led_board(board: LedBoard, out: Path) -> list[Path]:
    """Write the board into a folder and tell the files; raises `BoardImpossible`, `FileNotWritten`."""
    return write_layout(sound_layout(board), out)


def write_layout(layout: Layout, out: Path) -> list[Path]:
    """The same for a board that is laid out; raises `FileNotWritten`."""
    files = contents(layout)
    (out / "gerbers").mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        write_file_atomically(out / name, content)
    return [out / name for name in files]


def contents(layout: Layout) -> dict[str, bytes]:
    """Every file by its name, for other packers too."""
    fabrication = {name: text.encode() for name, text in fabrication_files(layout).items()}
    texts = {
        f"{NAME}.kicad_pcb": kicad_board(layout),
        f"{NAME}.kicad_pro": kicad_project(layout.board, NAME),
        f"{NAME}_bom.csv": parts_list(layout),
        f"{NAME}_placement.csv": placements(layout),
        f"{NAME}_notes.txt": notes(layout),
    }
    return {
        **{f"gerbers/{name}": content for name, content in fabrication.items()},
        **{name: text.encode() for name, text in texts.items()},
        f"{NAME}.png": image(layout),
        f"{NAME}.svg": image(layout, "svg"),
        f"{NAME}_gerbers.zip": zipped({**fabrication, f"{NAME}_notes.txt": texts[f"{NAME}_notes.txt"].encode()}),
    }


def fabrication_files(layout: Layout) -> dict[str, str]:
    """Gerbers and drill files by their names."""
    files = {}
    for number, side in enumerate(SIDES, start=1):
        for layer, suffix, function, polarity in LAYERS:
            told = function.format(number=number, side="Top" if side == "top" else "Bot")
            files[f"{NAME}-{LETTER[side]}_{suffix}.gbr"] = plotted(drawn(layout, layer, side), told, polarity)
    files[f"{NAME}-Edge_Cuts.gbr"] = outlined(edges(layout.board.outline))
    files[f"{NAME}-PTH.drl"] = drilled(layout.holes, plated=True)
    files[f"{NAME}-NPTH.drl"] = drilled(layout.holes, plated=False)
    return files


def zipped(files: dict[str, bytes]) -> bytes:
    """An archive that is the same for the same files."""
    packed = BytesIO()
    with ZipFile(packed, "w", ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(ZipInfo(name, LONG_AGO), content, ZIP_DEFLATED)
    return packed.getvalue()
