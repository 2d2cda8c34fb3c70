"""What the pages say about beginning without a sensor: the lines with `--source sim` run as they are printed."""

import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from ninedtact.cli import main
from test_docs import ROOT, command_lines

pytestmark = pytest.mark.interop
PAGES = ("ros2", "foxglove_rerun", "streaming", "lerobot", "live_page", "twin", "calibrating", "recording", "headless")
SERVERS = ("live", "ros2", "foxglove", "serve")
PATIENCE_S = 180.0
RUNS_S = 3.0
"""How long a server runs after it has said where it is."""


def simulated_lines(page: str) -> list[list[str]]:
    lines = command_lines((ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8"))
    return [words[1:] for words in lines if words[0] == "ninedtact" and any(word.endswith("sim") for word in words)]


LINES = [
    pytest.param(words, id=" ".join(words))
    for page in PAGES
    for words in simulated_lines(page)
    if "--page" not in words  # which needs a browser, and is tested with one
]


@pytest.fixture(scope="session")
def simulated_sensor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("simulated") / "my_sensor"
    assert main(["calibrate", "--source", "sim", "--out", str(folder)]) == 0
    assert not folder.with_name("my_sensor_images").exists()  # where images are kept if something fails
    return folder


@pytest.mark.parametrize("words", LINES)
def test_a_line_without_a_sensor_works_as_it_is_printed(
    words: list[str], tmp_path: Path, simulated_sensor: Path
) -> None:
    for name in ("my_sensor", "finger_1", "finger_2"):
        if words[0] != "calibrate":
            shutil.copytree(simulated_sensor, tmp_path / name)
    free_port = ["--port", "0"] if words[0] in SERVERS and words[0] != "ros2" else []
    command = [sys.executable, "-m", "ninedtact", *words, *free_port]
    with (tmp_path / "said").open("w+") as said:
        program = subprocess.Popen(command, cwd=tmp_path, stdout=said, stderr=subprocess.STDOUT)
        try:
            if words[0] in SERVERS:
                give_up_at = time.monotonic() + PATIENCE_S
                while "Ctrl-C" not in (tmp_path / "said").read_text():
                    assert program.poll() is None and time.monotonic() < give_up_at, (tmp_path / "said").read_text()
                    time.sleep(0.1)
                time.sleep(RUNS_S)
                assert program.poll() is None, (tmp_path / "said").read_text()
                program.send_signal(signal.SIGINT)
            code = program.wait(PATIENCE_S)
        finally:
            program.kill()
    assert code == 0, (tmp_path / "said").read_text()


def test_the_pages_of_the_doors_have_such_lines() -> None:
    assert {words.values[0][0] for words in LINES} >= {"calibrate", "record", *SERVERS}  # type: ignore[index]
