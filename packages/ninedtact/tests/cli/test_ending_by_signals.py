"""Ctrl-C and a closing terminal end a command."""

import os
import signal
import subprocess
import sys
import time

import pytest

from ninedtact.cli.result_and_interrupt import stop_on_signal


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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_after_the_last_word_changes_nothing(number: int) -> None:
    program = f"""import atexit, signal, sys
from ninedtact.__main__ import main
atexit.register(signal.raise_signal, {number:d})
sys.argv = ["ninedtact", "--version"]
sys.exit(main())"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.returncode, ended.stderr) == (0, "") and ended.stdout.startswith("ninedtact ")
