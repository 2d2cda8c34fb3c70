"""Commands that are stopped, run out of disk, share a place, or have their clock set or their camera stalled: what do they leave?

    signals      SIGINT, SIGTERM or SIGKILL at a random moment
    full disk    a file system that is too small (a tmpfs, which needs permission to mount one)
    two writers  two commands that write to the same place at the same time
    clock set    the wall clock jumps by an hour at a random moment (a `sitecustomize` of the child shifts `time.time`)
    stall        a network camera sends nothing for 3 s, for 30 s or for ever, a few bytes a second, or half an image

A case is handled well where the command ends in time, prints no traceback, and leaves nothing, a whole result, or one that the same
command completes; a stall and a step of the clock must be reported. Run it with `make chaos`; docs/reliability.md has its table.
"""

import os
import random
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import tyro

sys.path.append(str(Path(__file__).parents[1] / "packages/ninedtact/tests/capture"))
from mjpeg_camera import StallingCamera

import ninedtact
from ninedtact.simulation.calibration_images import simulate_calibration_images

END_S, TOLD_S, HOUR_S = 20.0, 5.0, 3600.0
"""Time within which a command must end after a signal, and report a stall; the step of the clock."""
DISK_KB = (60, 300, 900)
STALLS = {"3 s": 3.0, "30 s": 30.0, "for ever": np.inf, "trickle": np.inf, "half an image": np.inf}
SITE = """import os, time
t, n = time.time, time.time_ns
s = lambda: {step} if os.path.exists({trigger!r}) else 0
time.time, time.time_ns = lambda: t() + s(), lambda: n() + int(s() * 10**9)
"""
WRITERS = ("signals", "full disk", "two writers")
RECORD, DATA = (
    "--sensor {sensor} --source sim --force-torque sim",
    "--sensors 2 --objects 4 --size 92 69 --pitch-mm 0.4",
)
LIVE, TRAIN = "live --sensor {sensor} --port {port} --source", "--channels deformation --size 40 32 --epochs 3"


@dataclass(frozen=True)
class Command:
    """A command that writes something; {…} in it is the whole result of an earlier one."""

    name: str
    arguments: str
    result: str
    seconds: float
    """About how long it takes, the range of the moments at which it is stopped."""
    troubles: tuple[str, ...] = WRITERS
    resumes: bool = False
    """Whether a part of the result may be there, which the same command completes."""

    def start(self, folder: Path, inputs: dict[str, str], **environment: str) -> "subprocess.Popen[bytes]":
        """Write into a folder; what is printed is kept beside the folder, which may be a full disk."""
        words = [word.format(**inputs) for word in self.arguments.split()]
        line = [sys.executable, "-m", "ninedtact", *words, "--out", str(folder / self.result)]
        with Path(f"{folder}.txt").open("ab") as said:
            return subprocess.Popen(line, stdout=said, stderr=said, cwd=folder, env={**os.environ, **environment})


COMMANDS = (
    Command("sensor of the others", "calibrate --images {images}", "sensor", 15, ()),
    Command("calibrate", "calibrate --images {images} --method ratio", "calibrated", 6),
    Command("record", f"record {RECORD} --seconds 4", "press.mcap", 8, (*WRITERS, "clock set")),
    Command("record stream", "record --sensor {sensor} --seconds 20 --source {url}", "stream.mcap", 8, ("stall",)),
    Command("collect", f"collect {RECORD} --seconds 6 --seed 1", "pairs.mcap", 10, (*WRITERS, "clock set")),
    Command("live", f"{LIVE} sim", "readings", 8, ("clock set",)),
    Command("live stream", f"{LIVE} {{url}} --reference {{images}}/ball_reference.png", "readings", 8, ("stall",)),
    Command("simulate dataset", f"simulate dataset --pairs 60 {DATA}", "data", 15, resumes=True),
    Command("hardware export", "hardware export", "parts", 30),
    Command("train", f"train --data {{data}} {TRAIN} --held-out standard", "model", 20, resumes=True),
    Command("export", "export {press}", "files", 10, ("full disk",)),
    *[Command("export --to lerobot", "export {press} --to lerobot", "robot", 10, ("full disk",))][
        : bool(find_spec("lerobot_camera_ninedtact"))
    ],
    *[Command("export --to rerun", "export {press} --to rerun", "press.rrd", 10, ("full disk",))][
        : bool(find_spec("rerun"))
    ],
)


