"""Options of commands have their bounds beside them; they are checked before a command does anything."""

import pytest

from ninedtact.cli import main


@pytest.mark.parametrize("wrong", ["nan", "-1", "0"])
@pytest.mark.parametrize(
    ("command", "option"),
    [
        ("record --source sim --out press.mcap", "--seconds"),
        ("serve --source sim", "--seconds"),
        ("live --source sim", "--display-hz"),
        ("play press.mcap", "--display-hz"),
        ("track press.mp4 --rectified", "--rate-hz"),
        ("camera-delay --source sim", "--seconds"),
    ],
)
def test_a_number_out_of_its_bounds_is_refused_by_the_name_of_its_option(
    command: str, option: str, wrong: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command.split(), option, wrong]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"ninedtact: expected {option} ") and f", got {wrong}; " in said and said.count("\n") == 1
