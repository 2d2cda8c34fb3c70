"""A computer without a display: the units of systemd, and the commands of docs/headless.md without a terminal."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import pytest
from small_sensor import sensor_folder, skin

DOCS = Path(__file__).parents[3] / "docs"
UNITS = sorted((DOCS / "systemd").glob("*.service"))
COMMANDS = re.findall(r"^(COMMAND|RECORD_OPTIONS)=(.*)$", (DOCS / "headless.md").read_text("utf-8"), re.MULTILINE)
INSTALLED = "/opt/ninedtact/bin/ninedtact"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd-analyze here")
def test_systemd_accepts_the_units(tmp_path: Path) -> None:
    for unit in UNITS:
        text = unit.read_text("utf-8")
        assert text.count(INSTALLED) == 1
        program = tmp_path / "ninedtact"
        program.write_text("#!/bin/sh\n")
        program.chmod(0o755)
        named = tmp_path / unit.name.replace("@", "@finger")
        named.write_text(text.replace(INSTALLED, str(program)))
        checked = subprocess.run(
            ["systemd-analyze", "verify", "--man=no", str(named)], capture_output=True, text=True, timeout=60
        )
        assert (checked.returncode, checked.stderr) == (0, ""), unit.name


@pytest.mark.parametrize(("kind", "words"), COMMANDS, ids=[words.split()[0] for _, words in COMMANDS])
def test_a_command_of_the_page_needs_neither_display_nor_terminal(kind: str, words: str, tmp_path: Path) -> None:
    if words.startswith("ros2"):
        pytest.importorskip("cyclonedds", reason="the extra 'ros2' is not installed")
    folder, images = sensor_folder(tmp_path / "finger_sensor"), tmp_path / "images"
    images.mkdir()
    for number in range(15):
        cv2.imwrite(str(images / f"{number:02}.png"), skin(100))
    words = words.replace("/etc/ninedtact/finger_sensor", str(folder)).replace("usb:1-2", str(images))
    words = words.replace("--interface eth0", "--interface lo --domain 102").replace("physics", "none")
    words = words.replace("/var/lib/ninedtact", str(tmp_path)) + " --force none" * words.startswith("ros2")
    if kind == "RECORD_OPTIONS":
        words = f"record {words} --out {tmp_path}/finger.mcap"
    else:
        words += " --loop" + " --port 0 --tcp-port 0" * words.startswith("serve")
    bare = {name: os.environ[name] for name in ("PATH", "PYTHONPATH") if name in os.environ} | {"HOME": "/nonexistent"}
    running = subprocess.Popen(
        [sys.executable, "-m", "ninedtact", *words.split()],
        env=bare,
        cwd=tmp_path,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    assert running.stdout is not None
    first = running.stdout.readline()
    if kind == "COMMAND":
        time.sleep(0.5)
        running.send_signal(signal.SIGTERM)
    rest, _ = running.communicate(timeout=60)
    assert running.returncode == 0, first + rest
    expected = "finger.mcap: " if kind == "RECORD_OPTIONS" else "stopped after"
    assert expected in first + rest
