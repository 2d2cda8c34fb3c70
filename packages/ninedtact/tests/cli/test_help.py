"""The help of every command reads as a person expects it: whole sentences, plain placeholders, no words of the code."""

import re
from collections.abc import Iterator
from types import UnionType
from typing import Any, Union, get_args, get_origin

import pytest

from ninedtact import __version__
from ninedtact.cli import COMMANDS, load_command, main, parse_arguments


def command_names() -> Iterator[tuple[str, ...]]:
    """The names of every command and of every group of commands."""
    for name in (name for name in COMMANDS if " " not in name):
        yield (name,)
        command, _ = load_command(name)
        for member in get_args(command) if get_origin(command) in (Union, UnionType) else ():
            yield (name, next(each.name for each in get_args(member)[1:] if hasattr(each, "name")))


NAMES = [(), *command_names()]


@pytest.fixture
def help_of(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Any:
    def shown(names: tuple[str, ...], columns: int) -> str:
        monkeypatch.setenv("COLUMNS", str(columns))
        with pytest.raises(SystemExit) as end:
            parse_arguments([*names, "--help"])
        assert end.value.code == 0
        return capsys.readouterr().out

    return shown


@pytest.mark.parametrize("names", NAMES, ids=" ".join)
def test_help_says_no_empty_defaults_and_no_words_of_the_code(names: tuple[str, ...], help_of: Any) -> None:
    words = " ".join(re.sub(r"[│╭╮╰╯─•]", " ", help_of(names, 100)).split())
    for unwanted in (
        "(default: )",
        "None",
        "MISSING",
        "(default: False)",
        "(default: True)",
        " STR ",
        "tyro",
        "dataclass",
        "tuple",
    ):
        assert unwanted not in words, unwanted
    assert not re.findall(r"`[a-z_]+\.[a-z_.]+`", words), "names of modules"


@pytest.mark.parametrize("names", NAMES, ids=" ".join)
def test_help_has_no_hard_breaks_inside_sentences(names: tuple[str, ...], help_of: Any) -> None:
    description = re.split(r"\n\W*(?:positional arguments|options|subcommands)\b", help_of(names, 2000))[0]
    for line in filter(None, map(str.strip, description.splitlines()[1:])):
        assert line[-1] in ".:?!)", line


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"ninedtact {__version__}\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["live", "--sensor", "a", "--source", "0", "--sensor", "b"],
            "expected --sensor once, got it 2 times; name several",
        ),
        (
            ["calibrate", "--out", "a", "--out=b", "--images", "c"],
            "expected --out once, got it 2 times; keep one of them",
        ),
    ],
)
def test_an_option_that_takes_one_value_is_refused_twice(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 1
    assert said in capsys.readouterr().err


def test_an_option_that_takes_several_values_may_be_repeated() -> None:
    command = parse_arguments(["estimate", "--sensor", "s", "--reference", "a.png", "--reference", "b.png", "c.png"])
    assert [path.name for path in command.reference] == ["a.png", "b.png"]
