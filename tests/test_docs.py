"""Pages of the documentation follow the code: the Python API, every command on them, and the site that is built of them."""

import json
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
from PIL import Image

import ninedtact
from ninedtact.calibration.guidance import guided_capture_steps
from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.cli import parse_arguments
from ninedtact.design import SensorDesign

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "scripts"))
DOCUMENTED = import_module("expand_api_reference").documented_names(
    (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
)


@pytest.mark.parametrize("dotted", DOCUMENTED)
def test_a_documented_name_exists_where_the_page_says(dotted: str) -> None:
    module, _, name = dotted.rpartition(".")
    documented = import_module(dotted) if dotted == "ninedtact.errors" else getattr(import_module(module), name)
    assert documented.__doc__


def test_the_page_documents_every_public_function_and_class() -> None:
    names = {name for name in ninedtact.__all__ if callable(getattr(ninedtact, name))}
    errors = set(vars(import_module("ninedtact.errors")))  # the page shows this module whole
    assert names - errors - {dotted.rpartition(".")[2] for dotted in DOCUMENTED} == set()


def test_the_reference_of_commands_is_what_the_commands_print(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "110")
    monkeypatch.setenv("NO_COLOR", "1")
    sys.modules.pop("write_command_reference", None)
    page = import_module("write_command_reference").command_reference()
    assert page == (ROOT / "docs" / "commands.md").read_text(encoding="utf-8"), "run scripts/write_command_reference.py"


def test_the_guided_calibration_on_its_page_is_that_of_the_program() -> None:
    page = (ROOT / "docs" / "calibrating.md").read_text(encoding="utf-8")
    for step in guided_capture_steps(SensorDesign(), CalibrationSettings()):
        assert f"\n    {step.instruction}\n" in page


PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]


def command_lines(text: str) -> Iterator[list[str]]:
    """The words of every command line in the code of a page, indented or fenced as a shell's, without comments."""
    shell, rest = [], re.sub(r"\\\n\s*", " ", text)
    for fence in re.findall(r"^[ \t]*```.*?^[ \t]*```", rest, re.DOTALL | re.MULTILINE):
        shell += fence.splitlines()[1:] if re.match(r"\s*```(bash|sh|console)\b", fence) else []
        rest = rest.replace(fence, "")
    for line in [*shell, *re.findall(r"^(?: {4}|\t).*$", rest, re.MULTILINE)]:
        try:
            words = shlex.split(line, comments=True)
        except ValueError:  # code of another language
            continue
        if words and words[0].removeprefix(".venv/bin/") in CHECKS:
            ends = [place for place, word in enumerate(words) if word in ("&", "|", ">", ";", "&&")]
            yield [words[0].removeprefix(".venv/bin/"), *words[1 : min(ends, default=None)]]


def fault_of_ninedtact(arguments: list[str]) -> str:
    """Why the program refuses arguments; empty where it accepts them."""
    try:
        parse_arguments(arguments)
    except SystemExit as end:
        return "" if end.code == 0 else "the parser refuses it"
    return ""


def fault_of_make(targets: list[str]) -> str:
    """Which target of make does not exist."""
    phony = set(re.findall(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)[0].split())
    unknown = [name for name in targets if name not in phony and not (ROOT / f"{name}.py").exists()]
    return f"no target {unknown}" if unknown else ""


def fault_of_pip(arguments: list[str]) -> str:
    """Which extra does not exist."""
    extras = set()
    for project in ROOT.glob("packages/*/pyproject.toml"):
        extras |= set(tomllib.loads(project.read_text())["project"].get("optional-dependencies", ()))
    asked = {one for found in re.findall(r"\[([\w,-]+)\]", " ".join(arguments)) for one in found.split(",")}
    return f"no extra {sorted(asked - extras)}" if asked - extras else ""


def fault_of_python(arguments: list[str]) -> str:
    """Which script does not exist, or what the program refuses."""
    if arguments[:2] == ["-m", "ninedtact"]:
        return fault_of_ninedtact(arguments[2:])
    is_script = bool(arguments) and re.match(r"(examples|scripts|benchmarks)/", arguments[0]) is not None
    return f"no file {arguments[0]}" if is_script and not (ROOT / arguments[0]).exists() else ""


