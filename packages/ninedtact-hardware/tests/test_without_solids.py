"""Where build123d is not installed: one sentence, whichever command is run."""

import subprocess
import sys
from pathlib import Path

import pytest

from ninedtact._version import installation_command

WITHOUT = """
import sys
sys.modules["build123d"] = None
from ninedtact.cli import main
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize("command", ["check", "bom", "explore", "export --out parts", "guide --out guide"])
def test_the_extra_is_named(command: str, tmp_path: Path) -> None:
    run = [sys.executable, "-c", WITHOUT, "hardware", *command.split()]
    done = subprocess.run(run, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1
    assert installation_command("hardware") in done.stderr and "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())
