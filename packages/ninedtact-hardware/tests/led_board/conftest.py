from pathlib import Path

import pytest

pytest.importorskip("shapely", reason="expected the extra [hardware]; install it")

from ninedtact_hardware.led_board.board_parameters import LedBoardDesign
from ninedtact_hardware.led_board.complete_layout import BoardLayout, lay_out_board
from ninedtact_hardware.led_board.fabrication_files import write_checked_board_files


@pytest.fixture(scope="session")
def improved() -> BoardLayout:
    return lay_out_board(LedBoardDesign())


@pytest.fixture(scope="session")
def original() -> BoardLayout:
    return lay_out_board(LedBoardDesign.original())


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The improved board's files."""
    out = tmp_path_factory.mktemp("led_board")
    write_checked_board_files(LedBoardDesign(), out)
    return out
