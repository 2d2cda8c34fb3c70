"""How long `import ninedtact` and `ninedtact --help` take in a fresh process (best of five), and that they load nothing heavy."""

import subprocess
import sys
import time
from pathlib import Path

import tyro
from figures import Figure, answer, at_most, holds

HEAVY = ("cv2", "scipy", "torch", "viser", "matplotlib")
COMMAND = Path(sys.executable).with_name("ninedtact")
IMPORT = [sys.executable, "-c", "import ninedtact"]
HELP = [str(COMMAND), "--help"]
NOTHING = [sys.executable, "-c", "pass"]
HELP_INSIDE = "import ninedtact.cli\ntry: ninedtact.cli.main(['--help'])\nexcept SystemExit: pass"


def start_up(tries: int = 5, json: bool = False) -> None:
    """Measure."""
    figures = [
        at_most("import ninedtact, s", best_seconds(IMPORT, tries), 0.5),
        at_most("ninedtact --help, s", best_seconds(HELP, tries), 1.0),
        Figure("Python alone, s", best_seconds(NOTHING, tries)),
        lightness("import ninedtact", "import ninedtact"),
        lightness("ninedtact --help", HELP_INSIDE),
    ]
    answer("Start", figures, json)


def best_seconds(command: list[str], tries: int) -> float:
    """The quickest of several fresh processes."""
    return min(seconds(command) for _ in range(tries))


def seconds(command: list[str]) -> float:
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def lightness(name: str, program: str) -> Figure:
    """Which of the heavy libraries a program has loaded at its end."""
    tell = f"{program}\nimport sys; print(*[name for name in {HEAVY} if name in sys.modules], file=sys.stderr)"
    loaded = subprocess.run([sys.executable, "-c", tell], check=True, capture_output=True, text=True).stderr.strip()
    return holds(f"{name} loads of {', '.join(HEAVY)}", loaded or "none", "none", not loaded)


if __name__ == "__main__":
    tyro.cli(start_up)
