"""Where the output of a command goes: a reader that has left, a full disk, a stream that is closed."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import ninedtact
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.cli import main
from ninedtact.cli.plain_text import spell_in_ascii

COMMANDS = (["--version"], ["simulate", "objects", "--json"])


def run_command(arguments: list[str], **outputs: int) -> subprocess.CompletedProcess[bytes]:
    """Run a command with Python's own buffering, as a user does."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    return subprocess.run([sys.executable, "-m", "ninedtact", *arguments], env=environment, check=False, **outputs)


@pytest.mark.parametrize("arguments", COMMANDS)
def test_a_reader_that_has_left_ends_a_command_without_a_word(arguments: list[str]) -> None:
    """As with `| head`: what was printed is still in the buffer when the reader is gone."""
    reader, writer = os.pipe()
    os.close(reader)
    ended = run_command(arguments, stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    assert (ended.returncode, ended.stderr) == (1, b"")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
@pytest.mark.parametrize("arguments", COMMANDS)
def test_output_that_a_full_disk_does_not_take_is_said(arguments: list[str]) -> None:
    full = os.open("/dev/full", os.O_WRONLY)
    ended = run_command(arguments, stdout=full, stderr=subprocess.PIPE)
    os.close(full)
    said = ended.stderr.decode().splitlines()
    assert ended.returncode == 1 and len(said) == 1
    assert "No space left on device; free the disk" in said[0]


@pytest.mark.parametrize("encoding", ["ascii", "cp437"])
def test_an_output_of_any_encoding_gets_a_readable_text(encoding: str, sensor_a: SensorFolder, tmp_path: Path) -> None:
    """That of a plain C locale, and the code page of a Windows terminal."""
    sensor = shutil.copytree(sensor_a.path, tmp_path / "fühler")
    environment = {**os.environ, "PYTHONIOENCODING": encoding, "COLUMNS": "100"}

    def printed(*arguments: str) -> str:
        command = [sys.executable, "-m", "ninedtact", *arguments]
        ended = subprocess.run(command, env=environment, check=True, capture_output=True)
        assert b"Traceback" not in ended.stderr
        return ended.stdout.decode(encoding)

    plan = printed("calibrate", "--plan", "--out", str(sensor))
    assert ("+/-" if encoding == "ascii" else "±") in plan and "\\" not in plan
    assert "* calibrate" in printed("--help") and "\\" not in printed("--help")
    image = str(sensor / "images" / "ball_reference.png")
    assert "fühler" in str(json.loads(printed("check", "--sensor", str(sensor), image, "--json")))


def test_every_character_that_the_sources_use_has_a_spelling() -> None:
    used = "".join(path.read_text("utf-8") for path in Path(ninedtact.__file__).parent.rglob("*.py"))
    spelled = {character: spell_in_ascii(character) for character in set(used) - {"\\"}}
    assert not [text for text in spelled.values() if not text.isascii() or "\\" in text]
    assert spell_in_ascii("2.1 ± 0.3 mm², σ ≤ 5 µm …") == "2.1 +/- 0.3 mm2, sigma <= 5 um ..."


def test_a_command_works_with_its_outputs_closed(sensor_a: SensorFolder, tmp_path: Path) -> None:
    """As a service manager may start it."""
    command = f"{sys.executable} -m ninedtact export-calibration --sensor {sensor_a.path}"
    ended = subprocess.run(f"{command} --out {tmp_path / 's'} >&- 2>&-", shell=True, check=False)
    assert ended.returncode == 0 and any((tmp_path / "s").iterdir())


@pytest.mark.parametrize(
    ("command", "refused"),
    [
        ("estimate no.mcap --out missing/wrenches.csv", "make the folder missing"),
        ("estimate no.mcap --out folder", "expected to write folder, got: Is a directory"),
        ("estimate no.mcap --out pipe", "got pipe, which is a device or a pipe; name a file"),
        ("estimate no.mcap --out file", "expected --out to be a new file, got file; choose another name"),
        ("track no.mcap --out file", "expected --out to be a new file, got file; choose another name"),
        ("compare one other --out file", "expected --out to be a new file, got file; choose another name"),
        ("dataset check no_data --report file", "expected --report to be a new file, got file; choose another name"),
        ("dataset check no_data --report missing/report.json", "make the folder missing"),
        ("evaluate --data no_data --out file", "File exists: 'file'"),
    ],
)
def test_a_place_that_cannot_be_written_is_refused_before_the_work(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    command: str,
    refused: str,
) -> None:
    """Not after hours of it. The inputs do not exist either, which would be said next."""
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    Path("folder").mkdir()
    os.mkfifo("pipe")
    assert main(command.split()) == 1
    assert refused in capsys.readouterr().err
    assert sorted(path.name for path in Path().iterdir()) == ["file", "folder", "pipe"]


def test_a_working_directory_that_is_gone_is_said_where_it_matters(sensor_a: SensorFolder, tmp_path: Path) -> None:
    """As after another terminal has removed it; a whole path does not need it."""
    program = f"{sys.executable} -m ninedtact export-calibration --sensor {sensor_a.path} --out"
    script = f"mkdir {tmp_path}/gone && cd {tmp_path}/gone && rmdir {tmp_path}/gone && {program}"
    ended = subprocess.run(f"{script} s", shell=True, check=False, capture_output=True, text=True)
    assert ended.returncode == 1 and "got one that has been deleted; change to another folder" in ended.stderr
    ended = subprocess.run(f"{script} {tmp_path}/s", shell=True, check=False, capture_output=True, text=True)
    assert ended.returncode == 0 and any((tmp_path / "s").iterdir()), ended.stderr
