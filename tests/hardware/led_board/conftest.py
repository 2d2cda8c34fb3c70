from pathlib import Path

import pytest

pytest.importorskip("shapely", reason="expected the extra [hardware]; install it")

from ninedtact.hardware.led_board.design import LedBoard
from ninedtact.hardware.led_board.export import write_led_board
from ninedtact.hardware.led_board.layout import Layout, lay_out


@pytest.fixture(scope="session")
def improved() -> Layout:
    return lay_out(LedBoard())


@pytest.fixture(scope="session")
def original() -> Layout:
    return lay_out(LedBoard.original())


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The improved board's files."""
    out = tmp_path_factory.mktemp("led_board")
    write_led_board(LedBoard(), out)
    return out
