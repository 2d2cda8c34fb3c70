"""The KiCad file: always a well-formed expression; and, where KiCad is installed, sound by KiCad's own check."""

import json
import re
import shutil
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from read_back import shape_of
from shapely import affinity

from ninedtact_hardware.led_board.board_parameters import LedBoardDesign
from ninedtact_hardware.led_board.complete_layout import BoardLayout, lay_out_board
from ninedtact_hardware.led_board.kicad import SHEET_CENTRE_MM, format_kicad_board

SYSTEM_PYTHON = "/usr/bin/python3"
SCRIPT = Path(__file__).with_name("kicad_report.py")


def parsed(text: str) -> list[Any]:
    """The expression as nested lists."""
    stack: list[list[Any]] = [[]]
    for token in re.findall(r'"(?:[^"\\]|\\.)*"|[()]|[^\s()"]+', text):
        if token == "(":
            stack.append([])
        elif token == ")":
            done = stack.pop()
            stack[-1].append(done)
        else:
            stack[-1].append(token)
    assert len(stack) == 1, "expected as many closing as opening brackets"
    return stack[0]


def lists(expression: list[Any], head: str) -> list[list[Any]]:
    return [part for part in expression if isinstance(part, list) and part[0] == head]


def test_it_is_one_balanced_expression(improved: BoardLayout) -> None:
    (board,) = parsed(format_kicad_board(improved))
    assert board[0] == "kicad_pcb"
    assert len(lists(board, "footprint")) == len(improved.parts) + 4
    assert len(lists(board, "via")) == len(improved.routes.vias)
    assert len(lists(board, "zone")) == 2
    assert [net[2] for net in lists(board, "net")] == ['""', '"VCC"', '"GND"', '"LED+"', '"ISET"']


def test_identities_are_unique(improved: BoardLayout) -> None:
    stamps = re.findall(r"\(tstamp ([^)]+)\)", format_kicad_board(improved))
    assert len(stamps) == len(set(stamps))


@dataclass(frozen=True)
class KiCad:
    """What KiCad says of a board, and the folder with its plots."""

    told: dict[str, Any]
    folder: Path


@cache
def why_not() -> str:
    if not shutil.which(SYSTEM_PYTHON):
        return f"expected {SYSTEM_PYTHON}, got none"
    tried = subprocess.run([SYSTEM_PYTHON, "-c", "import pcbnew"], capture_output=True, text=True)
    return tried.stderr.strip().splitlines()[-1] if tried.returncode else ""


def ask(layout: BoardLayout, project: str, folder: Path) -> KiCad:
    """What KiCad says."""
    if why_not():
        pytest.skip(f"expected KiCad's pcbnew for {SYSTEM_PYTHON}, got: {why_not()}; install Debian's kicad")
    (folder / "led_board.kicad_pcb").write_text(format_kicad_board(layout))
    (folder / "led_board.kicad_pro").write_text(project)
    command = [SYSTEM_PYTHON, str(SCRIPT), str(folder / "led_board.kicad_pcb"), str(folder)]
    run = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    return KiCad(json.loads(run.stdout[run.stdout.index("{") :]), folder)


@pytest.fixture(scope="module")
def kicad(folder: Path, improved: BoardLayout, tmp_path_factory: pytest.TempPathFactory) -> KiCad:
    return ask(improved, (folder / "led_board.kicad_pro").read_text(), tmp_path_factory.mktemp("kicad"))


def test_kicad_finds_no_violation(kicad: KiCad) -> None:
    assert (kicad.told["violations"], kicad.told["unconnected"]) == (0, 0), kicad.told["report"]


def test_kicad_reads_the_same_nets(kicad: KiCad, improved: BoardLayout) -> None:
    assert {net: set(pins) for net, pins in kicad.told["nets"].items()} == {n.name: set(n.pins) for n in improved.nets}
    assert kicad.told["thickness_mm"] == improved.board.outline.thickness_mm


@pytest.mark.parametrize("layer", ["F_Cu", "B_Cu"])
def test_kicad_plots_the_same_copper(kicad: KiCad, folder: Path, layer: str) -> None:
    (plotted,) = kicad.folder.glob(f"*{layer}.g*")
    ours = shape_of(folder / "gerbers" / f"led_board-{layer}.gbr")
    theirs = affinity.translate(shape_of(plotted), -SHEET_CENTRE_MM[0], SHEET_CENTRE_MM[1])
    assert theirs.area == pytest.approx(ours.area, rel=0.002)
    assert theirs.symmetric_difference(ours).area < 0.005 * ours.area


def test_kicads_check_is_awake(folder: Path, tmp_path: Path) -> None:
    """It finds in the original what our own check finds there."""
    told = ask(lay_out_board(LedBoardDesign.original()), (folder / "led_board.kicad_pro").read_text(), tmp_path).told
    assert told["violations"] > 0
    assert {"clearance", "hole_clearance", "copper_edge_clearance"} <= set(
        re.findall(r"^\[(\w+)\]", told["report"], re.M)
    )


@pytest.mark.parametrize("size", [(34.0, 26.0), (64.0, 48.0)])
def test_kicad_finds_no_violation_in_larger_boards(size: tuple[float, float], folder: Path, tmp_path: Path) -> None:
    told = ask(
        lay_out_board(LedBoardDesign.for_size(*size)), (folder / "led_board.kicad_pro").read_text(), tmp_path
    ).told
    assert (told["violations"], told["unconnected"]) == (0, 0), told["report"]
