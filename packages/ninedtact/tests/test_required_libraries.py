"""What needs a library of an extra is refused in one sentence without it, or with a version that is not declared."""

import re
import sys
from pathlib import Path

import pytest

from ninedtact._version import find_incompatible_library, installation_command
from ninedtact.cli import main
from ninedtact.errors import MissingLibraryError
from ninedtact.required_libraries import require_libraries


def test_a_missing_module_and_another_version_are_named_with_the_command_that_installs_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install = re.escape(f"run {installation_command('stream')}")
    with pytest.raises(MissingLibraryError, match=f"expected websockets and nosuch, .* got no nosuch; {install}"):
        require_libraries("stream", "websockets", "nosuch")
    require_libraries("stream", "websockets")
    (tmp_path / "websockets-0.1.dist-info").mkdir()
    (tmp_path / "websockets-0.1.dist-info" / "METADATA").write_text("Name: websockets\nVersion: 0.1\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert find_incompatible_library("stream") == "expected websockets<17,>=15, got 0.1"
    with pytest.raises(MissingLibraryError, match=rf"expected websockets<17,>=15, got 0\.1; {install}"):
        require_libraries("stream", "websockets")


@pytest.mark.parametrize(
    ("command", "missing", "extra"),
    [
        ("ros2 --source 0", "cyclonedds", "ros2"),
        ("foxglove --source 0", "foxglove", "foxglove"),
        ("serve --source 0", "websockets", "stream"),
        ("live --source 0", "viser", "studio"),
        ("play none.mcap", "mcap", "studio"),
        ("simulate dataset --out none --cluster somewhere:8786", "distributed", "cluster"),
    ],
)
def test_each_command_names_the_extra_that_it_needs(
    command: str, missing: str, extra: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, missing, None)
    assert main(command.split()) == 1
    said = capsys.readouterr().err
    assert f"no {missing}" in said and said.endswith(f"run {installation_command(extra)}\n") and said.count("\n") == 1
