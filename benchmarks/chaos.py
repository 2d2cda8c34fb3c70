"""Commands that are interrupted, killed, or run out of disk, at random moments: what do they leave behind?

    signals      SIGINT, SIGTERM or SIGKILL at a random moment of calibrate, record, collect, simulate dataset, hardware export and
                 train
    full disk    the same commands, and export, on a file system that is too small (a tmpfs, which needs permission to mount one)
    two writers  two commands that write to the same place at the same time
    clock set    the wall clock jumps by an hour while live, record or collect runs (`chaos_of_time`)
    stall        the network camera of live or record falls silent, for a while or for ever (`chaos_of_time`)

A case is answered well where the command ends within `END_S`, prints no traceback, and leaves at the path that it was told to write
nothing, a result that is whole, or one that running the command again completes. Run it with `make chaos`.
"""

import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import tyro
from chaos_of_time import (
    HOUR_S,
    PASSING_STALLS,
    STALLS,
    TOLD_S,
    StallingCamera,
    answers,
    clock_step_environment,
    complaint_about_page,
    complaint_about_stamps,
    free_port,
)

from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.design import SensorDesign
from ninedtact.recording.reader import Recording
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact.simulation.twin import twin_from_design
from ninedtact_train.dataset.reader import load_dataset

NINEDTACT = (sys.executable, "-m", "ninedtact")
END_S = 20.0
"""Time within which a command must end after SIGINT or SIGTERM, or by itself after its disk is full."""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
DISK_KB = (60, 300, 900)


@dataclass(frozen=True)
class Command:
    """A command that writes something, and how to tell whether that is whole."""

    name: str
    arguments: tuple[str, ...]
    result: str
    """Name of what it writes, in the folder that is tried."""
    seconds: float
    """About how long it takes, the range of the moments at which it is stopped."""
    is_whole: Callable[[Path], bool]
    """Whether a result can be read; it is not asked where there is none."""
    resumes: bool = False
    """Whether a part of the result may be there, which the same command completes."""
    troubles: tuple[str, ...] = ("signals", "full disk", "two writers")
    url: str = ""
    """Address of the page that the command serves until it is interrupted."""

    def line(self, folder: Path) -> tuple[str, ...]:
        """Return the command line that writes into a folder."""
        return (*NINEDTACT, *self.arguments, "--out", str(folder / self.result))


def chaos(cases: int = 8, seed: int = 0, only: tuple[str, ...] = (), troubles: tuple[str, ...] = ()) -> None:
    """Print how many cases were tried and how many were answered well, and every one that was not.

    cases: number for each command and kind of trouble. only, troubles: names of the commands and kinds that are tried.
    """
    tried = {
        "signals": try_signal,
        "full disk": try_full_disk,
        "two writers": try_two_writers,
        "clock set": try_clock_step,
        "stall": try_stall,
    }
    chance = random.Random(seed)
    with TemporaryDirectory(prefix="chaos_") as name:
        commands = [command for command in make_commands(Path(name)) if not only or command.name in only]
        require_undisturbed_success(commands, Path(name))
        print(f"{'command':18s} {'trouble':12s} tried  well")
        bad = [
            complaint
            for command in commands
            for trouble in command.troubles
            if not troubles or trouble in troubles
            for complaint in table_row(command, trouble, tried[trouble], cases, chance)
        ]
    print("\n".join(["", *bad] if bad else ["", "none was answered badly"]))
    sys.exit(bool(bad))


def make_commands(folder: Path) -> list[Command]:
    """Make the sensor and the data set that commands need, and return the commands."""
    images, sensor, data = folder / "images", folder / "sensor", folder / "data"
    images.mkdir()
    design = SensorDesign()
    for name, image in vars(simulate_calibration_images(twin_from_design(design), design)).items():
        cv2.imwrite(str(images / f"{name}.png"), image)
    run_whole("calibrate", "--images", str(images), "--out", str(sensor))
    run_whole("simulate", "dataset", "--out", str(data), *small_data(40))
    record = ("record", "--source", "sim", "--sensor", str(sensor), "--force-torque", "sim", "--seconds", "4")
    collect = ("collect", *record[1:-1], "6", "--seed", "1")
    train = (
        "train",
        "--data",
        str(data),
        "--channels",
        "deformation",
        "--size",
        "40",
        "32",
        "--epochs",
        "3",
        "--held-out",
        "standard",
    )
    live = ("live", "--sensor", str(sensor), "--port", str(port := free_port()))
    reference = ("--reference", str(images / "ball_reference.png"))
    from_stream = ("record", "--sensor", str(sensor), "--seconds", "20")
    page = f"http://127.0.0.1:{port}/"
    both = ("signals", "full disk", "two writers", "clock set")
    recorded = folder / "recorded.mcap"
    run_whole(*record[:-1], "1", "--out", str(recorded))
    exports = [
        Command(
            " ".join(("export", *to)), ("export", str(recorded), *to), result, 10, is_whole, troubles=("full disk",)
        )
        for to, result, is_whole in (
            ((), "press", is_export),
            (("--to", "lerobot"), "episodes", is_lerobot_data),
            (("--to", "rerun"), "press.rrd", is_rerun_file),
        )
        if "rerun" not in to or find_spec("rerun")
    ]
    return [
        Command("calibrate", ("calibrate", "--images", str(images), "--method", "ratio"), "sensor", 6, is_sensor),
        Command("record", record, "press.mcap", 8, is_recording, troubles=both),
        Command("record stream", from_stream, "press.mcap", 8, is_recording, troubles=("stall",)),
        Command("collect", collect, "pairs.mcap", 10, is_recording, troubles=both),
        Command("live", (*live, "--source", "sim"), "readings", 8, is_folder, troubles=("clock set",), url=page),
        Command("live stream", (*live, *reference), "readings", 8, is_folder, troubles=("stall",), url=page),
        Command("simulate dataset", ("simulate", "dataset", *small_data(60)), "data", 15, is_dataset, resumes=True),
        Command("hardware export", ("hardware", "export"), "hardware", 30, is_hardware),
        Command("train", train, "model", 20, is_model, resumes=True),
        *exports,
    ]