CHECKS = {
    "ninedtact": fault_of_ninedtact,
    "make": fault_of_make,
    "pip": fault_of_pip,
    "python": fault_of_python,
    "python3": fault_of_python,
}
"""Programs whose command lines are checked; `.venv/bin/` before them is ignored."""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_command_line_of_a_page_is_one_that_the_program_accepts(
    page: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = page.read_text(encoding="utf-8")
    faults = {" ".join(words): fault for words in command_lines(text) if (fault := CHECKS[words[0]](words[1:]))}
    assert faults == {}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_and_options_that_a_page_mentions_exist(page: Path) -> None:
    reference = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8").split("\n## ")
    for mentioned in re.findall(r"`ninedtact ([a-z][^`]*)`", page.read_text(encoding="utf-8")):
        command, *words = mentioned.split()
        sections = [section for section in reference if re.match(rf"ninedtact {command}\b", section)]
        assert sections, f"`ninedtact {mentioned}`: no such command"
        for option in (word.partition("=")[0].replace("--no-", "--") for word in words if re.match(r"--\w", word)):
            assert re.search(rf"{option}\b", "".join(sections).replace("--no-", "--")), (
                f"`ninedtact {mentioned}`: {option}"
            )


def test_command_lines_are_found_and_faults_seen() -> None:
    page = "```bash\nninedtact live --sorce 0 # watch\n```\n\n    .venv/bin/pip install 'x[studio,nothing]' && ls\n"
    page += "    make \\\n      demos\n"
    assert [CHECKS[words[0]](words[1:]) for words in command_lines(page)] == [
        "the parser refuses it",
        "no extra ['nothing']",
        "no target ['demos']",
    ]
    assert sum(len(list(command_lines(one.read_text(encoding="utf-8")))) for one in PAGES) > 100


def test_captions_say_what_the_pictures_show() -> None:
    from draw_gallery import CAPTIONED, IMAGES, caption, caption_of_page

    for picture in CAPTIONED:
        figures = json.loads(Image.open(IMAGES / picture).info["figures"])
        assert caption_of_page(picture)[1] == caption(picture, figures), "run make gallery"


def test_a_site_that_loads_from_elsewhere_or_links_to_nothing_is_refused(tmp_path: Path) -> None:
    from check_site import find_faults

    (tmp_path / "a.html").write_text('<h1 id="top"><a href="b.html#end"><a href="https://x.org"><img src="b.html">')
    (tmp_path / "b.html").write_text('<p id="end"><a href="a.html#top"><a href="#end">')
    assert find_faults(tmp_path) == []
    (tmp_path / "c.html").write_text('<script src="https://x.org/a.js"></script><a href="a.html#no"><a href="d.html">')
    (tmp_path / "style.css").write_text("@import 'https://x.org/font.css';")
    assert [fault.split(" ", 1)[1] for fault in find_faults(tmp_path)] == [
        "loads https://x.org/font.css",
        "links to a.html#no, a place that does not exist",
        "links to d.html, which does not exist",
        "loads https://x.org/a.js",
    ]


def python_blocks(page: str) -> list[str]:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


EXAMPLES = [
    *python_blocks("api.md"),
    *(block for block in python_blocks("simulators.md") if re.search("my_sensor|torch", block)),
]
PREPARE = """
import cv2, pathlib
from ninedtact.cli import main
from ninedtact.simulation.calibration_images import simulate_calibration_images
pathlib.Path("my_images").mkdir()
for name, image in vars(simulate_calibration_images(ninedtact.default_twin())).items():
    cv2.imwrite(f"my_images/{name}.png", image)
assert main("simulate dataset --out pairs --pairs 8 --sensors 1 --objects 2 --pitch-mm 0.6 --workers 1".split()) == 0
"""


def test_the_examples_of_the_api_show_every_public_name_and_run(tmp_path: Path) -> None:
    shown = set(re.findall(r"ninedtact\.(\w+)", "".join(EXAMPLES)))
    assert set(ninedtact.__all__) - shown == {"__version__"}
    first, *examples = EXAMPLES
    calibrate = next(example for example in examples if "ninedtact.calibrate(" in example)
    rest = [example for example in examples if example != calibrate]
    script = "\n".join([first, PREPARE, calibrate, *rest]).replace("many, device = 1024", "many, device = 4")
    (tmp_path / "examples.py").write_text(script, encoding="utf-8")
    ran = subprocess.run([sys.executable, "examples.py"], cwd=tmp_path, capture_output=True, text=True, timeout=240)
    assert ran.returncode == 0, ran.stderr
    assert "all images are read" in ran.stdout and "expected a sensor folder" in ran.stdout