def is_whole(result: Path, example: Path) -> bool:
    """Return whether a result can be read, and holds all files that one made without trouble holds."""
    if result.suffix == ".mcap":
        with ninedtact.Recording(result) as recording:
            return sum(1 for _ in recording.frames()) >= 0
    if result.is_file():
        return b"RRF2FOOT" in result.read_bytes()[-100:]  # how a file of Rerun ends
    return {path.name for path in example.iterdir()} <= {path.name for path in result.iterdir()}


class BadCase(Exception):
    """What is wrong with a case."""


@dataclass
class Case:
    """One command in a folder of its own; each kind of trouble is a method."""

    command: Command
    folder: Path
    inputs: dict[str, str]
    chance: random.Random
    number: int

    def __post_init__(self) -> None:
        self.result, self.serves = self.folder / self.command.result, "{port}" in self.command.arguments

    def start(self, **environment: str) -> "subprocess.Popen[bytes]":
        return self.command.start(self.folder, self.inputs, **environment)

    def said(self) -> str:
        return Path(f"{self.folder}.txt").read_text(errors="replace")

    def require_end(self, running: "subprocess.Popen[bytes]", limit_s: float = END_S) -> None:
        try:
            running.wait(timeout=limit_s)
        except subprocess.TimeoutExpired:
            running.kill()
            raise BadCase(f"no end within {limit_s:.0f} s") from None
        if "Traceback (most recent call last)" in self.said():
            raise BadCase(f"traceback: {self.said().strip().splitlines()[-1]}")
        example = Path(self.inputs.get(self.result.stem, self.result))
        if self.result.exists() and not self.command.resumes and not is_whole(self.result, example):
            raise BadCase("an unfinished result")

    def page_answers(self) -> bool:
        with suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{self.inputs['port']}/", timeout=10) as page:
            return bool(page.status == 200)
        return False

    def end_page(self, running: "subprocess.Popen[bytes]") -> None:
        """Request the page, where the command serves one, and interrupt it."""
        answers = not self.serves or self.page_answers()
        if self.serves:
            running.send_signal(signal.SIGINT)
        if not answers:
            raise BadCase("a page that does not answer")

    def signals(self) -> None:
        running = self.start()
        time.sleep(self.chance.uniform(0.05, 1.1 * self.command.seconds))
        running.send_signal((signal.SIGINT, signal.SIGTERM, signal.SIGKILL)[self.number % 3])
        self.require_end(running)
        if self.command.resumes and self.result.exists() and self.start().wait() != 0:
            raise BadCase(f"did not go on: {self.said().strip()[-300:]}")

    def full_disk(self) -> None:
        size = f"size={DISK_KB[self.number % 3]}k"
        subprocess.run(("mount", "-t", "tmpfs", "-o", size, "tmpfs", str(self.folder)), check=True, capture_output=True)
        try:
            self.require_end(self.start(), self.command.seconds * 4 + END_S)
        finally:
            subprocess.run(("umount", str(self.folder)), check=True)

    def two_writers(self) -> None:
        first = self.start()
        time.sleep(self.chance.uniform(0, 0.3 * self.command.seconds))
        for running in (self.start(), first):
            self.require_end(running, self.command.seconds * 8 + END_S)
        if not self.result.exists():
            raise BadCase("no result of either writer")

    def clock_set(self) -> None:
        trigger, site = self.folder / "trigger", self.folder / "site"
        site.mkdir()
        (site / "sitecustomize.py").write_text(
            SITE.format(step=(HOUR_S, -HOUR_S)[self.number % 2], trigger=str(trigger))
        )
        running = self.start(PYTHONPATH=os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")]))
        while running.poll() is None and not (self.page_answers() if self.serves else self.result.exists()):
            time.sleep(0.05)
        time.sleep(self.chance.uniform(0.2, 2.5))
        trigger.touch()
        time.sleep(2 * self.serves)
        self.end_page(running)
        self.require_end(running, self.command.seconds * 4 + END_S)
        if self.serves:
            return
        with ninedtact.Recording(self.result) as recording:
            stamps = [frame.stamp_ns for frame in recording.frames()]
            told = any(event.subject == "clock" for event in recording.events())
        if len(stamps) < 2:
            raise BadCase(f"{len(stamps)} images, too few to tell: {self.said().strip()[-200:]}")
        if not (np.diff(stamps) > 0).all() or stamps[-1] - stamps[0] > 60e9:
            raise BadCase("stamps that do not rise, or follow the clock that was set")
        if not told or "clock of the computer moved" not in self.said():
            raise BadCase("a step of the clock that is not told")

    def stall(self) -> None:
        kind, length_s = list(STALLS.items())[self.number % len(STALLS)]
        jpeg = cv2.imencode(".jpg", cv2.imread(f"{self.inputs['images']}/ball_reference.png"))[1].tobytes()
        with StallingCamera(jpeg, kind, length_s) as camera:
            self.inputs = {**self.inputs, "url": camera.url}
            running = self.start()
            if not camera.stalled.wait(60):
                raise BadCase("did not read the stream")
            time.sleep(TOLD_S)
            told = camera.url in self.said()
            if self.serves and length_s < np.inf:
                time.sleep(length_s)
                told = told and "is back" in self.said()
            self.end_page(running)
            self.require_end(running, 3 * END_S)
        if not told:
            raise BadCase(f"no word about the stall, or about its end ({kind})")


def undisturbed(folder: Path, only: tuple[str, ...]) -> dict[str, str]:
    """Run every command once without trouble, and return the results by name: what fails by itself proves nothing."""
    images, whole = folder / "images", folder / "undisturbed"
    images.mkdir(), whole.mkdir()
    for name, image in vars(simulate_calibration_images(ninedtact.default_twin())).items():
        cv2.imwrite(str(images / f"{name}.png"), image)
    with socket.create_server(("127.0.0.1", 0)) as free:
        inputs = {"images": str(images), "port": str(free.getsockname()[1])}
    needed = set(only) or {command.name for command in COMMANDS}
    for command in (one for one in reversed(COMMANDS) if one.name in needed):
        needed |= {other.name for other in COMMANDS if f"{{{Path(other.result).stem}}}" in command.arguments}
    for command in (
        one for one in COMMANDS if one.name in needed and not {"{port}", "{url}"} & {*one.arguments.split()}
    ):
        result = whole / command.result
        if command.start(whole, inputs).wait() != 0 or not is_whole(result, result):
            sys.exit(f"expected a whole result of '{command.name}', got: {Path(f'{whole}.txt').read_text()}")
        inputs[result.stem] = str(result)
    return inputs


def bad_cases(command: Command, trouble: str, cases: int, folder: Path, inputs: dict[str, str], seed: int) -> list[str]:
    """Try one kind of trouble with one command, and return what was handled badly."""
    chance, found = random.Random(seed), []
    for number in range(cases):
        case = Case(command, folder / f"{command.name} {trouble} {number}".replace(" ", "_"), inputs, chance, number)
        case.folder.mkdir()
        try:
            getattr(case, trouble.replace(" ", "_"))()
        except Exception as complaint:
            found.append(f"{command.name}, {trouble}: {complaint}")
            print(found[-1], file=sys.stderr, flush=True)
    return found


def chaos(
    cases: int = 8, seed: int = 0, only: tuple[str, ...] = (), troubles: tuple[str, ...] = (), quick: bool = False
) -> None:
    """Print the table of docs/reliability.md. cases: of each command and trouble. only: commands that are tried."""
    cases, only, troubles = (1, ("calibrate",), ("signals",)) if quick else (cases, only, troubles)
    columns, bad = [one for one in (*WRITERS, "clock set", "stall") if not troubles or one in troubles], 0
    with TemporaryDirectory(prefix="chaos_") as name:
        inputs = undisturbed(Path(name), only)
        print(f"| command | {' | '.join(columns)} |\n|---{'|---' * len(columns)}|")
        for command in (one for one in COMMANDS if one.troubles and (not only or one.name in only)):
            cells = []
            for trouble in columns:
                tried = cases if trouble in command.troubles else 0
                failed = len(bad_cases(command, trouble, tried, Path(name), inputs, seed))
                cells, bad = [*cells, f"{tried - failed} of {tried}" if tried else ""], bad + failed
            print(f"| `{command.name}` | {' | '.join(cells)} |", flush=True)
    sys.exit(bool(bad))


if __name__ == "__main__":
    tyro.cli(chaos)