def require_undisturbed_success(commands: list[Command], folder: Path) -> None:
    """Run every command once without trouble: what fails by itself proves nothing."""
    (folder / "undisturbed").mkdir()
    for command in commands:
        if "full disk" not in command.troubles:  # it ends by its trouble alone
            continue
        subprocess.run(command.line(folder / "undisturbed"), check=True, capture_output=True)
        if not command.is_whole(folder / "undisturbed" / command.result):
            raise SystemExit(f"expected a whole result of an undisturbed '{command.name}', got an unfinished one")


def small_data(pairs: int) -> tuple[str, ...]:
    """Return the options of a small data set."""
    return (
        "--pairs",
        str(pairs),
        "--sensors",
        "2",
        "--objects",
        "4",
        "--size",
        "92",
        "69",
        "--workers",
        "1",
        "--pitch-mm",
        "0.4",
    )


def run_whole(*arguments: str) -> None:
    """Run a command that must succeed."""
    subprocess.run((*NINEDTACT, *arguments), check=True, capture_output=True)


def is_sensor(path: Path) -> bool:
    return bool(load_sensor(path).id)


def is_recording(path: Path) -> bool:
    with Recording(path) as recording:
        return sum(1 for _ in recording.frames()) >= 0


def is_folder(path: Path) -> bool:
    return path.is_dir()


def is_export(path: Path) -> bool:
    return (path / "recording.json").is_file() and any(path.glob("images/*.png"))


def is_lerobot_data(path: Path) -> bool:
    return (path / "meta/info.json").is_file()


def is_rerun_file(path: Path) -> bool:
    return b"RRF2FOOT" in path.read_bytes()[-100:]


def is_dataset(path: Path) -> bool:
    return len(load_dataset(path)) > 0


def is_hardware(path: Path) -> bool:
    return (path / "manifest.json").is_file()


def is_model(path: Path) -> bool:
    return any(path.glob("*.onnx"))


def table_row(
    command: Command,
    trouble: str,
    attempt: Callable[[Command, Path, random.Random, int], str | None],
    cases: int,
    chance: random.Random,
) -> list[str]:
    """Try one kind of trouble with one command, print the row, and return what was answered badly."""
    complaints: list[str] = []
    for number in range(cases):
        with TemporaryDirectory(prefix="chaos_") as folder:
            complaint = attempt(command, Path(folder), chance, number)
        Path(f"{folder}.txt").unlink(missing_ok=True)
        if complaint == NOT_TRIED:
            print(f"{command.name:18s} {trouble:12s} not tried: no permission to mount a small file system")
            return []
        complaints += [f"{command.name}, {trouble}: {complaint}"] if complaint else []
    print(f"{command.name:18s} {trouble:12s} {cases:5d} {cases - len(complaints):5d}", flush=True)
    return complaints


NOT_TRIED = "not tried"


def try_signal(command: Command, folder: Path, chance: random.Random, number: int) -> str | None:
    """Stop a command at a random moment; return what was wrong with its end, or None."""
    sent = SIGNALS[number % len(SIGNALS)]
    with start(command, folder) as running:
        time.sleep(chance.uniform(0.05, 1.1 * command.seconds))
        running.send_signal(sent)
        complaint = complaint_about_end(running, folder)
    after = f"after {sent.name}"
    if complaint:
        return f"{complaint} {after}"
    left = complaint_about_result(command, folder)
    if left is None and command.resumes and (folder / command.result).exists():
        again = subprocess.run(command.line(folder), capture_output=True, text=True, check=False)
        left = None if again.returncode == 0 else f"did not go on: {again.stderr.strip()[-300:]}"
    return f"{left} {after}" if left else None


