"""Where build123d is not installed: one sentence, whichever command is run."""

import subprocess
import sys
from pathlib import Path

from ninedtact._version import installation_command

WITHOUT = """
import sys
sys.modules["build123d"] = None
from ninedtact.cli import main
for command in ("check", "bom", "explore", "export --out parts", "guide --out guide"):
    assert main(["hardware", *command.split()]) == 1
"""


def test_the_extra_is_named(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stderr.count(installation_command("hardware")) == 5 == done.stderr.count("\n")
    assert not list(tmp_path.iterdir())
