"""Pages of the documentation that follow the code: the Python API and the reference of commands."""

import re
import sys
from importlib import import_module
from pathlib import Path

import pytest

import ninedtact

ROOT = Path(__file__).parents[1]
DOCUMENTED = re.findall(r"^::: ([\w.]+)$", (ROOT / "docs" / "api.md").read_text(encoding="utf-8"), re.MULTILINE)


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
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    monkeypatch.setenv("COLUMNS", "110")
    monkeypatch.setenv("NO_COLOR", "1")
    sys.modules.pop("write_command_reference", None)
    page = import_module("write_command_reference").command_reference()
    assert page == (ROOT / "docs" / "commands.md").read_text(encoding="utf-8"), "run scripts/write_command_reference.py"