def try_full_disk(command: Command, folder: Path, chance: random.Random, number: int) -> str | None:
    """Run a command on a small file system; return what was wrong with its end, or None."""
    size_kb = DISK_KB[number % len(DISK_KB)]
    mounted = subprocess.run(
        ("mount", "-t", "tmpfs", "-o", f"size={size_kb}k", "tmpfs", str(folder)), capture_output=True, check=False
    )
    if mounted.returncode != 0:
        return NOT_TRIED
    try:
        with start(command, folder) as running:
            complaint = complaint_about_end(running, folder, command.seconds * 4 + END_S)
        return (
            complaint or complaint_about_result(command, folder)
        ) and f"{complaint or 'a damaged result'} on {size_kb} kB"
    finally:
        subprocess.run(("umount", str(folder)), check=True)


def try_two_writers(command: Command, folder: Path, chance: random.Random, number: int) -> str | None:
    """Run a command twice at the same time; return what was wrong with either end, or None."""
    with start(command, folder) as first:
        time.sleep(chance.uniform(0, 0.3 * command.seconds))
        with start(command, folder) as second:
            complaints = [complaint_about_end(one, folder, command.seconds * 8 + END_S) for one in (first, second)]
    if any(complaints):
        return str(next(filter(None, complaints)))
    if not (folder / command.result).exists():
        return "no result of either writer"
    return complaint_about_result(command, folder)


def try_clock_step(command: Command, folder: Path, chance: random.Random, number: int) -> str | None:
    """Set the clock of a command by an hour while it runs; return what was wrong, or None."""
    trigger = folder / "clock"
    patched = clock_step_environment(folder, (HOUR_S, -HOUR_S)[number % 2], trigger)
    with start(command, folder, environment=patched) as running:
        has_begun = (lambda: answers(command.url)) if command.url else (folder / command.result).exists
        while not has_begun() and running.poll() is None:
            time.sleep(0.05)
        time.sleep(chance.uniform(0.2, 2.5))
        trigger.touch()
        if command.url:
            time.sleep(2)
        complaint = complaint_about_page(running, command.url) if command.url else None
        complaint = complaint or complaint_about_end(running, folder, command.seconds * 4 + END_S)
    if complaint is None and not command.url:
        complaint = complaint_about_stamps(folder / command.result, said_by(folder))
    return complaint


def try_stall(command: Command, folder: Path, chance: random.Random, number: int) -> str | None:
    """Let the stream that a command reads stall; return what was wrong, or None."""
    image = cv2.imread(
        str(Path(command.arguments[command.arguments.index("--sensor") + 1], "images/ball_reference.png"))
    )
    camera = StallingCamera(image, STALLS[number % len(STALLS)], chance.uniform(3, 5))
    with camera.serve() as url, start(command, folder, ("--source", url)) as running:
        if not camera.stalled.wait(60):
            running.kill()
            return f"did not read the stream: {said_by(folder)[-300:]}"
        stalled_at = time.monotonic()
        while url not in said_by(folder) and time.monotonic() < stalled_at + TOLD_S:
            time.sleep(0.05)
        complaint = None if url in said_by(folder) else f"no word about the stall within {TOLD_S:g} s"
        if command.url:
            time.sleep(max(0.0, stalled_at + camera.length_s() + 4 - time.monotonic()))
            if "is back" not in said_by(folder) and camera.stall in PASSING_STALLS:
                complaint = complaint or "no word about the end of the stall"
            answered = complaint_about_page(running, command.url)
            complaint = complaint or answered
        complaint = complaint or complaint_about_end(running, folder)
    complaint = complaint or complaint_about_result(command, folder)
    return f"{complaint}, stall: {camera.stall}" if complaint else None


def start(
    command: Command, folder: Path, more: tuple[str, ...] = (), environment: Mapping[str, str] | None = None
) -> "subprocess.Popen[str]":
    """Start a command in a session of its own, so that its workers are seen to end with it."""
    with Path(f"{folder}.txt").open("a") as said:
        return subprocess.Popen(
            (*command.line(folder), *more),
            stdout=subprocess.DEVNULL,
            stderr=said,
            text=True,
            cwd=folder.parent,
            env=environment,
            start_new_session=True,
        )


def said_by(folder: Path) -> str:
    """Return what the commands that write to a folder have printed on standard error; the file lies beside the folder."""
    return Path(f"{folder}.txt").read_text(errors="replace")


def complaint_about_end(running: "subprocess.Popen[str]", folder: Path, limit_s: float = END_S) -> str | None:
    """Wait for the end; return a complaint about a command that hangs or prints a traceback."""
    try:
        running.wait(timeout=limit_s)
    except subprocess.TimeoutExpired:
        with suppress(ProcessLookupError):
            running.kill()
        running.wait()
        return f"did not end within {limit_s:.0f} s"
    said = said_by(folder)
    return f"traceback: {said.strip().splitlines()[-1]}" if "Traceback (most recent call last)" in said else None


def complaint_about_result(command: Command, folder: Path) -> str | None:
    """Return a complaint about a result that is neither absent nor whole; one that can be completed may be unfinished."""
    result = folder / command.result
    if not result.exists() or command.resumes:
        return None
    try:
        return None if command.is_whole(result) else "an unfinished result"
    except Exception as trouble:
        return f"a result that cannot be read ({trouble})"


if __name__ == "__main__":
    tyro.cli(chaos)
