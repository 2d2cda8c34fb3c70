"""Ctrl-C and a closing terminal end a command, and all commands that run together."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from ninedtact.cli.result_and_interrupt import stop_on_signal
from ninedtact.cli.ros2_foxglove_and_serve import run_commands_together


def test_ctrl_c_asks_once_and_insists_twice() -> None:
    with stop_on_signal() as until:
        assert not until.now
        os.kill(os.getpid(), 2)
        assert until.now
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), 2)
            time.sleep(1)
    with stop_on_signal(seconds=0.01) as until:
        time.sleep(0.02)
        assert until.now and until.requested is False


def test_a_closing_terminal_asks_for_the_end_as_often_as_it_likes_unless_it_is_ignored() -> None:
    before = signal.getsignal(signal.SIGHUP)
    try:
        for ignored in (False, True):
            signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL)
            with stop_on_signal() as until:
                for _ in range(2):
                    signal.raise_signal(signal.SIGHUP)
                assert until.requested is not ignored
    finally:
        signal.signal(signal.SIGHUP, before)


SLEEPER = "import sys, time; open(sys.argv[1], 'w').close(); time.sleep(600)"
TOGETHER = """
import sys
from ninedtact.cli.ros2_foxglove_and_serve import run_commands_together
from ninedtact.cli.result_and_interrupt import stop_on_signal
with stop_on_signal() as until:
    run_commands_together({path: [sys.executable, "-c", sys.argv[1], path] for path in sys.argv[2:]}, lambda: until.requested)
"""


def running_with(files: list[Path]) -> list[int]:
    """Return the processes that were started with one of these files."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):  # it has ended
            words = (process / "cmdline").read_text(errors="replace").split("\0")
            found += [int(process.name)] if set(words) & {str(file) for file in files} else []
    return found


def wait_for_sleepers(files: list[Path]) -> None:
    give_up_at = time.monotonic() + 60
    while not all(file.exists() for file in files):
        assert time.monotonic() < give_up_at
        time.sleep(0.02)


@pytest.fixture
def sleepers(tmp_path: Path) -> Iterator[list[Path]]:
    """The files that processes create before they sleep; no such process outlives the test."""
    files = [tmp_path / "left", tmp_path / "right"]
    yield files
    for number in running_with(files):
        os.kill(number, signal.SIGKILL)


def heed_hangup() -> None:
    """Undo that what runs under nohup ignores the end of its terminal."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def test_no_process_of_several_runs_on_when_the_terminal_closes(sleepers: list[Path]) -> None:
    command = [sys.executable, "-c", TOGETHER, SLEEPER, *map(str, sleepers)]
    with subprocess.Popen(command, preexec_fn=heed_hangup) as parent:
        wait_for_sleepers(sleepers)
        parent.send_signal(signal.SIGHUP)
        assert parent.wait(60) == 0
    assert running_with(sleepers) == []


@pytest.mark.parametrize("what", ["an error", "a program that is not there"])
def test_no_process_of_several_runs_on_after_an_error(what: str, sleepers: list[Path], tmp_path: Path) -> None:
    commands = {file.name: [sys.executable, "-c", SLEEPER, str(file)] for file in sleepers}

    def raise_error() -> bool:
        wait_for_sleepers(sleepers)
        raise KeyboardInterrupt

    if what == "an error":
        with pytest.raises(KeyboardInterrupt):
            run_commands_together(commands, raise_error)
    else:
        with pytest.raises(FileNotFoundError):
            run_commands_together(commands | {"third": [str(tmp_path / "missing")]}, raise_error)
    assert running_with(sleepers) == []
