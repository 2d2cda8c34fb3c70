"""How long `import ninedtact` and `ninedtact --help` take in a fresh process (best of five), and that they load nothing heavy.

And the processor time of whole commands on real images: `calibrate` of two sensors and `estimate` of one image (median of three).
Modules are loaded compiled, as for a user; PYTHONDONTWRITEBYTECODE would add the compilation of 300 modules to each command.
"""

import os
import resource
import subprocess
import sys
import timeit
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import tyro
from figures import Figure, answer, at_most, holds
from real_images import PRESSES, sensor_folder

HEAVY = ("cv2", "scipy", "torch", "viser", "matplotlib")
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
COMMAND = Path(sys.executable).with_name("ninedtact")
IMPORT = [sys.executable, "-c", "import ninedtact"]
HELP = [str(COMMAND), "--help"]
NOTHING = [sys.executable, "-c", "pass"]
HELP_INSIDE = "import ninedtact.cli\ntry: ninedtact.cli.main(['--help'])\nexcept SystemExit: pass"


def start_up(tries: int = 5, quick: bool = False, json: bool = False) -> None:
    """Measure."""
    tries, sensors, times = (1, (), 1) if quick else (tries, ("sensor_a", "sensor_i"), 3)
    figures = [
        at_most("import ninedtact, s", best_seconds(IMPORT, tries), 0.5),
        at_most("ninedtact --help, s", best_seconds(HELP, tries), 1.0),
        Figure("Python alone, s", best_seconds(NOTHING, tries)),
        lightness("import ninedtact", "import ninedtact"),
        lightness("ninedtact --help", HELP_INSIDE),
    ]
    with TemporaryDirectory() as temporary:
        for name in sensors:
            figures += commands_on(sensor_folder(name), Path(temporary) / name, times)
    answer("Start", figures, json)


def commands_on(images: Path, sensor: Path, times: int) -> list[Figure]:
    """The processor time of calibrating a sensor and of estimating one image with it."""
    calibrate = [str(COMMAND), "calibrate", "--out", str(sensor)]
    for press in PRESSES:
        calibrate += [f"--{press.replace('_', '-')}", str(images / f"{press}.png")]
    estimate = [str(COMMAND), "estimate", "--sensor", str(sensor), "--reference", str(images / "ball_reference.png")]
    return [
        at_most(f"ninedtact calibrate, {images.name}, s of processor", processor_seconds(calibrate, times), 8.0),
        at_most(
            f"ninedtact estimate, {images.name}, s of processor",
            processor_seconds([*estimate, str(images / "ball.png")], times),
            1.2,
        ),
    ]


def processor_seconds(command: list[str], times: int) -> float:
    """The median of the user and system time of some fresh processes, after one that compiles what it loads."""
    found = []
    for _ in range(times + (times > 1)):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        found.append(after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime)
    return median(found[times > 1 :])


def best_seconds(command: list[str], tries: int) -> float:
    """The quickest of several fresh processes."""
    run = partial(subprocess.run, command, check=True, stdout=subprocess.DEVNULL)
    return min(timeit.repeat(run, number=1, repeat=tries))


def lightness(name: str, program: str) -> Figure:
    """Which of the heavy libraries a program has loaded at its end."""
    tell = f"{program}\nimport sys; print(*[name for name in {HEAVY} if name in sys.modules], file=sys.stderr)"
    loaded = subprocess.run([sys.executable, "-c", tell], check=True, capture_output=True, text=True).stderr.strip()
    return holds(f"{name} loads of {', '.join(HEAVY)}", loaded or "none", "none", not loaded)


if __name__ == "__main__":
    tyro.cli(start_up)
