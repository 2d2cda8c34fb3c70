"""ninedtact live from its first line to Ctrl-C."""

import re
import signal
import subprocess
import sys
from pathlib import Path
from subprocess import PIPE
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
from small_sensor import image_folder, sensor_folder

from ninedtact.calibration.sensor_folder import SensorFolderDamaged
from ninedtact.cli import parse_arguments
from ninedtact.cli.live import LiveCommand
from ninedtact.cli.shared_options import PageAddressOptions
from ninedtact.errors import InputError

CHECK = "import ninedtact.cli.live, sys; print(*[m for m in ('cv2', 'numpy', 'viser') if m in sys.modules])"


@pytest.fixture
def images(tmp_path: Path) -> Path:
    return image_folder(tmp_path / "images", 100, 100, 100)


def test_on_a_network_the_printed_address_is_the_only_one(tmp_path: Path, images: Path) -> None:
    options = ["--sensor", str(sensor_folder(tmp_path / "small")), "--source", str(images), "--loop", "--port", "0"]
    command = [sys.executable, "-m", "ninedtact", "live", *options]
    command += ["--host", "0.0.0.0", "--allow-origin", "http://robot:9"]
    live = subprocess.Popen(command, stdout=PIPE, stderr=PIPE, text=True)
    assert live.stdout is not None
    address = re.search(r"open http://([^/]+):(\d+)(/[\w-]{22}/) in a browser", live.stdout.readline())
    assert address is not None
    _, port, secret = address.groups()
    for host in (f"127.0.0.1:{port}", "robot:9"):
        with urlopen(Request(f"http://127.0.0.1:{port}{secret}", headers={"Host": host}), timeout=60) as page:
            assert page.status == 200 and b"<html" in page.read()
    with pytest.raises(HTTPError, match="404"):
        urlopen(f"http://127.0.0.1:{port}/", timeout=60)
    live.send_signal(signal.SIGINT)
    said, complained = live.communicate(timeout=60)
    assert re.fullmatch(r"stopped after \d+ images\n", said)
    assert live.returncode == 0 and re.fullmatch(
        r"refused 127\.0\.0\.1:\d+: expected the whole address .*\n", complained
    )


def test_nothing_heavy_is_loaded_before_it_runs() -> None:
    loaded = subprocess.run([sys.executable, "-c", CHECK], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == ""


def test_bad_options_are_refused_before_any_camera_is_touched(tmp_path: Path, images: Path) -> None:
    folder = sensor_folder(tmp_path / "small")
    with pytest.raises(SensorFolderDamaged, match="expected a sensor folder"):
        LiveCommand((str(images),), (str(tmp_path / "none"),)).run()
    with pytest.raises(InputError, match="which is none of these"):
        LiveCommand(("nothing",), (str(folder),)).run()
    with pytest.raises(InputError, match="expected --display-hz above 0 and of at most 120, got 0;"):
        parse_arguments(["live", "--source", str(images), "--sensor", str(folder), "--display-hz", "0"])
    with pytest.raises(InputError, match="got 'robot';"):
        LiveCommand((str(images),), (str(folder),), address=PageAddressOptions(allow_origin=("robot",))).run()
